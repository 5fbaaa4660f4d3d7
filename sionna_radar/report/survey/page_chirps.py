"""The chirps of a page: pulses spread over the survey, traced once more, and what is found in each."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.foundation.decibel import decibels
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.report.page.packing import Pack
from sionna_radar.survey.result import Survey
from sionna_radar.survey.sensors.sweeps import ChirpRecord

# Of a custom sensor, which records one at a time.
MOST_ONE_BY_ONE = 40
# Numbers of a page, and paths traced again for it: of wide beams over fixed scatterers a pulse has tens of thousands.
MOST_BYTES, MOST_PATHS = 3_500_000, 200_000
LEAST_CHIRPS, AT_ONCE = 12, 256
LEVEL_STEP_DB = 0.1


def chirps_of(survey: Survey, index: Int[np.ndarray, " pulse"]) -> Int[np.ndarray, " chirp"]:
    """Return those of some pulses whose chirps a page has room and time for, spread over them."""
    if survey.chirp is None or len(index) == 0:
        return index[:0]
    beat, cells = survey.chirp.beat, len(survey.chirp.power)
    size = 2 * (len(beat) * (2 if np.iscomplexobj(beat) else 1) + 2 * cells)
    fast = max(LEAST_CHIRPS, MOST_PATHS * survey.pulses // max(survey.paths, 1))
    most = max(1, min(MOST_BYTES // size, fast))
    return index[:: -(-len(index) // most)]


@on_one_thread
def record_chirps(survey: Survey, index: Int[np.ndarray, " pulse"]) -> list[ChirpRecord]:
    """Return the records of some pulses; fewer from a sensor that records one at a time."""
    if len(index) == 0:
        return []
    sensor, flight = survey.sensor or survey.prepared.build_sensor(), survey.prepared.flight
    together = getattr(sensor, "record_chirps", None)
    if together is not None:
        blocks = np.array_split(index, -(-len(index) // AT_ONCE))
        return [record for block in blocks for record in together(flight.pulses(block))]
    every = -(-len(index) // MOST_ONE_BY_ONE)
    records = (sensor.record_chirp(flight.pulses(index[row : row + 1])) for row in range(0, len(index), every))
    return [record for record in records if record is not None]


def packed_chirps(
    pack: Pack, records: list[ChirpRecord], rows: Int[np.ndarray, " pulse"], survey: Survey
) -> dict[str, Any] | None:
    """Return chirps for a page; None where there are none.

    rows: the pulses of the page, in which each record's pulse is found.
    """
    if not records:
        return None
    beat = np.stack([record.beat for record in records])
    scale = np.maximum(np.abs(beat).max(axis=1), np.finfo(float).tiny)
    exponent = 3 * int(np.floor(np.log10(scale.max()) / 3))
    parts = [beat.real, beat.imag] if np.iscomplexobj(beat) else [beat]
    power = np.stack([record.power for record in records])
    power_db, threshold_db = _levels(power), _levels(np.stack([record.threshold for record in records]))
    echo_db = decibels(np.concatenate([record.echo_power for record in records]))
    known = np.concatenate([power_db[np.isfinite(power_db)], echo_db[np.isfinite(echo_db)], [-300.0]])
    pulses = [record.pulse for record in records]
    relative = survey.scenario.radar.snr_db is not None
    return {
        "pulse": pack.whole(np.array(pulses)),
        "row": pack.whole(np.searchsorted(rows, pulses)),
        "time_ms": pack.exact(1e3 * records[0].sample_time_s),
        "range_m": pack.exact(records[0].range_m),
        "beat": [pack.rounded(part / scale[:, None], 2 / 65_000) for part in parts],
        "beat_scale": pack.exact(scale / 10.0**exponent),
        "beat_label": f"Beat (10<sup>{exponent}</sup> {'of the transmitted' if relative else '√W'})",
        "power": pack.rounded(power_db, LEVEL_STEP_DB),
        "threshold": pack.rounded(threshold_db, LEVEL_STEP_DB),
        "power_label": f"Power ({'dB rel. to transmitted' if relative else 'dBW'})",
        "top_db": float(known.max()),
        "floor_db": float(np.percentile(known, 0.5)) - 5.0,
        "echo_row": pack.whole(np.repeat(np.arange(len(records)), [len(r.echo_power) for r in records])),
        "echo_range_m": pack.exact(np.concatenate([record.echo_range_m for record in records])),
        "echo_db": pack.exact(echo_db),
    }


def _levels(power: Float[np.ndarray, "pulse cell"]) -> Float[np.ndarray, "pulse cell"]:
    """Return powers in dB; what is 200 dB under the strongest is none."""
    level = decibels(power.ravel()).reshape(power.shape)
    return np.where(level > np.nanmax(level, initial=-np.inf) - 200.0, level, np.nan)
