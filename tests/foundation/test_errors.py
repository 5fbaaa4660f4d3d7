"""What other libraries say of an error, within one of ours."""

import pytest

from sionna_radar.foundation.errors import MAX_REASON, reason_of


@pytest.mark.parametrize(
    ("error", "reason"),
    [
        (RuntimeError("IoError: no chunks"), "no chunks"),
        (RuntimeError("lazrs.LazrsError: failed to fill\nbacktrace"), "failed to fill"),
        (ValueError("std::io::Error: end of file"), "end of file"),
        (OSError("Unable to open file (file signature not found)"), "Unable to open file (file signature not found)"),
        (ValueError("An Error: of two words"), "An Error: of two words"),
        (MemoryError(), "MemoryError"),
        (ValueError("\n\n"), "ValueError"),
        (ValueError("x" * 3000), "x" * MAX_REASON),
    ],
)
def test_the_first_line_without_the_name_of_an_exception(error, reason):
    assert reason_of(error) == reason
