"""Commands in a process of their own, one after another, so that one that dies or hangs fails its test alone.

Run as a program it is that process: it reads a command as a line of JSON, runs it with its output in files, and
answers with a line of JSON. The heavy libraries are loaded once.
"""

import json
import os
import resource
import subprocess
import sys
import traceback
from dataclasses import dataclass
from pathlib import Path
from select import select


@dataclass(frozen=True)
class Ended:
    """How a command ended; `code` is a text where it did not by itself."""

    code: int | str
    stderr: str
    peak_mb: float


class CommandServer:
    """Runs commands of the program in another process, which is begun again where one has ended it."""

    def __init__(self, folder: Path):
        self.folder = folder
        self._process: subprocess.Popen | None = None

    def run(self, arguments: list[str], within_s: float) -> Ended:
        """Return how a command ended that ran in the folder."""
        process = self._begun()
        process.stdin.write(json.dumps(arguments).encode() + b"\n")
        process.stdin.flush()
        ready, _, _ = select([process.stdout], [], [], within_s)
        answer = process.stdout.readline() if ready else b""
        said = (self.folder / "stderr").read_text(errors="backslashreplace")
        if answer:
            ended = json.loads(answer)
            return Ended(ended["code"], said, ended["peak_mb"])
        self.stop()
        how = f"died ({process.returncode})" if ready else f"ran for more than {within_s:g} s"
        return Ended(how, said, 0.0)

    def _begun(self) -> subprocess.Popen:
        if self._process is None:
            self._process = subprocess.Popen(
                [sys.executable, __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=self.folder
            )
        return self._process

    def stop(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process.stdin.close()
            self._process.stdout.close()
            self._process = None


def serve() -> None:
    """Answer commands until there are no more."""
    from sionna_radar.cli.app import main

    answers = os.fdopen(os.dup(1), "wb")
    for line in sys.stdin.buffer:
        sys.argv = ["sionna-radar", *json.loads(line)]
        code: object = "no exit"
        with Path("stdout").open("w") as out, Path("stderr").open("w") as err:
            os.dup2(out.fileno(), 1)
            os.dup2(err.fileno(), 2)
            try:
                main()
            except SystemExit as end:
                code = end.code or 0
            except BaseException:
                traceback.print_exc()
            sys.stdout.flush()
            sys.stderr.flush()
        peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        answers.write(json.dumps({"code": code, "peak_mb": peak_mb}).encode() + b"\n")
        answers.flush()


if __name__ == "__main__":
    serve()
