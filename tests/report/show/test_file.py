"""The page of `show`: written whole, and never over a file that is not ours or was changed."""

import pytest

from sionna_radar.foundation.errors import OutputError
from sionna_radar.report.page.show import PAGE_FILE


def test_a_page_is_replaced_while_it_is_ours_and_unchanged(tmp_path):
    path = tmp_path / "world.html"
    PAGE_FILE.write(path, "<!doctype html>one\n")
    PAGE_FILE.write(path, "<!doctype html>two\n")
    assert path.read_text().startswith("<!doctype html>two\n")
    path.write_text(path.read_text().replace("two", "2"))
    with pytest.raises(OutputError, match="edited since"):
        PAGE_FILE.check(path)
    assert "html>2" in path.read_text()


@pytest.mark.parametrize("place", ["theirs.html", "folder", "nowhere/page.html"])
def test_nothing_of_the_users_is_overwritten(tmp_path, place):
    (tmp_path / "theirs.html").write_text("mine")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OutputError, match="name "):
        PAGE_FILE.write(tmp_path / place, "page")
    assert (tmp_path / "theirs.html").read_text() == "mine"


def test_show_writes_a_page_and_refuses_another_file(cli, small, tmp_path):
    path = tmp_path / "small.html"
    done = cli("show", small, "-o", path)
    assert (done.returncode, done.stderr) == (0, "")
    assert str(path) in done.stdout
    assert "3,600" not in done.stdout
    path.write_text("edited")
    refused = cli("show", small, "-o", path)
    assert refused.returncode == 2
    assert refused.stderr.startswith("error: output = ")
    assert refused.stderr.count("\n") == 1
