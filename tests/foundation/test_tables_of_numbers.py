"""Tables of numbers: columns by name in any order, defaults of absent ones, and the line of what is refused."""

import pytest

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import read_numbers

COLUMNS = {"x": None, "y": None, "sigma": 0.5}


def test_columns_are_found_by_name_and_absent_ones_have_their_value(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("# surveyed\nnote, Y,X\na,1,2\n\n# again\nb,3,4e0,5\n")
    lines, columns = read_numbers(path, "table", COLUMNS, "", further="ignored")
    assert lines == [3, 6]
    assert columns == [(2.0, 4.0), (1.0, 3.0), (0.5, 0.5)]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("x,y,z\n1,2,3\n", "line 1 reads 'x,y,z'"),
        ("x,y,x\n1,2,3\n", "line 1 reads 'x,y,x'"),
        ("x,sigma\n1,2\n", "line 1 reads 'x,sigma'"),
        ("x,y\n1,2\n1\n", "line 3 reads '1'"),
        ("x,y\n1,2,3\n", "line 2 reads '1,2,3'"),
        ("x,y,sigma\n1,2,\n", "line 2 reads '1,2,'"),
        ("x,y\n1,inf\n", "line 2 reads '1,inf'; give finite numbers"),
        ("x,y\n", "has no row of numbers; give another"),
    ],
)
def test_the_line_of_anything_else_is_named(tmp_path, text, says):
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(InputFileError, match=f"table .*table.csv'?: {says}"):
        read_numbers(path, "table", COLUMNS, "give another")
