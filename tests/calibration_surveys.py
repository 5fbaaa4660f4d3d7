"""Surveys with errors of the instrument, of which `calibrate` is to find what was put in."""

import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.execution.execution import Execution
from sionna_radar.flight.instrument import UNKNOWNS, BelievedMotion, believed_motion
from sionna_radar.flight.pulses import Pose
from sionna_radar.inference.echo.likelihood import mean_ranges
from sionna_radar.mapping.echo_heights import reaching
from sionna_radar.mapping.navigation.echo_errors import RangeProfiles
from sionna_radar.mapping.navigation.joint import ground_grid
from sionna_radar.scenario import load_scenario
from sionna_radar.signal.receiver import Receiver, Reception
from sionna_radar.studies.calibration.estimation import Solution, solve, solve_over_unknown_ground
from sionna_radar.studies.calibration.instrument_echoes import CombinedEchoes
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
    return replace(prepared, receiver=receiver)


def straight(position_m: np.ndarray, speed_mps: float, axes: np.ndarray, time_s: np.ndarray) -> BelievedMotion:
    """Return the motion of a line that is flown east without a turn."""
    count = len(position_m)
    velocity_mps = np.tile([speed_mps, 0.0, 0.0], (count, 1))
    return BelievedMotion(
        pose=Pose(position_m=position_m, velocity_mps=velocity_mps, R_world_antenna=np.tile(axes, (count, 1, 1))),
        time_s=time_s,
        R_mount_antenna=np.tile(np.eye(3), (count, 1, 1)),
        turn_rad_s=np.zeros((count, 3)),
        acceleration_mps2=np.zeros((count, 3)),
        line=np.zeros(count, dtype=np.int64),
    )


def every_echo_of(prepared: Prepared) -> RangeProfiles:
    """Observe a survey, and return its whole echoes."""
    _, observed = observe(prepared, Execution())
    profiles = observed.profiles
    motion = believed_motion(prepared.flight.pulses(np.arange(len(prepared))), prepared.flight.scan)
    motion = motion.rows(profiles.pulse)
    sightings = prepared.mapper.sightings(profiles, motion.pose)
    reach = sightings.repeated(mean_ranges(sightings).range_m)
    return RangeProfiles(sightings=sightings, motion=motion, reach=reach)


def echoes_of(prepared: Prepared, lines: int = 3) -> RangeProfiles:
    """Observe a survey, and return the whole echoes of its first lines."""
    echoes = every_echo_of(prepared)
    motion = echoes.motion
    flown = np.flatnonzero(np.bincount(motion.line) > 50)[:lines]
    return echoes.rows(motion.within_lines & np.isin(motion.line, flown))


def ground_of(prepared: Prepared) -> Heightfield:
    """The true ground."""
    relief = next(s.relief for s in prepared.world.scene.surfaces if s.relief is not None)
    return Heightfield(grid=relief.grid, height_m=relief.height_m)


def drawn(seed: int, names: tuple[str, ...]) -> dict[str, float]:
    """Errors drawn from their spread, in the units of `UNKNOWNS`."""
    rng = np.random.default_rng([40, seed])
    values = {name: float(sigma * rng.standard_normal()) for name, sigma in SPREAD.items()}
    return {name: values[name] for name in names}


def line_of(echoes: RangeProfiles, number: int) -> RangeProfiles:
    """The echoes of one of the lines."""
    return echoes.rows(echoes.motion.line == np.unique(echoes.motion.line)[number])


def solved(
    errors: dict[str, float],
    overrides: dict[str, Any],
    names: tuple[str, ...],
    lines: int = 3,
    between: dict[str, float] | None = None,
) -> Solution:
    """Simulate a survey with errors, and estimate them over the true ground.

    between: standard deviations between lines of errors that drift, in the units of `UNKNOWNS`; each line is that of
    a survey with its own errors.
    """
    prepared = prepared_with(errors, overrides)
    prior = {name: SPREAD[name] * UNKNOWNS[name].si for name in names}
    if between is None:
        return solve(CombinedEchoes(parts=(echoes_of(prepared, lines),)), ground_of(prepared), names, prior)
    rng = np.random.default_rng([41, overrides["seed"]])
    parts = []
    for number in range(lines):
        own = {name: errors.get(name, 0.0) + sigma * rng.standard_normal() for name, sigma in between.items()}
        parts.append(line_of(echoes_of(prepared_with(errors | own, overrides), lines), number))
    stated = {name: sigma * UNKNOWNS[name].si for name, sigma in between.items()}
    return solve(CombinedEchoes(parts=tuple(parts)), ground_of(prepared), names, prior, stated)


def solved_over_unknown_ground(errors: dict[str, float], overrides: dict[str, Any], names: tuple[str, ...]) -> Solution:
    """Simulate a survey with errors, and estimate them together with the ground, as `calibrate` does."""
    prepared = prepared_with(errors, overrides)
    echoes = echoes_of(prepared)
    seen = mean_ranges(echoes.sightings)
    extent = reaching(prepared.mapper.grid, echoes.sightings, seen)
    grid = ground_grid(extent, echoes, prepared.scenario.dem.spacing_m)
    prior = {name: SPREAD[name] * UNKNOWNS[name].si for name in names}
    return solve_over_unknown_ground(echoes, grid, names, prior)[0]


def trial(
    seed: int,
    names: tuple[str, ...],
    overrides: dict[str, Any],
    how: Callable[..., Solution] = solved,
    **options: Any,
) -> np.ndarray:
    """Estimate minus truth, standard deviation and whether it is told, of each error: (error, 3), kept in a folder.

    The folder is that of `SIONNA_RADAR_STUDY`, so that a study that was cut goes on.
    """
    folder = os.environ.get("SIONNA_RADAR_STUDY")
    what = hashlib.sha256(repr((names, overrides, options)).encode()).hexdigest()[:12]
    path = None if folder is None else Path(folder) / f"{how.__name__}-{seed}-{what}.npy"
    if path is not None and path.exists():
        return np.load(path)
    truth = drawn(seed, names)
    found = how(truth, overrides, names, **options)
    units = np.array([UNKNOWNS[name].si for name in names])
    error = found.value / units - np.array([truth[name] for name in names])
    result = np.column_stack([error, found.sigma / units, found.observable])
    if path is not None:
        np.save(path, result)
    return result
