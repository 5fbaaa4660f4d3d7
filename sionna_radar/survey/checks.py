"""Whether a survey can be flown: the checks that need the terrain and the flight."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.flight.pulses import PulseSchedule
from sionna_radar.flight.scan import Scan
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.mapping.dem_grid import Extent
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario import Scenario
from sionna_radar.scene.build import BuiltScene
from sionna_radar.surfaces.radar_material import as_radar_material

SAMPLED_PULSES = 2000
LOST_SHARE = 0.1
# Of the phase of a point over a chirp, beyond what even motion gives.
MOST_BEND_RAD = 0.5
# Backscatter that no receiver knows from none.
LEAST_SIGMA0 = 1e-20


@dataclass(frozen=True)
class BoresightHits:
    """Boresights of pulses spread over the survey: where they start, how far they reach, what they hit."""

    origin_m: Float[np.ndarray, "look 3"]
    direction: Float[np.ndarray, "look 3"]
    range_m: Float[np.ndarray, " look"]

    @property
    def hit_m(self) -> Float[np.ndarray, "hit 3"]:
        """Where those that hit something do."""
        hit = np.isfinite(self.range_m)
        return self.origin_m[hit] + self.range_m[hit, None] * self.direction[hit]

    @property
    def extent_m(self) -> Extent:
        """West, south, east and north of what they hit; ScenarioError where they hit nothing."""
        if not len(self.hit_m):
            raise ScenarioError([Problem("terrain", "no beam meets it; move the track, or enlarge the terrain")])
        (west, south), (east, north) = self.hit_m[:, :2].min(axis=0), self.hit_m[:, :2].max(axis=0)
        return float(west), float(south), float(east), float(north)


def boresight_hits(schedule: PulseSchedule, built: BuiltScene) -> BoresightHits:
    """Return the boresights of pulses spread over a survey."""
    pose = schedule.sample(SAMPLED_PULSES).true
    hits = built.caster.cast(pose.position_m, pose.boresight)
    return BoresightHits(pose.position_m, pose.boresight, hits.distance_m)


def check_nominal_range(altitude_m: float, scan: Scan, chirp: Chirp, duration_s: float) -> None:
    """Refuse a scan that looks farther over level ground than the radar reaches, before anything is built."""
    pointing = scan.point(np.linspace(0.0, duration_s, SAMPLED_PULSES))
    down = pointing.R_mount_antenna[pointing.active, 2, 0]
    down = down[down > 0]
    slant_m = altitude_m / float(down.min()) if len(down) else 0.0
    if slant_m > chirp.max_range_m:
        message = (
            f"at {altitude_m:g} m the beam meets level ground {slant_m:.1f} m away, beyond the "
            f"{chirp.max_range_m:.1f} m of unambiguous range; raise radar.samples_per_chirp, or lower "
            "platform.altitude_m, radar.bandwidth_hz or the scan angles"
        )
        raise ScenarioError([Problem("radar.samples_per_chirp", message)])


def check_pulses(schedule: PulseSchedule, scenario: Scenario) -> None:
    """Refuse a flight without a pulse."""
    if len(schedule) == 0:
        start, end = schedule.trajectory.cruise_s()
        message = (
            f"no pulse falls into the sector during the {end - start:.3g} s of cruise at "
            f"{scenario.radar.chirp_rate_hz:g} chirps/s; lengthen platform.length_m or widen radar.scan.half_swath_deg"
        )
        raise ScenarioError([Problem("radar.scan", message)])


def check_rotors(scenario: Scenario, chirp: Chirp) -> None:
    """Refuse rotors that turn so far in a chirp that their points do not move evenly during it.

    What is left of the phase at the ends of the chirp is 4 pi / wavelength times half the acceleration times the square
    of half its duration.
    """
    problems = []
    for number, target in enumerate(scenario.targets):
        for index, rotor in enumerate(target.rotors):
            acceleration = (2 * np.pi * rotor.rotation_rpm / 60) ** 2 * rotor.radius_m
            bend_rad = np.pi / (2 * chirp.wavelength_m) * acceleration * chirp.duration_s**2
            if bend_rad > MOST_BEND_RAD:
                needed_hz = chirp.rate_hz * np.sqrt(bend_rad / MOST_BEND_RAD)
                message = (
                    f"{rotor.rotation_rpm:g} bends the echo of its tips by {bend_rad:.3g} rad in a chirp; lower it, or "
                    f"raise radar.chirp_rate_hz to {needed_hz:.3g} or more"
                )
                problems.append(Problem(f"targets.{number}.rotors.{index}.rotation_rpm", message))
    if problems:
        raise ScenarioError(problems)


def check_vegetation(scenario: Scenario, antenna: Antenna) -> None:
    """Refuse plants before an antenna whose echo of them is unknown."""
    if scenario.vegetation and (antenna.circular or antenna.receives != "co"):
        message = "the echo of [[vegetation]] is known for linear co-polar antennas alone; set 'V' or 'H', and 'co'"
        raise ScenarioError([Problem("radar.antenna.polarization", message)])


def check_bounces(scenario: Scenario, built: BuiltScene) -> None:
    """Refuse second bounces in a scene without mirrors, and before plants, through which they are not followed."""
    if scenario.tracing.bounces == 1 or scenario.sensor == "lidar":
        return
    scene = built.scene
    if scene.vegetation is not None:
        message = "2 is not traced through [[vegetation]]; set 1, or remove the plants"
        raise ScenarioError([Problem("tracing.bounces", message)])
    used = {surface.material for surface in scene.surfaces}
    if all(as_radar_material(scene.materials[name]).mirror is None for name in used):
        message = (
            "2 needs a surface that reflects as a mirror, and there is none; set 1, or give one of "
            f"{', '.join(f'materials.{name}' for name in sorted(used))} specular = true"
        )
        raise ScenarioError([Problem("tracing.bounces", message)])


def check_reference(scenario: Scenario, built: BuiltScene, incidence_rad: float) -> None:
    """Refuse noise that counts from the echo of ground that returns none, such as calm water aside of its flash."""
    if scenario.radar.snr_db is None or scenario.sensor == "lidar":
        return
    name = built.scene.ground_material
    sigma0 = float(as_radar_material(built.scene.materials[name]).co_polar.sigma0(np.array([incidence_rad]))[0])
    if sigma0 < LEAST_SIGMA0:
        message = (
            f"counts from the echo of {name!r} at {np.rad2deg(incidence_rad):.0f} deg of incidence, which returns "
            "nothing there; give radar.transmit_power_dbm and radar.noise_figure_db instead"
        )
        raise ScenarioError([Problem("radar.snr_db", message)])


def check_geometry(hits: BoresightHits, built: BuiltScene, chirp: Chirp) -> None:
    """Refuse a flight through the terrain, beams that leave it, and ground beyond the sampled ranges."""
    low, high = built.scene.bounds_m
    problems = []
    origin_m = hits.origin_m
    top = float(max(high[2], origin_m[:, 2].max())) + 10.0
    surface = built.caster.from_above(origin_m[:, :2], top)
    clearance = origin_m[:, 2] - np.where(np.isnan(surface), -np.inf, surface)
    if clearance.min() <= 0:
        x, y, z = origin_m[np.argmin(clearance)]
        message = (
            f"the radar would be {-clearance.min():.1f} m under the surface at ({x:.1f}, {y:.1f}, {z:.1f}) m; "
            "raise platform.altitude_m, move the track, or set platform.height = 'terrain_following'"
        )
        problems.append(Problem("platform.altitude_m", message))
    problems += _among_plants(origin_m, built)
    missed = np.isinf(hits.range_m) & ~_over_hole(hits, low, high)
    if missed.any():
        message = (
            f"{missed.mean():.0%} of the beams leave the terrain, which spans {low[0]:.0f} to {high[0]:.0f} m east "
            f"and {low[1]:.0f} to {high[1]:.0f} m north; enlarge it, shorten platform.length_m, or lower "
            "platform.altitude_m, radar.scan.incidence_deg or radar.scan.half_swath_deg"
        )
        problems.append(Problem("radar.scan", message))
    elif np.isinf(hits.range_m).mean() > 0.5:
        message = (
            f"{np.isinf(hits.range_m).mean():.0%} of the beams fall into holes of the terrain, where it has no data; "
            "move the track, or terrain.centre_lonlat_deg, to where it has"
        )
        problems.append(Problem("terrain", message))
    lost = np.isfinite(hits.range_m) & (hits.range_m > chirp.max_range_m)
    if lost.mean() > LOST_SHARE:
        message = (
            f"{lost.mean():.0%} of the beams meet the ground beyond the {chirp.max_range_m:.1f} m of "
            "unambiguous range; raise radar.samples_per_chirp, or set platform.height = 'terrain_following'"
        )
        problems.append(Problem("radar.samples_per_chirp", message))
    if problems:
        raise ScenarioError(problems)


def _among_plants(origin_m: Float[np.ndarray, "look 3"], built: BuiltScene) -> list[Problem]:
    """Return what is wrong with a flight that leads through [[vegetation]]."""
    if built.scene.vegetation is None:
        return []
    under_m = built.scene.vegetation.tops_m(origin_m[:, :2]) - origin_m[:, 2]
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
    """Return which beams would meet the lowest ground inside the terrain's outline: they fall through a hole."""
    down = np.minimum(hits.direction[:, 2], -1e-6)
    reach = (low[2] - hits.origin_m[:, 2]) / down
    foot = hits.origin_m[:, :2] + reach[:, None] * hits.direction[:, :2]
    return np.all((foot > low[:2]) & (foot < high[:2]), axis=1)
