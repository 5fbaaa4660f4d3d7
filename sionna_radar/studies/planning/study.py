"""Flight planning: the scan, speed and lines that cover an area with the requested sampling, and the check of a plan.

A whisk-broom scan at the tilt a meets level ground, h below, at (h tan a / cos b ahead, h tan b to the side) for
the scan angle b. The distance to the next chirp's point is

    h / cos^2 b * sqrt(1 + tan^2 a sin^2 b) * (step of b),

greatest at the edge of the swath. Scan lines lie one turn of the antenna apart, flight lines a little less than a
swath. On slopes facing away from the radar a ray more than 90 deg minus the slope from nadir lies in shadow.

A plan is made for level ground. To check its sampling everywhere in the area, its beam axes are cast on the terrain of
its scenario; an echo is assumed where they meet it within the sampled range. The centre of a square of echoes s apart
is s / sqrt(2) from the nearest, so the sampling at a place is defined as sqrt(2) times that distance.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.constants import speed_of_light
from scipy.spatial import KDTree

from sionna_radar.flight.covering_lines import covering_lines
from sionna_radar.foundation.bounds import check_bounds
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.progress import advance, stage
from sionna_radar.radar.build import build_antenna
from sionna_radar.scenario import Scenario, parse_scenario
from sionna_radar.scenario.radar import ScanTable
from sionna_radar.scenario.terrain import FlatTerrain
from sionna_radar.survey.limits import MAX_CHIRPS
from sionna_radar.survey.map_positions import in_local_frame
from sionna_radar.survey.preparation import prepare
from sionna_radar.tracing.paths import trace_boresights

# Largest beam width on the ground, in ground samples.
BEAM_SAMPLES = 2.0
# Planned share of the requested sampling; the rest is a reserve for slopes, which shift the echoes.
RESERVE = 0.9
SHADOW_MARGIN_RAD = math.radians(5.0)
# Largest depth of ground below the plan's level, as a share of the altitude.
RELIEF = 0.15
MIN_INCIDENCE_RAD = math.radians(5.0)


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """Requested area and sampling, and limits of platform and radar.

    size_m: the area's extent to the right of its heading and along it: east and north for heading 0.
    position_m: the area's centre, east and north.
    heading_deg: direction of the area's second side, clockwise from north.
    sampling_m: greatest spacing between neighbouring echoes.
    overlap: share of a swath covered again by the next line; half of it lies beyond the area's border.
    greatest_slope_deg: steepest slope that must not lie in shadow.
    """

    size_m: tuple[float, float]
    sampling_m: float
    position_m: tuple[float, float] = (0.0, 0.0)
    heading_deg: float = 0.0
    altitude_m: float | None = None
    speed_mps: float = 10.0
    incidence_deg: float = 45.0
    half_swath_deg: float = 50.0
    overlap: float = 0.2
    greatest_slope_deg: float = 20.0
    most_rotation_rpm: float = 600.0
    most_chirp_rate_hz: float = 5000.0

    def to_world(self, place_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Return east and north of places relative to the area's centre, to the right of its heading and along it."""
        heading = math.radians(self.heading_deg)
        right = np.array([math.cos(heading), -math.sin(heading)])
        along = np.array([math.sin(heading), math.cos(heading)])
        return np.array(self.position_m) + place_m[:, :1] * right + place_m[:, 1:] * along


@dataclass(frozen=True, kw_only=True)
class FlightPlan:
    """A flight over level ground that covers an area; angles in radians."""

    wanted: Wanted
    altitude_m: float
    speed_mps: float
    incidence_rad: float
    half_swath_rad: float
    rotation_rpm: float
    chirp_rate_hz: float
    samples_per_chirp: int
    line_spacing_m: float
    waypoints_m: tuple[tuple[float, float], ...]

    @property
    def lines(self) -> int:
        """Number of flight lines."""
        return len(self.waypoints_m) // 2

    @property
    def swath_m(self) -> float:
        """Width of the ground covered by a line."""
        return 2 * self.altitude_m * math.tan(self.half_swath_rad)

    @property
    def flight_s(self) -> float:
        """Duration of the cruise."""
        return float(np.linalg.norm(np.diff(self.waypoints_m, axis=0), axis=1).sum()) / self.speed_mps

    @property
    def reach_m(self) -> float:
        """Greatest horizontal distance from the platform to the beam on level ground."""
        ahead = math.tan(self.incidence_rad) / math.cos(self.half_swath_rad)
        return self.altitude_m * math.hypot(ahead, math.tan(self.half_swath_rad))


def plan(wanted: Wanted, base: Scenario | None = None) -> FlightPlan:
    """Return a flight that covers an area.

    Parameters
    ----------
    wanted:
        The area and its sampling.
    base:
        Scenario with the antenna, sweep and sampling of the radar; without one, the defaults.

    Returns
    -------
    Lines, height and speed of the flight; lengths in metres, angles in radians.

    Raises
    ------
    ScenarioError
        No flight satisfies the area, the sampling and the limits.

    Examples
    --------
    >>> from sionna_radar.studies.planning import Wanted
    >>> plan(Wanted(size_m=(200.0, 150.0), sampling_m=1.0)).lines
    3
    """
    base = base or _default_base()
    _check(wanted)
    incidence, half_swath = _angles(wanted)
    altitude = wanted.altitude_m or _altitude(wanted, base, incidence, half_swath)
    stretch = math.sqrt(1 + (math.tan(incidence) * math.sin(half_swath)) ** 2) / math.cos(half_swath) ** 2
    step_rad = RESERVE * wanted.sampling_m / (altitude * stretch)
    turns_per_m = 1 / (RESERVE * wanted.sampling_m)
    max_turns_hz = min(wanted.most_rotation_rpm / 60, wanted.most_chirp_rate_hz * step_rad / (2 * math.pi))
    speed = min(wanted.speed_mps, max_turns_hz / turns_per_m)
    turns_hz = speed * turns_per_m
    lines = covering_lines(wanted.size_m, wanted.sampling_m, altitude, incidence, half_swath, wanted.overlap)
    plan = FlightPlan(
        wanted=wanted,
        altitude_m=altitude,
        speed_mps=speed,
        incidence_rad=incidence,
        half_swath_rad=half_swath,
        rotation_rpm=60 * turns_hz,
        chirp_rate_hz=2 * math.pi * turns_hz / step_rad,
        samples_per_chirp=_samples(base, altitude, incidence, half_swath),
        line_spacing_m=lines.spacing_m,
        waypoints_m=tuple((float(east), float(north)) for east, north in wanted.to_world(lines.ends_m)),
    )
    _check_chirps(plan)
    return plan


def planned_scenario(plan: FlightPlan, base: Scenario | None = None) -> Scenario:
    """Return a scenario that flies a plan.

    Parameters
    ----------
    plan:
        The flight.
    base:
        Scenario to take everything but the flight and the scan from; without one the ground is flat.

    Raises
    ------
    ScenarioError
        The flight contradicts the rest of the scenario.
    InputFileError
        The base's positions are given on the map, and its terrain cannot be read.
    """
    # The planned waypoints are local, and so must be the rest of the base.
    base = in_local_frame(base or _default_base())
    data = base.model_dump(mode="json", exclude_none=True)
    size = plan.wanted.size_m
    data["description"] = f"{size[0]:g} m x {size[1]:g} m planned at {plan.wanted.sampling_m:g} m"
    platform: dict[str, Any] = data["platform"]
    for key in list(platform):
        if key.startswith("log") or key in ("start_m", "heading_deg", "length_m", "lines"):
            platform.pop(key)
    platform |= {
        "altitude_m": plan.altitude_m,
        "speed_mps": plan.speed_mps,
        "waypoints_m": [list(point) for point in plan.waypoints_m],
    }
    data["radar"] |= {"chirp_rate_hz": plan.chirp_rate_hz, "samples_per_chirp": plan.samples_per_chirp}
    # Drop the keys of other scans.
    scan = {key: value for key, value in data["radar"]["scan"].items() if key in ScanTable.model_fields}
    data["radar"]["scan"] = scan | {
        "mode": "whisk_broom",
        "incidence_deg": math.degrees(plan.incidence_rad),
        "half_swath_deg": math.degrees(plan.half_swath_rad),
        "rotation_rpm": plan.rotation_rpm,
    }
    if isinstance(base.terrain, FlatTerrain):
        # Only a plane can be enlarged without changing the terrain.
        reach = 2 * (np.abs(np.array(plan.waypoints_m)).max(axis=0) + 1.2 * plan.reach_m + 10.0)
        data["terrain"]["size_m"] = np.maximum(np.ceil(reach), base.terrain.size_m).tolist()
    data.setdefault("dem", {})["spacing_m"] = min(base.dem.spacing_m, plan.wanted.sampling_m)
    return parse_scenario(data, source="plan")


# Height of the second part of a calibration flight over that of the first; distance of its lines, as a share of the
# swath; bank of its turns.
SECOND_HEIGHT, LINES_APART, BANK_DEG = 1.5, 0.25, 20.0


def calibration_flights(base: Scenario) -> tuple[Scenario, Scenario]:
    """Return the low and the high part of a flight that calibrates an instrument: opposite and crossing lines.

    Opposite lines part mounting from datum, crossing ones roll from pitch, and the second height the bias of ranges
    from angles. Each line is as long as the base's track, and at least two heights, besides what the beam looks ahead.

    base: scenario of a planned flight to take terrain, radar, height and speed from.

    Raises ScenarioError if the base flies a log, or the flight cannot be flown over its terrain.
    """
    base = in_local_frame(base)
    if base.platform.log is not None:
        raise ScenarioError.of("platform.log", "is flown by the base; give one with a planned flight", "plan")
    low_m, _ = base.platform.planned
    scan = base.radar.scan
    half_swath = math.radians(min(getattr(scan, "half_swath_deg", 45.0), 60.0))
    incidence = math.radians(getattr(scan, "incidence_deg", 45.0))
    flights = []
    for name, altitude_m in (("low", low_m), ("high", SECOND_HEIGHT * low_m)):
        data = base.model_dump(mode="json", exclude_none=True)
        platform: dict[str, Any] = data["platform"]
        # A beam that looks ahead meets the ground of the opposite line only beyond twice its way.
        ahead_m = low_m * math.tan(incidence)
        length = max(2 * low_m, float(platform.get("length_m", 0.0))) + 2 * ahead_m
        for key in ("start_m", "length_m", "waypoints_m", "lines", "turn_radius_m"):
            platform.pop(key, None)
        swath_m = 2 * low_m * math.tan(half_swath)
        lines = {"count": 2, "spacing_m": LINES_APART * swath_m, "length_m": length, "crossing": True}
        platform |= {"altitude_m": altitude_m, "lines": lines, "bank_deg": BANK_DEG}
        data["radar"]["samples_per_chirp"] = _samples(base, altitude_m, incidence, half_swath)
        data["description"] = f"Calibration flight, {name} part: opposite and crossing lines at {altitude_m:g} m"
        scenario = parse_scenario(data, source="plan")
        prepare(scenario)
        flights.append(scenario)
    return flights[0], flights[1]


def _check_chirps(plan: FlightPlan) -> None:
    """Raise ScenarioError for a flight of more chirps than the check of a plan allows."""
    chirps = plan.flight_s * plan.chirp_rate_hz
    if chirps > MAX_CHIRPS:
        wanted = plan.wanted
        enough_m = 1.1 * wanted.sampling_m * math.sqrt(chirps / MAX_CHIRPS)
        message = (
            f"{wanted.sampling_m:g} m over {wanted.size_m[0]:g} x {wanted.size_m[1]:g} m takes {chirps:.3g} chirps, "
            f"more than {MAX_CHIRPS:,}; raise it to about {enough_m:.2g}, or plan a part of the area at a time"
        )
        raise ScenarioError.of("sampling", message, "plan")


def _check(wanted: Wanted) -> None:
    """Raise ScenarioError for values without meaning, and for those that no scenario may have."""
    check_bounds(
        (
            ("area, east", wanted.size_m[0], wanted.sampling_m, 1e5),
            ("area, north", wanted.size_m[1], wanted.sampling_m, 1e5),
            ("sampling", wanted.sampling_m, 1e-4, 1e3),
            ("altitude", wanted.altitude_m, 1e-2, 1e5),
            ("speed", wanted.speed_mps, 1e-3, 1e3),
            ("incidence", wanted.incidence_deg, 0.0, 85.0),
            ("half-swath", wanted.half_swath_deg, 1e-2, 85.0),
            ("overlap", wanted.overlap, 0.0, 0.9),
            ("slope", wanted.greatest_slope_deg, 0.0, 80.0),
            ("position, east", wanted.position_m[0], -1e5, 1e5),
            ("position, north", wanted.position_m[1], -1e5, 1e5),
            ("heading", wanted.heading_deg, -360.0, 360.0),
            ("most-rpm", wanted.most_rotation_rpm, 1e-6, 1e6),
            ("most-chirps", wanted.most_chirp_rate_hz, 1e-2, 1e7),
        ),
        "plan",
    )


def _angles(wanted: Wanted) -> tuple[float, float]:
    """Return tilt and half swath as requested, or reduced to keep the slopes out of shadow."""
    incidence, half_swath = math.radians(wanted.incidence_deg), math.radians(wanted.half_swath_deg)
    steepest = math.pi / 2 - math.radians(wanted.greatest_slope_deg) - SHADOW_MARGIN_RAD
    # The ray at the edge lies arccos(cos a cos b) from nadir.
    if math.cos(incidence) * math.cos(half_swath) >= math.cos(steepest):
        return incidence, half_swath
    half_swath = min(half_swath, math.acos(math.cos(steepest) / math.cos(min(MIN_INCIDENCE_RAD, steepest / 2))))
    return min(incidence, math.acos(min(math.cos(steepest) / math.cos(half_swath), 1.0))), half_swath


def _altitude(wanted: Wanted, base: Scenario, incidence: float, half_swath: float) -> float:
    """Return the greatest altitude within the limits of beam width on the ground and of sampled range."""
    azimuth, elevation = build_antenna(base.radar.antenna).beamwidths_rad
    slant = 1 / math.cos(incidence)  # over the height, in the middle of the swath
    along = elevation * slant / math.cos(incidence)
    beam_limit_m = BEAM_SAMPLES * wanted.sampling_m / max(azimuth * slant, along)
    edge = 1 / (math.cos(incidence) * math.cos(half_swath))
    range_limit_m = base.radar.max_range_m / (edge * (1 + RELIEF))
    return min(beam_limit_m, range_limit_m)


def _samples(base: Scenario, altitude: float, incidence: float, half_swath: float) -> int:
    """Return the number of samples required by the farthest ground, at least that of the base."""
    farthest = altitude * (1 + RELIEF) / (math.cos(incidence) * math.cos(half_swath))
    cells = (farthest * 2 / speed_of_light - 1e-6 * base.radar.gate_delay_us) * base.radar.bandwidth_hz
    needed = cells * (2 if base.radar.sampling == "real" else 1)
    return max(base.radar.samples_per_chirp, 2 ** math.ceil(math.log2(needed)))


def _default_base() -> Scenario:
    return parse_scenario(
        {"terrain": {"kind": "flat"}, "platform": {"altitude_m": 50.0, "speed_mps": 10.0}, "radar": {"snr_db": 30.0}}
    )


# Number of checked places, per sampling interval and in all.
PLACES_PER_SAMPLE = 4
MAX_PLACES = 1_000_000
PULSES_AT_ONCE = 4096


@dataclass(frozen=True, kw_only=True)
class PlanCheck:
    """The achieved sampling of a flown plan.

    pulses: number of pulses flown.
    place_m: a grid of places over the area, border included, east and north; rows lie along the area's heading.
    sampling_m: the sampling at each, sqrt(2) times the horizontal distance to the nearest echo.
    """

    plan: FlightPlan
    pulses: int
    place_m: Float[np.ndarray, "row column 2"]
    sampling_m: Float[np.ndarray, "row column"]

    @property
    def coverage(self) -> float:
        """Share of the area with the requested sampling or finer."""
        return float(np.mean(self.sampling_m <= self.plan.wanted.sampling_m * (1 + 1e-9)))

    @property
    def coarsest_m(self) -> float:
        """Sampling at the worst place."""
        return float(self.sampling_m.max())

    def sampling_of(self, fraction: float) -> float:
        """Return the quantile of the sampling over the area: a share of it is sampled as finely or finer."""
        return float(np.quantile(self.sampling_m, fraction))


def check_plan(plan: FlightPlan, scenario: Scenario) -> PlanCheck:
    """Fly a plan over the terrain of its scenario, and return its sampling of the area.

    Parameters
    ----------
    plan:
        The flight.
    scenario:
        The scenario of `planned_scenario`.

    Raises
    ------
    ScenarioError, InputFileError
        The plan cannot be flown; see `prepare`.
    """
    prepared = prepare(scenario)
    echoes = []
    with stage("checking", len(prepared.flight)):
        for pulses in prepared.flight.blocks(PULSES_AT_ONCE):
            paths = trace_boresights(pulses, prepared.world.caster)
            in_range = paths.delay_s * speed_of_light / 2 < prepared.receiver.chirp.max_range_m
            echoes.append(paths.hit_m[in_range, :2])
            advance(len(pulses))
    place = places(plan)
    distance_m, _ = KDTree(np.concatenate(echoes)).query(place)
    return PlanCheck(plan=plan, pulses=len(prepared.flight), place_m=place, sampling_m=math.sqrt(2) * distance_m)


def places(plan: FlightPlan) -> Float[np.ndarray, "row column 2"]:
    """Return a grid of places over the area of a plan, east and north."""
    right, along = plan.wanted.size_m
    step = max(plan.wanted.sampling_m / PLACES_PER_SAMPLE, math.sqrt(right * along / MAX_PLACES))
    columns, rows = (max(2, math.ceil(side / step) + 1) for side in (right, along))
    x, y = np.meshgrid(np.linspace(-right / 2, right / 2, columns), np.linspace(-along / 2, along / 2, rows))
    return plan.wanted.to_world(np.column_stack([x.ravel(), y.ravel()])).reshape(rows, columns, 2)
