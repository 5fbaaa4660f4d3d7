"""Mapped area and planned swath of a survey: the ground that its beam would sweep without a pause."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.flight.pulses import MeasuredPoseSchedule, PulseSchedule
from sionna_radar.flight.scan import ElectronicScan, RotatingScan, sector
from sionna_radar.foundation.raster import Grid
from sionna_radar.mapping.coverage import closed
from sionna_radar.survey.preparation import Prepared

# Rays that are cast at once, and about how many in all.
RAYS_AT_ONCE, MOST_RAYS = 500_000, 2_000_000


@dataclass(frozen=True, kw_only=True)
class MappedGround:
    """How much ground a survey has mapped.

    mapped_m2: area of the lit cells that have a height.
    mapped_swath_m: that area over the way flown while the radar transmits; NaN for one shorter than a cell.
    coverage_of_swath: share of the cells of the planned swath that are lit and have a height. The planned swath is all
        ground that the beam's axis (or, of a beam that does not scan, its half-power width) would meet if the radar
        looked at every angle of its sector from every place of its track. NaN for flights that were recorded, and for
        scans from Python, whose sector is not known.
    """

    mapped_m2: float
    mapped_swath_m: float
    coverage_of_swath: float


def mapped_ground(prepared: Prepared, mapped: Bool[np.ndarray, "row column"]) -> MappedGround:
    """Return the mapped ground of a survey; `mapped` are the lit cells of its DEM that have a height."""
    grid = prepared.mapper.grid
    area_m2 = float(mapped.sum()) * grid.spacing_m**2
    way_m = way_flown_m(prepared.flight)
    planned = planned_swath(prepared)
    fraction = np.nan
    if planned is not None:
        of_plan, cells = planned
        row, column, inside = of_plan.cell_of(grid.centres_m[mapped.ravel()])
        fraction = float((cells[row, column] & inside).sum() / cells.sum())
    return MappedGround(
        mapped_m2=area_m2,
        mapped_swath_m=area_m2 / way_m if way_m > grid.spacing_m else np.nan,
        coverage_of_swath=fraction,
    )


def way_flown_m(schedule: PulseSchedule) -> float:
    """Return the way over ground while the radar may transmit."""
    way_m = 0.0
    for start, end in _transmitting(schedule):
        place_m = schedule.trajectory.position(np.linspace(start, end, 2 + int((end - start) / LONGEST_STEP_S)))[:, :2]
        way_m += float(np.linalg.norm(np.diff(place_m, axis=0), axis=1).sum())
    return way_m


# Between places of a track whose length is measured: a turn of 30 deg/s is short by 0.01 % then.
LONGEST_STEP_S = 0.1


def _transmitting(schedule: PulseSchedule) -> tuple[tuple[float, float], ...]:
    return schedule.trajectory.transmits_s or (schedule.trajectory.cruise_s(),)


def has_planned_swath(prepared: Prepared) -> bool:
    """Return True if a survey has a planned swath: its track and the sector of its scan are known."""
    schedule = prepared.flight
    return not isinstance(schedule, MeasuredPoseSchedule) and sector(schedule.scan, 1.0, 1.0) is not None


def planned_swath(prepared: Prepared) -> tuple[Grid, Bool[np.ndarray, "row column"]] | None:
    """Return the cells of the planned swath, aligned with those of the DEM; None where it is not known.

    Rays from places about a cell apart, toward directions as far apart on level ground, meet the scene, and the gaps
    between their cells are closed. Ground hidden from the whole track is not planned.
    """
    schedule, mapper = prepared.flight, prepared.mapper
    spacing_m = mapper.grid.spacing_m * max(1.0, np.sqrt(mapper.grid.rows * mapper.grid.columns / MOST_RAYS))
    pointings = sector(schedule.scan, prepared.plan.flown.altitude_m, spacing_m)
    if pointings is None or not has_planned_swath(prepared):
        return None
    directions = np.concatenate([pointings @ ray for ray in _rays_of_beam(prepared, spacing_m)])
    hit_m = np.concatenate(list(_hits(prepared, directions, spacing_m)))
    if not len(hit_m):
        return None
    (west, south), (east, north) = hit_m.min(axis=0), hit_m.max(axis=0)
    corner_m = mapper.grid.west_m, mapper.grid.south_m
    grid = Grid.covering(float(west), float(south), float(east), float(north), mapper.grid.spacing_m, corner_m)
    row, column, _ = grid.cell_of(hit_m)
    cells = np.zeros(grid.shape, dtype=bool)
    cells[row, column] = True
    beams_m = schedule.scan.spacing_m(prepared.plan.flown.altitude_m, 0.0, 1.0)
    gap_m = max(2 * spacing_m, beams_m) if isinstance(schedule.scan, ElectronicScan) else 2 * spacing_m
    return grid, closed(cells, gap_m, grid.spacing_m)


def _rays_of_beam(prepared: Prepared, spacing_m: float) -> list[Float[np.ndarray, " 3"]]:
    """Return unit vectors in the antenna's axes: the beam's axis, and of a beam that does not turn its width.

    That is across the track the elevation of a side-looking beam, and the azimuth of a fixed one.
    """
    scan, axis = prepared.flight.scan, np.array([1.0, 0.0, 0.0])
    if prepared.local.sensor == "lidar" or (isinstance(scan, RotatingScan) and scan.rotation_rad_s != 0):
        return [axis]
    azimuth_rad, elevation_rad = prepared.instrument.antenna.beamwidths_rad
    frames = prepared.instrument.frames
    if frames is not None:
        azimuth_rad = 2 * np.deg2rad(frames.half_view_deg)
    if isinstance(scan, ElectronicScan):
        azimuth_rad = 0.0
    slant_m = prepared.plan.flown.altitude_m / max(np.cos(scan.incidence_rad), 1e-3)
    rays = [axis]
    for width_rad, turned in ((azimuth_rad, [0.0, 1.0, 0.0]), (elevation_rad, [0.0, 0.0, 1.0])):
        off_rad = np.linspace(-width_rad / 2, width_rad / 2, 2 + int(slant_m * width_rad / spacing_m))
        rays += [np.cos(off) * axis + np.sin(off) * np.array(turned) for off in off_rad]
    return rays


def _hits(
    prepared: Prepared, directions: Float[np.ndarray, "ray 3"], spacing_m: float
) -> Iterator[Float[np.ndarray, "hit 2"]]:
    """Yield where rays along directions of the mount meet the scene, from places of the track `spacing_m` apart."""
    schedule, flown = prepared.flight, prepared.plan.flown
    yield np.zeros((0, 2))
    for start, end in _transmitting(schedule):
        time_s = np.linspace(start, end, 2 + int((end - start) * flown.speed_mps / spacing_m))
        for chunk in np.array_split(time_s, 1 + len(time_s) * len(directions) // RAYS_AT_ONCE):
            position_m, _, R_world_mount = schedule.mount(chunk)
            toward = np.einsum("pij,rj->pri", R_world_mount, directions).reshape(-1, 3)
            origin_m = np.repeat(position_m, len(directions), axis=0)
            distance_m = prepared.world.caster.cast(origin_m, toward).distance_m
            met = distance_m < prepared.receiver.chirp.max_range_m
            yield (origin_m[met] + distance_m[met, None] * toward[met])[:, :2]
