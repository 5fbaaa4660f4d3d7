"""Trial flight of a scenario generated from a user's files, made smaller until it fits the ground.

One pulse of each scan line is simulated. A planned flight that does not stay over the ground, as over a small cloud, is
flown lower and along a shorter track.
"""

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sionna_radar.foundation.errors import RadarError, ScenarioError, one_line
from sionna_radar.scenario import parse_scenario
from sionna_radar.scenario.overrides import resolve_paths
from sionna_radar.survey.preparation import Prepared, prepare

# How often a flight is made smaller, and by how much; pulses that are flown, at most.
MAX_SMALLER, SMALLER, MAX_PULSES = 8, 0.7, 200
# Height of a planned flight, m; smaller ones are as long as they are high.
ALTITUDE_M = 50.0


@dataclass(frozen=True, kw_only=True)
class FirstFlight:
    """A scenario that was tried: its tables, with the flight that fits the ground.

    pulses: how many were flown; 0 if it cannot be flown. reason: why not.
    """

    document: dict[str, Any]
    pulses: int = 0
    reason: str | None = None

    @property
    def shrunk(self) -> bool:
        """Whether the flight was made smaller for its ground."""
        return self.pulses > 0 and self.document["platform"].get("altitude_m", ALTITUDE_M) < ALTITUDE_M


def first_flight(document: Mapping[str, Any], folder: Path) -> FirstFlight:
    """Fly a pulse of each scan line of tables with paths from a folder, lower and shorter over small ground."""
    reason, planned = None, "log" not in document["platform"]
    for smaller in range(MAX_SMALLER + 1 if planned else 1):
        tried = copy.deepcopy(dict(document))
        if smaller:
            size_m = round(ALTITUDE_M * SMALLER**smaller, 1)
            tried["platform"] |= {"altitude_m": size_m, "length_m": size_m}
        try:
            return FirstFlight(document=tried, pulses=_flown(tried, folder))
        except ScenarioError as error:
            reason = reason or one_line(error)
            if not any(problem.field.startswith(("platform.", "radar.scan")) for problem in error.problems):
                break
        except RadarError as error:
            reason = reason or one_line(error)
            break
    return FirstFlight(document=dict(document), reason=reason)


def _flown(document: dict[str, Any], folder: Path) -> int:
    """Simulate a pulse of each scan line, and return their number."""
    tables = copy.deepcopy(document)
    resolve_paths(tables, folder)
    prepared = prepare(parse_scenario(tables))
    index = _one_pulse_per_line(prepared)
    prepared.observe(index)
    return len(index)


def _one_pulse_per_line(prepared: Prepared) -> np.ndarray:
    """Return the number of one pulse of each scan line, or of each part of a flight without lines."""
    lines = prepared.flight.scan_numbers
    first = np.arange(len(prepared)) if lines is None else np.unique(lines, return_index=True)[1]
    chosen = np.linspace(0, len(first) - 1, min(MAX_PULSES, len(first))).round().astype(np.int64)
    return np.unique(first[chosen])
