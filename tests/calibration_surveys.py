"""Surveys with errors of the instrument, of which `calibrate` is to find what was put in."""

import os
from dataclasses import dataclass
from typing import Any

import numpy as np

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.execution.execution import Execution
from sionna_radar.flight.instrument import UNKNOWNS, believed_motion
from sionna_radar.mapping.calibration import Solution, solve
from sionna_radar.mapping.echo_model.model import mean_ranges
from sionna_radar.mapping.instrument_echoes import Together, WholeEchoes
from sionna_radar.scenario import load_scenario
from sionna_radar.signal.receiver import Receiver, Reception
from sionna_radar.survey.observation import observe
from sionna_radar.survey.preparation import Prepared, prepare

# Standard deviations of what is put in, and beforehand, in the units of `UNKNOWNS`.
SPREAD = {
    "roll": 0.5,
    "pitch": 0.5,
    "heading": 0.5,
    "lever_nose": 0.1,
    "lever_right": 0.1,
    "lever_down": 0.1,
    "range_bias": 0.3,
    "time_offset": 5.0,
}
LEVER = ("lever_nose", "lever_right", "lever_down")


@dataclass(frozen=True, kw_only=True)
class Delayed(Receiver):
    """A receiver behind a cable: each beat signal is that of ranges longer by `delay_m`; I/Q samples."""

    delay_m: float

    def reception(self, paths, pulses) -> Reception:
        """Return the delayed signals."""
        received, chirp = super().reception(paths, pulses), self.chirp
        ramp = np.exp(2j * np.pi * chirp.direction * chirp.beat_per_metre_hz * self.delay_m * chirp.sample_time_s)
        return Reception(beats=[beat * ramp for beat in received.beats], saturated=received.saturated)


def flight(length_m: float, seed: int, terrain_seed: int, **changes: Any) -> dict[str, Any]:
    """Overrides of `hills`: lines to and fro and across at 50 m, in gusts, with an antenna fixed to the body."""
    return {
        "seed": seed,
        "terrain.size_m": [420.0, 420.0],
        "terrain.seed": terrain_seed,
        "dem.method": "refined",
        "platform.lines": {"count": 2, "spacing_m": 10.0, "length_m": length_m, "crossing": True},
        "platform.start_m": None,
        "platform.wind": {"speed_mps": 6.0, "from_deg": 20.0, "crab": False},
        "radar.scan.stabilised": False,
        "radar.sampling": "iq",
        "radar.samples_per_chirp": 512,
        **changes,
    }


def prepared_with(errors: dict[str, float], overrides: dict[str, Any]) -> Prepared:
    """Prepare a survey with errors in the units of `UNKNOWNS`."""
    navigation = {
        "platform.navigation.boresight_error_deg": [errors.get(n, 0.0) for n in ("roll", "pitch", "heading")],
        "platform.navigation.lever_arm_error_m": [errors.get(n, 0.0) for n in LEVER],
        "platform.navigation.time_offset_s": 1e-3 * errors.get("time_offset", 0.0),
    }
    prepared = prepare(load_scenario("hills", overrides | navigation))
    receiver = Delayed(**vars(prepared.receiver), delay_m=errors.get("range_bias", 0.0))
    return Prepared(**{**vars_of(prepared), "receiver": receiver})


def vars_of(prepared: Prepared) -> dict[str, Any]:
    """The fields of a prepared survey, without what it has derived."""
    return {name: getattr(prepared, name) for name in Prepared.__dataclass_fields__}


def echoes_of(prepared: Prepared, lines: int = 3) -> WholeEchoes:
    """Observe a survey, and return the whole echoes of its first lines."""
    _, observed = observe(prepared, Execution())
    profiles = observed.profiles
    motion = believed_motion(prepared.flight.pulses(np.arange(len(prepared))), prepared.flight.scan)
    motion = motion.rows(profiles.pulse)
    sightings = prepared.mapper.sightings(profiles, motion.pose)
    reach = sightings.repeated(mean_ranges(sightings).range_m)
    echoes = WholeEchoes(sightings=sightings, motion=motion, reach=reach)
    flown = np.flatnonzero(np.bincount(motion.line) > 50)[:lines]
    return echoes.rows(motion.within_lines & np.isin(motion.line, flown))


def ground_of(prepared: Prepared) -> Heightfield:
    """The true ground."""
    relief = next(s.relief for s in prepared.scene.scene.surfaces if s.relief is not None)
    return Heightfield(grid=relief.grid, height_m=relief.height_m)


def drawn(seed: int, names: tuple[str, ...]) -> dict[str, float]:
    """Errors drawn from their spread, in the units of `UNKNOWNS`."""
    rng = np.random.default_rng([40, seed])
    values = {name: float(sigma * rng.standard_normal()) for name, sigma in SPREAD.items()}
    return {name: values[name] for name in names}


def solved(errors: dict[str, float], overrides: dict[str, Any], names: tuple[str, ...], lines: int = 3) -> Solution:
    """Simulate a survey with errors, and estimate them over the true ground."""
    prepared = prepared_with(errors, overrides)
    prior = {name: SPREAD[name] * UNKNOWNS[name].si for name in names}
    return solve(Together(parts=(echoes_of(prepared, lines),)), ground_of(prepared), names, prior)


def trial(seed: int, names: tuple[str, ...], length_m: float, terrain_seed: int, **changes: Any) -> np.ndarray:
    """Estimate minus truth, standard deviation and whether it is told, of each error: (error, 3), kept in a folder.

    The folder is that of `SIONNA_RADAR_STUDY`, so that a study that was cut goes on.
    """
    folder = os.environ.get("SIONNA_RADAR_STUDY")
    key = f"calibration-{seed}-{length_m:g}-{terrain_seed}-{'-'.join(names)}.npy"
    path = None if folder is None else os.path.join(folder, key)  # noqa: PTH118
    if path is not None and os.path.exists(path):  # noqa: PTH110
        return np.load(path)
    truth = drawn(seed, names)
    found = solved(truth, flight(length_m, seed, terrain_seed, **changes), names)
    units = np.array([UNKNOWNS[name].si for name in names])
    error = found.value / units - np.array([truth[name] for name in names])
    result = np.column_stack([error, found.sigma / units, found.told])
    if path is not None:
        np.save(path, result)
    return result
