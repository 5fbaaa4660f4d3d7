"""Checks of a flight over a world, by where its beams meet it."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import PulseSchedule
from sionna_radar.flight.scan import RotatingScan
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.raster import box_around
from sionna_radar.mapping.mapper import Extent
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario import Scenario
from sionna_radar.scene.build import World
from sionna_radar.surfaces.backscatter import Backscatter
from sionna_radar.survey.instrument import Instrument

logger = logging.getLogger("sionna_radar")

SAMPLED_PULSES = 2000
LOST_SHARE = 0.1
# Smallest sigma0 that counts as a return.
MIN_SIGMA0 = 1e-20
# Share of pulses with echoes outside the searched ranges above which a warning is given.
FOLDED_SHARE_WARNED = 0.01


@dataclass(frozen=True)
class BoresightHits:
    """Boresights of pulses sampled over the survey: origins, ranges and hits."""

    origin_m: Float[np.ndarray, "look 3"]
    direction: Float[np.ndarray, "look 3"]
    range_m: Float[np.ndarray, " look"]
    range_rate_mps: Float[np.ndarray, " look"]

    @property
    def hit_m(self) -> Float[np.ndarray, "hit 3"]:
        """Hit points of the boresights that meet a surface."""
        hit = np.isfinite(self.range_m)
        return self.origin_m[hit] + self.range_m[hit, None] * self.direction[hit]

    @property
    def extent_m(self) -> Extent:
        """West, south, east and north of the hit points; ScenarioError if there are none."""
        if not len(self.hit_m):
            raise ScenarioError.of("terrain", "no beam meets it; move the track, or enlarge the terrain")
        return box_around(self.hit_m[:, :2])


def boresight_hits(schedule: PulseSchedule, world: World) -> BoresightHits:
    """Return the boresights of pulses spread over a survey."""
    pose = schedule.sample(SAMPLED_PULSES).true
    hits = world.caster.cast(pose.position_m, pose.boresight)
    return BoresightHits(pose.position_m, pose.boresight, hits.distance_m, pose.boresight_range_rate_mps)


def check_nominal_range(instrument: Instrument, altitude_m: float, duration_s: float) -> None:
    """Raise ScenarioError if the scan looks farther over level ground than the radar's range."""
    chirp, pointing = instrument.chirp, instrument.scan.point(np.linspace(0.0, duration_s, SAMPLED_PULSES))
    down = pointing.R_mount_antenna[pointing.active, 2, 0]
    down = down[down > 0]
    slant_m = altitude_m / float(down.min()) if len(down) else 0.0
    if slant_m > chirp.max_range_m:
        message = (
            f"at {altitude_m:g} m the beam meets level ground {slant_m:.1f} m away, beyond the "
            f"{chirp.max_range_m:.1f} m of unambiguous range; raise radar.samples_per_chirp, or lower "
            "platform.altitude_m, radar.bandwidth_hz or the scan angles"
        )
        raise ScenarioError.of("radar.samples_per_chirp", message)


def check_pulses(schedule: PulseSchedule, chirp_rate_hz: float) -> None:
    """Refuse a flight without a pulse."""
    if len(schedule) == 0:
        start, end = schedule.trajectory.cruise_s()
        message = (
            f"no pulse falls into the sector during the {end - start:.3g} s of cruise at "
            f"{chirp_rate_hz:g} chirps/s; lengthen platform.length_m or widen radar.scan.half_swath_deg"
        )
        raise ScenarioError.of("radar.scan", message)


def check_reference(scenario: Scenario, name: str, ground: Backscatter, incidence_rad: float) -> None:
    """Raise ScenarioError if `snr_db` refers to ground, named, without backscatter, such as calm water off nadir."""
    if scenario.radar.snr_db is None or scenario.sensor == "lidar":
        return
    if float(ground.sigma0(np.array([incidence_rad]))[0]) < MIN_SIGMA0:
        message = (
            f"counts from the echo of {name!r} at {np.rad2deg(incidence_rad):.0f} deg of incidence, which returns "
            "nothing there; give radar.transmit_power_dbm and radar.noise_figure_db instead"
        )
        raise ScenarioError.of("radar.snr_db", message)


def check_geometry(hits: BoresightHits, world: World, chirp: Chirp) -> None:
    """Raise ScenarioError for a flight inside the terrain, beams that leave it, or ground out of range."""
    low, high = world.scene.bounds_m
    problems = []
    origin_m = hits.origin_m
    top = float(max(high[2], origin_m[:, 2].max())) + 10.0
    surface = world.caster.from_above(origin_m[:, :2], top)
    clearance = origin_m[:, 2] - np.where(np.isnan(surface), -np.inf, surface)
    if clearance.min() <= 0:
        x, y, z = origin_m[np.argmin(clearance)]
        message = (
            f"the radar would be {-clearance.min():.1f} m under the surface at ({x:.1f}, {y:.1f}, {z:.1f}) m; "
            "raise platform.altitude_m, move the track, or set platform.height = 'terrain_following'"
        )
        problems.append(Problem("platform.altitude_m", message))
    problems += _among_plants(origin_m, world)
    in_hole = np.isinf(hits.range_m) & _over_hole(hits, low, high)
    missed = np.isinf(hits.range_m) & ~in_hole
    if missed.any():
        message = (
            f"{100 * missed.mean():.3g} % of the beams leave the terrain, which spans {low[0]:.0f} to {high[0]:.0f} m "
            f"east and {low[1]:.0f} to {high[1]:.0f} m north; enlarge it, shorten the flight "
            "(platform.length_m, log_stop_s), or lower platform.altitude_m, radar.scan.incidence_deg or "
            "radar.scan.half_swath_deg"
        )
        problems.append(Problem("radar.scan", message))
    elif np.isinf(hits.range_m).mean() > 0.5:
        message = (
            f"{np.isinf(hits.range_m).mean():.0%} of the beams fall into holes of the terrain, where it has no data; "
            "move the track, or terrain.centre_lonlat_deg, to where it has"
        )
        problems.append(Problem("terrain", message))
    elif in_hole.any():
        logger.warning(
            "terrain: %.3g %% of the beams fall into its holes, where it has no data, as where buildings are cut out "
            "of a terrain model; nothing comes back from there: set terrain.holes = 'fill', or give a surface model",
            100 * in_hole.mean(),
        )
    lost = np.isfinite(hits.range_m) & (hits.range_m > chirp.max_range_m)
    if lost.mean() > LOST_SHARE:
        message = (
            f"{lost.mean():.0%} of the beams meet the ground beyond the {chirp.max_range_m:.1f} m of "
            "unambiguous range; raise radar.samples_per_chirp, or set platform.height = 'terrain_following'"
        )
        problems.append(Problem("radar.samples_per_chirp", message))
    elif lost.mean() > FOLDED_SHARE_WARNED:
        logger.warning(
            "%.2g %% of the beams meet the ground beyond the %.1f m of unambiguous range, up to %.0f m away, and their "
            "echoes are lost or fold to wrong ranges; raise radar.samples_per_chirp, or set processing.expected_ground",
            100 * lost.mean(),
            chirp.max_range_m,
            hits.range_m[lost].max(),
        )
    near = hits.range_m < chirp.gate_m
    if near.mean() > LOST_SHARE:
        message = (
            f"{near.mean():.0%} of the beams meet the ground nearer than the {chirp.gate_m:.1f} m of the range gate; "
            f"lower radar.gate_delay_us to {1.9e6 * hits.range_m.min() / speed_of_light:.3g}, or fly higher"
        )
        problems.append(Problem("radar.gate_delay_us", message))
    if problems:
        raise ScenarioError(problems)


def _among_plants(origin_m: Float[np.ndarray, "look 3"], world: World) -> list[Problem]:
    """Return the problem of a flight path inside [[vegetation]], if any."""
    if world.scene.vegetation is None:
        return []
    under_m = world.scene.vegetation.tops_m(origin_m[:, :2]) - origin_m[:, 2]
    deepest = int(np.argmax(under_m))
    if under_m[deepest] < 0:
        return []
    x, y, z = origin_m[deepest]
    message = (
        f"the radar would be {under_m[deepest]:.1f} m under the tops of [[vegetation]] at ({x:.1f}, {y:.1f}, {z:.1f}) "
        "m; raise platform.altitude_m, or move the track"
    )
    return [Problem("platform.altitude_m", message)]


def _over_hole(
    hits: BoresightHits, low: Float[np.ndarray, " 3"], high: Float[np.ndarray, " 3"]
) -> Bool[np.ndarray, " look"]:
    """Return the mask of beams through holes of the terrain, extended to its lowest height."""
    down = np.minimum(hits.direction[:, 2], -1e-6)
    reach = (low[2] - hits.origin_m[:, 2]) / down
    foot = hits.origin_m[:, :2] + reach[:, None] * hits.direction[:, :2]
    return np.all((foot > low[:2]) & (foot < high[:2]), axis=1)


def warn_of_posting(
    posting_m: float | None, range_m: Float[np.ndarray, " look"], beamwidths_rad: tuple[float, float]
) -> None:
    """Warn if the spacing of a terrain file exceeds the footprint, so that DEM errors omit finer detail."""
    footprint_m = float(np.median(range_m[np.isfinite(range_m)])) * min(beamwidths_rad)
    if posting_m is not None and posting_m > footprint_m:
        logger.warning(
            "terrain: its heights are %.3g m apart, footprints %.2g m wide: the error is that against "
            "ground interpolated between them, without finer detail; give finer ones, or set terrain.roughen of a file",
            posting_m,
            footprint_m,
        )


def warn_of_repeated_angles(instrument: Instrument, altitude_m: float, speed_mps: float, stagger: float) -> None:
    """Warn of a turning beam that returns to the same angles while it passes over its footprint, and leaves gaps.

    A place stays within the half-power footprint, h / cos^2(incidence) times the elevation width along the track, for
    as many turns as fit into that length. With n chirps a turn, e off a whole number, each turn's angles are those of
    the last one shifted by e steps of 2 pi / n (of staggered chirps, which repeat in pairs, the number must be even).
    While e shifts do not make up a step, 1 - (turns - 1) e of every step is not visited, and stays dark if the beam,
    which turns by its azimuth width / cos(incidence) (conical: sin) to move by its width, does not reach across.
    """
    scan, chirp_rate_hz = instrument.scan, instrument.pulse_rate_hz
    if not isinstance(scan, RotatingScan) or scan.rotation_rad_s == 0:
        return
    azimuth_rad, elevation_rad = instrument.antenna.beamwidths_rad
    down, side = np.cos(scan.incidence_rad), np.sin(scan.incidence_rad)
    arm = side if scan.mode == "conical" else down
    if min(arm, down) <= 0:
        return
    turn_s, width_rad = 2 * np.pi / abs(scan.rotation_rad_s), azimuth_rad / arm
    turns = int(altitude_m / down**2 * elevation_rad / (speed_mps * turn_s))
    chirps, together = turn_s * chirp_rate_hz / (1 + stagger / 2), 2 if stagger > 0 else 1
    off = abs(chirps - together * round(chirps / together))
    step_rad = 2 * np.pi / chirps
    gap_rad = step_rad * ((1 + stagger) / (1 + stagger / 2) - (turns - 1) * off)
    if turns < 2 or off * turns >= 1 or not off * step_rad < width_rad < gap_rad:
        return
    logger.warning(
        "radar.scan.rotation_rpm = %g at %g chirps/s makes %.5g chirps a turn: in the %d turns during which the beam "
        "passes over its footprint it returns to nearly the same angles, and of the %.2g deg between them it lights "
        "%.2g deg; ground stays dark there. Set radar.scan.rotation_rpm = %.6g, or another radar.chirp_rate_hz",
        60 / turn_s,
        chirp_rate_hz,
        chirps,
        turns,
        *np.rad2deg([gap_rad, width_rad]),
        60 / turn_s * chirps / (round(chirps) + 1 / turns),
    )


def warn_of_folded(
    sweeps: Sequence[Chirp],
    range_m: Float[np.ndarray, " look"],
    range_rate_mps: Float[np.ndarray, " look"],
    min_range_m: float,
) -> None:
    """Warn if ground lies nearer than the searched ranges, or Doppler shifts move its echoes out of them.

    A real beat signal does not distinguish a frequency from its negative: ground at range r, shifted by -d below
    zero, appears at d - r, and Doppler correction puts it at 2 d - r.

    range_m, range_rate_mps: of the ground on the beam's axis, in pulses spread over the survey.
    """
    min_range_m = max([min_range_m, *(chirp.gate_m for chirp in sweeps)])
    if (near := np.mean(range_m < min_range_m)) > FOLDED_SHARE_WARNED:
        logger.warning(
            "%.0f%% of the beams meet the ground nearer than %.3g m, down to %.3g m, where no echo is searched; lower "
            "processing.min_range_m, or fly higher",
            100 * near,
            min_range_m,
            range_m.min(),
        )
    for chirp in sweeps:
        shift_m = chirp.doppler_range_m(range_rate_mps)
        room_m = np.where(shift_m < 0, range_m - min_range_m, chirp.max_range_m - range_m)
        excess = np.where(np.isfinite(range_m) & (room_m > 0), np.abs(shift_m) / np.maximum(room_m, 1e-9), 0.0)
        if np.mean(excess > 1) > FOLDED_SHARE_WARNED:
            worst = int(np.argmax(excess))
            logger.warning(
                "in %.0f%% of the pulses Doppler shifts the ground's echo out of the searched ranges, %.3g to %.0f m: "
                "it is lost, or folds to a wrong range (ground %.1f m away shifts by %+.1f m); raise "
                "radar.chirp_rate_hz to %.3g, or fly %s or slower",
                100 * np.mean(excess > 1),
                min_range_m,
                chirp.max_range_m,
                range_m[worst],
                shift_m[worst],
                1.01 * excess[worst] * chirp.rate_hz / len(sweeps),
                "higher" if shift_m[worst] < 0 else "lower",
            )
            return
