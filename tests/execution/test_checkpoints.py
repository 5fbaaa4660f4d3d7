"""Parts of a run are whole or absent, are those of that run, and go when the run is done; nothing else goes."""

import multiprocessing
import os
import shutil
import signal

import pytest

from sionna_radar.execution.checkpoints import FOLDER, Checkpoints, open_checkpoints
from sionna_radar.foundation.errors import InputFileError, OutputError, ScenarioError

RUN = {"scenario": "a", "seed": [1], "version": {"numpy": "2"}}


def leave(directory, count, run=RUN, reason=KeyboardInterrupt):
    """A run that ends for a reason, an interrupt unless given; returns what it says."""

    def interrupted():
        with open_checkpoints(directory, run, resume=True) as parts:
            for number in range(count):
                parts.put(f"part {number}", b"x" * number)
            raise reason

    with pytest.raises(reason if isinstance(reason, type) else type(reason)) as raised:
        interrupted()
    return "".join(getattr(raised.value, "__notes__", []))


def test_parts_stay_after_an_interrupt_and_go_at_the_end(tmp_path):
    out = tmp_path / "deep" / "out"
    leave(out, 3)
    with open_checkpoints(out, RUN, resume=True) as parts:
        assert len(parts) == 3
        assert [parts.get(f"part {n}") for n in range(4)] == [b"", b"x", b"xx", None]
        (out / "mine.txt").write_text("mine")
        (parts.folder / "mine too.txt").write_text("mine")
    assert {path.name for path in out.iterdir()} == {"mine.txt", FOLDER}
    assert [path.name for path in (out / FOLDER).iterdir()] == ["mine too.txt"]


def test_an_interrupt_before_the_first_part_leaves_nothing(tmp_path):
    assert leave(tmp_path / "out", 0) == ""
    assert not (tmp_path / "out").exists()


def test_a_refusal_that_would_come_again_leaves_no_parts_and_does_not_advise_to_resume(tmp_path):
    refusal = ScenarioError.of("--surveys", "too few; raise it", "command line")
    assert leave(tmp_path / "out", 3, reason=refusal) == ""
    assert not (tmp_path / "out").exists()
    # What an interrupted run saved is kept.
    leave(tmp_path / "out", 3)
    assert leave(tmp_path / "out", 4, reason=refusal) == ""
    assert len(Checkpoints(tmp_path / "out" / FOLDER)) == 4


def test_a_file_that_is_to_be_mended_is_named_before_the_advice_to_resume(tmp_path):
    assert "once the file is mended" in leave(tmp_path / "out", 2, reason=InputFileError("damaged"))


@pytest.mark.parametrize("key", ["scenario", "seed", "version"])
def test_parts_of_another_run_are_refused(tmp_path, key):
    assert "--resume" in leave(tmp_path / "out", 2)
    with pytest.raises(OutputError, match=rf"2 finished parts of a run with another {key};") as refused:
        leave(tmp_path / "out", 0, RUN | {key: "other"})
    assert not hasattr(refused.value, "__notes__")
    assert len(Checkpoints(tmp_path / "out" / FOLDER)) == 2


def test_parts_are_gone_on_from_only_if_that_is_asked(tmp_path):
    leave(tmp_path / "out", 2)
    with pytest.raises(OutputError, match="go on with --resume"), open_checkpoints(tmp_path / "out", RUN, resume=False):
        pass
    assert len(Checkpoints(tmp_path / "out" / FOLDER)) == 2


def test_a_second_run_is_refused_while_the_first_lives(tmp_path):
    with (
        open_checkpoints(tmp_path / "out", RUN, resume=False),
        pytest.raises(OutputError, match="is being written by another run"),
        open_checkpoints(tmp_path / "out", RUN, resume=True),
    ):
        pass


def _die(directory, held):
    with open_checkpoints(directory, RUN, resume=False) as parts:
        parts.put("done", b"whole")
        (parts.folder / "half.unfinished").write_bytes(b"ha")
        held.set()
        signal.pause()


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="there is no SIGKILL")
def test_a_killed_run_holds_no_lock_and_leaves_no_half_of_a_part(tmp_path):
    context = multiprocessing.get_context("spawn")
    held = context.Event()
    process = context.Process(target=_die, args=(tmp_path / "out", held))
    process.start()
    assert held.wait(60)
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    with open_checkpoints(tmp_path / "out", RUN, resume=True) as parts:
        assert parts.get("done") == b"whole"
        assert not list(parts.folder.glob("*.unfinished"))


def test_a_part_without_room_is_one_clear_error(tmp_path, monkeypatch):
    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with (
        pytest.raises(OutputError, match=r"No space left on device\); free some space"),
        open_checkpoints(tmp_path / "out", RUN, resume=False) as parts,
    ):
        parts.put("a", b"a")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("above", [0, 1, 2])
def test_an_output_folder_that_is_removed_meanwhile_is_one_clear_error(tmp_path, above):
    out = tmp_path / "deep" / "out"
    removed = [out / FOLDER, out, out.parent][above]

    def run():
        with open_checkpoints(out, RUN, resume=False) as parts:
            parts.put("a", b"a")
            shutil.rmtree(removed)
            assert parts.get("a") is None
            parts.put("b", b"b")

    with pytest.raises(OutputError, match=r"cannot be saved in .*; it was removed during the run") as raised:
        run()
    assert not hasattr(raised.value, "__notes__")
    assert not removed.exists()


def test_a_result_whose_parts_are_removed_at_the_end_is_written_all_the_same(tmp_path):
    with open_checkpoints(tmp_path / "out", RUN, resume=False) as parts:
        parts.put("a", b"a")
        shutil.rmtree(tmp_path / "out")
    assert not (tmp_path / "out").exists()
