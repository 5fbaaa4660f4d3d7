"""Altimeter readings: clearances measured by a beam that does not scan, which makes no map."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from sionna_radar.accuracy.readings import Readings, readings_of
from sionna_radar.flight.scan import RotatingScan, SideLookingScan
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.mapping.points import Points
from sionna_radar.survey.preparation import Prepared

DOWN = np.array([0.0, 0.0, -1.0])
PLANTS = "vegetation"
# Times of a flight at which its clearance is looked at: about a metre apart over a kilometre.
LOOKS = 1000


def survey_readings(prepared: Prepared, points: Points) -> Readings | None:
    """Return the readings of a survey, its strongest echo of each pulse; None for a beam that scans.

    A beam whose half-power width reaches straight down reads heights above the ground, any other one distances along
    its axis.
    """
    scan = prepared.flight.scan
    still = isinstance(scan, SideLookingScan) or (isinstance(scan, RotatingScan) and scan.rotation_rad_s == 0)
    if not still or prepared.instrument.frames is not None:
        return None
    pulses = prepared.flight.pulses(np.arange(len(prepared)))
    pose, caster = pulses.true, prepared.world.caster
    reading_m = np.full(len(prepared), np.nan)
    weakest_first = np.argsort(points.power, kind="stable")
    reading_m[points.pulse[weakest_first]] = points.range_m[weakest_first]
    vertical = scan.incidence_rad <= prepared.instrument.antenna.beamwidths_rad[1] / 2
    if vertical:
        true_m = pose.position_m[:, 2] - prepared.world.ground_m(pose.position_m[:, :2])
    else:
        distance_m = caster.cast(pose.position_m, pose.boresight).distance_m
        true_m = np.where(np.isfinite(distance_m), distance_m, np.nan)
    by_readings_m = None
    steered = prepared.local.platform.height == "sensed" and prepared.custom.flight is None
    if vertical and steered and np.isfinite(reading_m).any():
        by_readings_m = _clearance_by_readings_m(prepared, pose.position_m, reading_m)
    return readings_of(
        "vertical" if vertical else "axis",
        pulses.time_s,
        reading_m,
        true_m,
        _clearance_m(prepared, pose.position_m),
        _covers(prepared, pose.position_m),
        by_readings_m,
    )


def _clearance_m(prepared: Prepared, position_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Return the heights of places over what is straight below them; NaN beyond the terrain."""
    scene = prepared.world.scene
    top_m = prepared.world.top_m(position_m[:, :2])
    if scene.vegetation is not None:
        top_m = np.fmax(top_m, scene.vegetation.tops_m(position_m[:, :2]))
    return position_m[:, 2] - top_m


def _covers(prepared: Prepared, position_m: Float[np.ndarray, "n 3"]) -> tuple[str, ...]:
    """Return the cover straight below some places: plants, or the material of the surface."""
    scene = prepared.world.scene
    hits = prepared.world.caster.cast(position_m, np.broadcast_to(DOWN, position_m.shape))
    names = np.array([surface.material for surface in scene.surfaces] + ["none"])[hits.surface]
    if scene.vegetation is not None:
        names = np.where(np.isfinite(scene.vegetation.at(position_m[:, :2])), PLANTS, names)
    return tuple(names.tolist())


def _clearance_by_readings_m(
    prepared: Prepared, position_m: Float[np.ndarray, "n 3"], reading_m: Float[np.ndarray, " n"]
) -> float | None:
    """Return the lowest clearance of the same flight over the ground as it was read; None for one that it refuses."""
    local, place = prepared.local, prepared.world.scene.georeference
    read = np.isfinite(reading_m)
    nearest, ground_m = KDTree(position_m[read, :2]), position_m[read, 2] - reading_m[read]
    try:
        flown = prepared.plan.route.fly(
            lambda place_m: ground_m[nearest.query(place_m)[1]], local.seed, place.origin_m[2] if place else 0.0
        )
    except ScenarioError:
        return None
    start_s, end_s = flown.trajectory.cruise_s()
    clearance_m = _clearance_m(prepared, flown.trajectory.position(np.linspace(start_s, end_s, LOOKS)))
    return float(np.nanmin(clearance_m)) if np.isfinite(clearance_m).any() else None
