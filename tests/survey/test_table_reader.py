"""Tables of HDF5 files are read by another process, one for all files."""

import os
import signal
import subprocess
import sys
import time

import h5py
import pytest

from sionna_radar.survey.recordings import table_reader
from sionna_radar.survey.recordings.table_reader import TableReader


@pytest.fixture
def reader():
    made = TableReader(os.getpid())
    yield made
    made._end()


def test_one_process_reads_all_sound_files_and_another_the_one_after_a_damaged_file(reader, tmp_path):
    """Names of files are any that a file system takes; an idle process that was killed is replaced."""
    sound, odd = tmp_path / "sound.nc", tmp_path / os.fsdecode(b"a\nb\xff.nc")
    for path in (sound, odd):
        with h5py.File(path, "w") as file:
            file["numbers"] = [1, 2, 3]
    (tmp_path / "none.nc").write_bytes(b"no HDF5 at all")
    assert [reader.error(path) for path in (sound, odd)] == ["", ""]
    first = reader._process
    assert reader.error(sound) == ""
    assert reader._process is first
    first.kill()
    first.wait()
    assert reader.error(sound) == ""
    assert "signature not found" in reader.error(tmp_path / "none.nc")
    assert reader.error(sound) == ""


@pytest.mark.parametrize(
    ("program", "says"),
    [
        ("import os; input(); os.abort()", f"crash the HDF5 library: {signal.strsignal(signal.SIGABRT)}"),
        ("input(); raise SystemExit(3)", "ended with exit code 3"),
        ("input(); input()", "could not be read in 0.3 s"),
    ],
)
def test_what_ends_the_process_or_hangs_it_is_said(reader, monkeypatch, tmp_path, program, says):
    monkeypatch.setattr(table_reader, "PROGRAM", program)
    monkeypatch.setattr(table_reader, "LONGEST_S", 0.3)
    assert says in reader.error(tmp_path / "a.nc")
    assert reader._process is None


def test_an_interrupt_ends_the_process_whose_answer_is_still_to_come(reader, monkeypatch, tmp_path):
    """Its answer would be taken for that of the next file."""
    monkeypatch.setattr(
        table_reader, "PROGRAM", "import os, signal; input(); os.kill(os.getppid(), signal.SIGINT); input()"
    )
    with pytest.raises(KeyboardInterrupt):
        reader.error(tmp_path / "a.nc")
    assert reader._process is None


ENDS = """
import os, sys
from pathlib import Path
from sionna_radar.survey.recordings import table_reader
from sionna_radar.survey.recordings.table_reader import _reader_of, error_of_tables
table_reader.PROGRAM = "import sys; [print('\\"\\"', flush=True) for line in sys.stdin]; open({end!r}, 'w')"
error_of_tables(Path("a.nc"))
process = _reader_of(os.getpid())._process
if os.fork() == 0:
    sys.exit()
os.wait()
print(process.pid, process.poll(), _reader_of(os.getpid()) is _reader_of(0), flush=True)
os.kill(os.getpid(), {signal})
"""


@pytest.mark.parametrize("kill", [0, signal.SIGKILL])
def test_the_process_ends_with_its_parent_and_not_with_a_fork_of_it(tmp_path, kill):
    end = tmp_path / "end"
    code = ENDS.format(signal=int(kill), end=str(end))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == -kill, done.stderr
    number, alive, same = done.stdout.split()
    assert (alive, same) == ("None", "False")
    if not kill:
        with pytest.raises(ProcessLookupError):
            os.kill(int(number), 0)
    for _ in range(1200 * bool(kill)):  # it reads the end of its input, and goes on to the end of its program
        if end.exists():
            break
        time.sleep(0.05)
    assert end.exists() == bool(kill)
