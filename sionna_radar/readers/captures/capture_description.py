"""A description of a raw capture to start from: what its chirp configuration does not say is assumed, and told."""

import json
import math
from dataclasses import dataclass
from pathlib import Path

from scipy.constants import speed_of_light

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import regular_file, shown
from sionna_radar.foundation.new_file import write_new
from sionna_radar.readers.captures.capture_file import NEAR_CELLS, capture_config, capture_frames, inferred_lanes
from sionna_radar.scenario.readers import DESCRIBED_RECORDING
from sionna_radar.survey.recordings.signal_file import CAPTURE_SUFFIX, is_capture

LANES, MAX_BYTES = 2, 64_000_000_000


@dataclass(frozen=True)
class CaptureDescription:
    """A description that was written: its file, and what it assumes, a sentence each."""

    path: Path
    assumed: tuple[str, ...]


def describe_capture(capture: Path, config: Path, output: Path | None = None) -> CaptureDescription:
    """Write the TOML description of a raw capture (.bin) beside it, or as `output`, and open it once.

    Raises InputFileError for files that cannot be read, and OutputError for an output that exists or cannot be written.
    """
    if not is_capture(capture):
        raise InputFileError(f"{shown(capture)} is not a raw capture ({CAPTURE_SUFFIX}); --describe is for these alone")
    regular_file(capture, "recording", "name the samples of a capture", MAX_BYTES)
    known = capture_config(config)
    raw = capture_frames(capture, known)
    lanes = inferred_lanes(raw, known, LANES)
    sent = sorted({bit + 1 for mask in known.transmitters for bit in range(mask.bit_length()) if mask >> bit & 1})
    swept_hz = 1e9 * abs(known.slope_mhz_us) * known.samples / known.rate_ksps
    # Rounded up, and written as it is.
    near_m = math.ceil(100 * NEAR_CELLS * speed_of_light / (2 * swept_hz)) / 100
    assumed = {
        "lanes": f"{lanes} LVDS lanes, "
        + ("as xWR16xx, xWR18xx and xWR68xx have" if lanes == LANES else "by mirror images in I and Q"),
        "receiver": f"receiver 1 of {known.receivers} and transmitter {sent[0]} (of {', '.join(map(str, sent))}) alone "
        "are processed; all of them with [radar.array]",
        "range_zero_m": "ranges count from the antenna: no delay of cables or filters",
        "min_range_m": f"leakage fills the first {NEAR_CELLS} range cells",
        "antenna": "the antenna is the default one; it matters with poses alone",
    }
    path = (output or capture.with_suffix(".toml")).expanduser()
    text = f"""# Written from {shown(Path(config.name))}, which says what the radar sent; the rest is assumed.
[recording]
samples = {_relative_path(capture, path)}
config = {_relative_path(config, path)}
lanes = {lanes}  # {assumed["lanes"]}
receiver = 1
transmitter = {sent[0]}  # {assumed["receiver"]}
range_zero_m = 0.0  # {assumed["range_zero_m"]}

[processing]
min_range_m = {near_m}  # {assumed["min_range_m"]}

# With the poses of the antenna there are points and a map.
# [poses]
# log = "flight.ulg"  # in any format that platform.log takes
# first_pulse_s = 0.0  # time of the first pulse in the log
# incidence_deg = 45.0  # of the boresight, from nadir
"""
    write_new(path, text, "name another file with -o")
    try:
        with DESCRIBED_RECORDING(path):
            pass
    except Exception:
        path.unlink()
        raise
    return CaptureDescription(path=path, assumed=tuple(assumed.values()))


def _relative_path(file: Path, description: Path) -> str:
    """Return the path of a file as the description names it, a TOML string."""
    file, folder = file.expanduser().absolute(), description.absolute().parent
    return json.dumps(file.name if file.parent == folder else str(file), ensure_ascii=False)
