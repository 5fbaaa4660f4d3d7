"""A folder of results, or a page, is whole or absent, and nothing that this program did not write is touched."""

import json
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from sionna_radar.foundation.errors import KeptElsewhereError, OutputError
from sionna_radar.report.files import folder
from sionna_radar.report.files.folder import check_output, write_folder
from sionna_radar.report.files.manifest import MANIFEST, finished_as, note_run, read_manifest
from sionna_radar.report.page.show import PAGE_FILE
from sionna_radar.studies.planning.document import PLAN_FILE

MARKER = "summary.json"


def filling(**texts: str) -> Callable[[Path], None]:
    """Return what fills a folder with files; "__" stands for a folder's slash, and every name ends in .txt."""

    def fill(into: Path) -> None:
        for name, text in texts.items():
            path = into / (name.replace("__", "/") + ".txt")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)

    return fill


def files(directory: Path) -> dict[str, str]:
    """Return the texts of all files but the manifest by their paths."""
    found = (path for path in directory.rglob("*") if path.is_file() and path.name != MANIFEST)
    return {path.relative_to(directory).as_posix(): path.read_text() for path in found}


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A folder with an earlier result."""
    write_folder(tmp_path / "out", MARKER, filling(a="1", b="1", figures__c="1", old__d="1"))
    return tmp_path / "out"


def test_the_manifest_lists_what_was_written(out: Path) -> None:
    document = json.loads((out / MANIFEST).read_text())
    assert set(document["files"]) == {"a.txt", "b.txt", "figures/c.txt", "old/d.txt"}
    # sha256 of the letter 1
    assert document["files"]["a.txt"] == {
        "bytes": 1,
        "sha256": "6b86b273ff34fce19d6b804eff5a3f5747ada4eaa22f1d49c01e52ddb7875b4b",
    }


def test_a_new_result_replaces_the_files_of_the_earlier_one_and_no_others(out: Path) -> None:
    (out / "mysite.qgz").write_text("mine")
    (out / "figures" / "notes.md").write_text("mine")
    (out / "contours").mkdir()
    (out / "contours" / "x").write_text("mine")
    written = write_folder(out, MARKER, filling(a="2", figures__c="2", e="2"))
    assert files(out) == {
        "a.txt": "2", "figures/c.txt": "2", "e.txt": "2",
        "mysite.qgz": "mine", "figures/notes.md": "mine", "contours/x": "mine",
    }  # fmt: skip
    assert not (out / "old").exists()  # a folder that nothing is left in
    assert {p.relative_to(out).as_posix() for p in written} == {"a.txt", "figures/c.txt", "e.txt", MANIFEST}
    assert [path.name for path in out.parent.iterdir()] == ["out"]


def test_a_file_that_the_user_edited_is_the_user_s(out: Path) -> None:
    (out / "b.txt").write_text("2")  # as long as before
    with pytest.raises(OutputError, match=r"changed since \(b\.txt\).* name another folder"):
        check_output(out, MARKER)
    (out / "b.txt").unlink()
    check_output(out, MARKER)  # and one taken away is no loss


def test_a_link_in_the_place_of_a_file_is_the_user_s(out: Path, tmp_path: Path) -> None:
    (out / "a.txt").rename(tmp_path / "elsewhere.txt")
    (out / "a.txt").symlink_to(tmp_path / "elsewhere.txt")
    with pytest.raises(OutputError, match=r"a\.txt"):
        check_output(out, MARKER)


def test_a_manifest_does_not_reach_beyond_its_folder(out: Path, tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("1")
    document = json.loads((out / MANIFEST).read_text())
    document["files"]["../thesis.txt"] = document["files"].pop("a.txt")
    (out / MANIFEST).write_text(json.dumps(document))
    with pytest.raises(OutputError, match=r"\.\./thesis\.txt"):
        check_output(out, MARKER)
    assert (tmp_path / "thesis.txt").exists()


def test_a_folder_without_a_manifest_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").touch()
    (tmp_path / "summary.json").write_text("{}")  # what marked a result once
    for text in (None, "{}", "[1]", "no JSON", '{"written_by": "another"}'):
        if text is not None:
            (tmp_path / MANIFEST).write_text(text)
        with pytest.raises(OutputError, match=r"output = .* is not empty .* name a new or empty folder"):
            check_output(tmp_path, MARKER)
    assert (tmp_path / "thesis.txt").exists()


def test_the_result_of_another_command_is_refused(out: Path) -> None:
    with pytest.raises(OutputError, match=r"another command \(summary\.json, not sweep\.json\)"):
        check_output(out, "sweep.json")


@pytest.mark.parametrize("failure", [RuntimeError("bug"), OSError(28, "No space left"), KeyboardInterrupt()])
def test_a_failure_while_writing_leaves_all_as_it_was(out: Path, tmp_path: Path, failure: BaseException) -> None:
    def fill(into: Path) -> None:
        (into / "a.txt").write_text("2")
        raise failure

    before = files(tmp_path)
    expected = OutputError if isinstance(failure, OSError) else type(failure)
    for place in (out, tmp_path / "new" / "result"):
        with pytest.raises(expected):
            write_folder(place, MARKER, fill)
    assert files(tmp_path) == before
    assert sorted(path.name for path in tmp_path.rglob("*") if path.is_dir()) == ["figures", "new", "old", "out"]
    assert read_manifest(out / MANIFEST) is not None


def fail_at_move(monkeypatch: pytest.MonkeyPatch, number: int, failure: BaseException) -> None:
    """Let the so-manieth move of a file from one folder to another fail, once."""
    replace, moves = Path.replace, []

    def counted(self: Path, target: Path) -> Path:
        if self != target:
            moves.append(self)
            if len(moves) == number:
                raise failure
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", counted)


@pytest.mark.parametrize("number", range(1, 10))
def test_a_file_that_cannot_be_replaced_loses_neither_result(
    out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    """Five moves take the earlier result out, four put the new one in; each may meet a file open elsewhere."""
    before = files(out)
    fail_at_move(monkeypatch, number, PermissionError(13, "open in another program"))
    with pytest.raises(KeptElsewhereError, match=r"open in another program\); the new result is in .*out-2"):
        write_folder(out, MARKER, filling(a="2", figures__c="2", e="2"))
    assert files(out) == before
    assert files(tmp_path / "out-2") == {"a.txt": "2", "figures/c.txt": "2", "e.txt": "2"}
    assert read_manifest(out / MANIFEST) is not None
    assert read_manifest(tmp_path / "out-2" / MANIFEST) is not None
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "out-2"]


def test_a_user_s_file_of_that_name_stays_and_the_result_goes_beside(out: Path, tmp_path: Path) -> None:
    (out / "e.txt").write_text("mine")
    with pytest.raises(KeptElsewhereError, match=r"e\.txt that this program did not write.*out-2"):
        write_folder(out, MARKER, filling(a="2", e="2"))
    assert files(out) == {"a.txt": "1", "b.txt": "1", "figures/c.txt": "1", "old/d.txt": "1", "e.txt": "mine"}
    assert files(tmp_path / "out-2") == {"a.txt": "2", "e.txt": "2"}


def test_a_folder_filled_during_the_flight_is_left_alone(tmp_path: Path) -> None:
    check_output(tmp_path / "out", MARKER)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "letter.txt").write_text("mine")
    with pytest.raises(KeptElsewhereError):
        write_folder(tmp_path / "out", MARKER, filling(a="2"))
    assert files(tmp_path) == {"out/letter.txt": "mine", "out-2/a.txt": "2"}


KILLED = """
import os, shutil, signal, sys
from pathlib import Path
from sionna_radar.report.files.folder import write_folder

out, moves = Path(sys.argv[1]), int(sys.argv[2])
replace = Path.replace

def counted(self, target):
    global moves
    if self != target:
        moves -= 1
        if moves < 0:
            os.kill(os.getpid(), signal.SIGKILL)
    return replace(self, target)

Path.replace = counted
# The staging folder is removed last.
shutil.rmtree = lambda *_, **__: os.kill(os.getpid(), signal.SIGKILL)

def fill(into):
    (into / "figures").mkdir()
    for name in ("a", "figures/c", "e"):
        (into / f"{name}.txt").write_text("2")
    if moves < 0:
        os.kill(os.getpid(), signal.SIGKILL)

write_folder(out, "summary.json", fill)
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="a system without SIGKILL")
@pytest.mark.parametrize("moves", range(-1, 10))
def test_a_killed_run_leaves_the_earlier_result_or_the_new_one(out: Path, tmp_path: Path, moves: int) -> None:
    """The next run clears away what is left of it; the new result is there after the last of nine moves."""
    expected = {"a.txt": "2", "figures/c.txt": "2", "e.txt": "2"} if moves == 9 else files(out)
    (out / "mine.txt").write_text("mine")
    done = subprocess.run([sys.executable, "-c", KILLED, str(out), str(moves)], check=False)
    assert done.returncode == -signal.SIGKILL
    assert list(out.glob(".sionna-radar-*"))
    check_output(out, MARKER)
    assert files(out) == {**expected, "mine.txt": "mine"}
    assert not list(out.glob(".sionna-radar-*"))
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="a system without SIGKILL")
def test_what_the_user_edits_after_a_killed_run_is_the_user_s(out: Path) -> None:
    before = files(out)
    subprocess.run([sys.executable, "-c", KILLED, str(out), "6"], check=False)
    assert (out / "a.txt").read_text() == "2"
    (out / "a.txt").write_text("mine")
    with pytest.raises(OutputError, match=r"changed since \(a\.txt\)"):
        check_output(out, MARKER)
    assert files(out) == {**before, "a.txt": "mine"}


HOLDING = """
import sys, time
from pathlib import Path
from sionna_radar.execution.staging import staged

with staged(Path(sys.argv[1])) as folder:
    print(folder, flush=True)
    sys.stdin.read()
"""


def test_a_folder_in_the_making_is_another_run_s(tmp_path: Path) -> None:
    """A staging folder beside is left alone while its process lives, and one inside keeps others out."""
    (tmp_path / "out").mkdir()
    for place, told in ((tmp_path, None), (tmp_path / "out", "being written by another run")):
        command = [sys.executable, "-c", HOLDING, str(place)]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
            assert other.stdout is not None
            staging = Path(other.stdout.readline().strip())
            if told:
                with pytest.raises(OutputError, match=told):
                    check_output(tmp_path / "out", MARKER)
            else:
                check_output(tmp_path / "out", MARKER)
            assert staging.is_dir()
            other.communicate("")
        assert not staging.exists()


def test_a_folder_of_the_user_s_that_looks_like_ours_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / ".sionna-radar-notes").mkdir()
    (tmp_path / ".sionna-radar-notes" / "letter.txt").write_text("mine")
    write_folder(tmp_path / "out", MARKER, filling(a="1"))
    assert (tmp_path / ".sionna-radar-notes" / "letter.txt").read_text() == "mine"


def test_a_file_in_the_way_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(OutputError, match=r"output = .*file is a file; name a folder"):
        check_output(file, MARKER)
    with pytest.raises(OutputError, match=r"file is a file|cannot be reached"):
        check_output(file / "inside" / "out", MARKER)


def test_unwritable_parent_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Root writes anywhere, so the refusal of the system is played.
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(folder.tempfile, "TemporaryDirectory", refuse)
    with pytest.raises(OutputError, match="not writable"):
        check_output(tmp_path / "a" / "b", MARKER)


def test_check_leaves_no_trace(tmp_path: Path) -> None:
    assert check_output(tmp_path / "a" / "b", MARKER) == (tmp_path / "a" / "b").resolve()
    (tmp_path / "here").mkdir()
    check_output(tmp_path / "here", MARKER)
    assert [p.name for p in tmp_path.iterdir()] == ["here"]


def test_the_working_folder_takes_a_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for text in "12":
        write_folder(Path(), MARKER, filling(a=text))
        assert files(tmp_path) == {"a.txt": text}
        assert Path.cwd().samefile(tmp_path)


def test_a_folder_that_is_removed_while_it_is_written_is_one_clear_error(tmp_path: Path) -> None:
    def fill(into: Path) -> None:
        shutil.rmtree(tmp_path / "here")
        (into / "a.txt").write_text("1")

    (tmp_path / "here" / "out").mkdir(parents=True)
    with pytest.raises(OutputError, match=r"cannot be written .*; it was removed during the run"):
        write_folder(tmp_path / "here" / "out", MARKER, fill)


# ------------------------------------------------------------------------------------------ plan files


def test_a_plan_replaces_only_a_plan_that_nobody_edited(tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    PLAN_FILE.write(path, "seed = 1\n")
    PLAN_FILE.write(path, "seed = 2\n")
    assert path.read_text().endswith("\nseed = 2\n")
    path.write_text(path.read_text() + "# mine\n")
    for name in ("plan.toml", "own.toml"):
        (tmp_path / "own.toml").write_text("seed = 3\n")
        with pytest.raises(OutputError, match="was not written by plan or was edited since"):
            PLAN_FILE.check(tmp_path / name)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["own.toml", "plan.toml"]


RUN = {"scenario": {"seed": 1, "beams": [1.0, 2.0]}, "seed": 1, "products": ["csv"]}


def test_a_finished_result_knows_its_run(out: Path) -> None:
    assert finished_as(out, RUN, "products") is None  # nothing was noted
    note_run(out, RUN, 1)
    assert finished_as(out, RUN, "products") == 1
    assert files(out).keys() == {"a.txt", "b.txt", "figures/c.txt", "old/d.txt"}
    assert finished_as(out, RUN | {"products": ["laz"]}, "products") is None
    with pytest.raises(OutputError, match="with another scenario, seed; name another folder"):
        finished_as(out, RUN | {"scenario": {"seed": 2}, "seed": 2}, "products")
    check_output(out, MARKER)
    (out / "a.txt").unlink()
    assert finished_as(out, RUN, "products") is None
    write_folder(out, MARKER, filling(a="2"))
    assert finished_as(out, RUN | {"seed": 2}, "products") is None  # of that run nothing is known


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


def test_show_writes_a_folder_like_other_commands(cli, small, tmp_path):
    done = cli("show", small, "-o", tmp_path / "world")
    assert str(tmp_path / "world" / "show.html") in done.stdout
    cli("show", small, "-o", tmp_path / "world")
    assert {path.name for path in (tmp_path / "world").iterdir()} == {"show.html", MANIFEST}
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes").write_text("mine")
    assert "mine" in cli("show", small, "-o", tmp_path / "mine", code=2).stderr


def test_show_writes_a_page_and_refuses_another_file(cli, small, tmp_path):
    path = tmp_path / "small.html"
    done = cli("show", small, "-o", path)
    assert done.stderr == ""
    assert str(path) in done.stdout
    assert "3,600" not in done.stdout
    path.write_text("edited")
    refused = cli("show", small, "-o", path, code=2)
    assert refused.stderr.startswith("error: output = ")
    assert refused.stderr.count("\n") == 1
