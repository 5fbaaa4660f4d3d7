"""The ratios of a run of `bench` as JSON, for a later run to compare with.

Its first line signs the rest, so that only an unedited file is ever replaced; the whole is JSON all the same.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import read_text, shown
from sionna_radar.foundation.threads import cores
from sionna_radar.foundation.workers import versions
from sionna_radar.report.files.folder import SignedFile, strict_json
from sionna_radar.studies.bench_cases import Ratio

BENCH_FILE = SignedFile(command="bench", before='{"written_by": "', after='",')
REMEDY = "give a file that `sionna-radar bench -o` wrote"
# A ratio that is worse by more than this share got worse by more than these machines' noise.
NOISE = 0.2


def write_bench(path: Path, ratios: Sequence[Ratio], *, quick: bool) -> Path:
    """Write ratios to a file, completely or not at all, and return the file; raises OutputError as `SignedFile`."""
    document = {
        "quick": quick,
        "cores": cores(),
        "versions": versions(),
        "ratios": [
            {"name": r.name, "value": r.value, "bound": r.bound, "at_most": r.at_most, "kept": r.kept} for r in ratios
        ],
    }
    return BENCH_FILE.write(path, strict_json(document).removeprefix("{\n"))


def read_bench(path: Path, *, quick: bool) -> dict[str, float]:
    """Return the ratios of an earlier run by their names.

    Raises InputFileError for a file that holds none, or that of a run that was quick where this one is not.
    """
    text = read_text(path, "--compare", REMEDY)
    try:
        document = json.loads(text)
        if document["quick"] != quick:
            message = (
                f"--compare {shown(path)} is of a run {'with' if document['quick'] else 'without'} --quick; {REMEDY}"
            )
            raise InputFileError(message)
        return {str(ratio["name"]): float(ratio["value"]) for ratio in document["ratios"]}
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        message = f"--compare {shown(path)} holds no ratios ({error}); {REMEDY}"
        raise InputFileError(message) from error


def change(ratio: Ratio, earlier: Mapping[str, float]) -> str:
    """Return what became of a ratio since an earlier run: its value then, whether it got worse; "" for a new one."""
    before = earlier.get(ratio.name)
    if before is None:
        return ""
    worse = ratio.value > before * (1 + NOISE) if ratio.at_most else ratio.value < before / (1 + NOISE)
    return f"   was {before:,.2f}{', worse' if worse else ''}"
