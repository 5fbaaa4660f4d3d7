"""What a labelling is computed from: slopes of columns, rays of the beam, and measured profiles."""

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.detection.ranging.plane_fit import PEDESTAL
from sionna_radar.inference.echo.beam import beam_samples
from sionna_radar.inference.echo.likelihood import Sightings, mean_ranges
from sionna_radar.mapping.stepped.labelling_kernels import CellViews, PulseEchoes

# Beam samples per map cell in the main lobe, and their lower and upper limit.
SAMPLES_PER_CELL, MIN_SAMPLES, MAX_SAMPLES = 6, 150, 750
# Reference range of reflectivities, m.
UNIT_M = 50.0


def views_of(sightings: Sightings, spacing_m: float) -> CellViews:
    """Return the poses and samples of the beam, not yet cast."""
    pose, beam = sightings.pose, sightings.beam
    # Area of the main lobe on ground as far as the nearest half of all echoes, seen at 45 deg.
    range_m = float(np.median(mean_ranges(sightings).range_m))
    area_m2 = range_m**2 * float(np.ptp(beam.azimuth) * np.ptp(beam.elevation)) * np.sqrt(2)
    count = int(np.clip(SAMPLES_PER_CELL * area_m2 / spacing_m**2, MIN_SAMPLES, MAX_SAMPLES))
    direction, power = beam_samples(beam, count)
    shape = len(pose), len(power)
    return CellViews(
        position=np.ascontiguousarray(pose.position_m),
        velocity=np.ascontiguousarray(pose.velocity_mps),
        R_world_antenna=np.ascontiguousarray(pose.R_world_antenna),
        direction=np.ascontiguousarray(direction.T),
        power=power,
        enters=np.full(shape, np.nan),
        meets=np.empty(shape),
        what=np.empty(shape, dtype=np.int32),
        entries=np.zeros(len(pose), dtype=np.int64),
        surface=np.empty(shape[::-1], dtype=np.int32),
        cell=np.empty(shape[::-1], dtype=np.int32),
        nearer=np.empty(shape[::-1]),
        farther=np.empty(shape[::-1]),
    )


def echoes_of(sightings: Sightings) -> PulseEchoes:
    """Return the measured profiles, not yet predicted."""
    profiles = sightings.profiles
    power, start = profiles.power.astype(np.float64), profiles.start
    strongest = np.zeros(len(profiles))
    some = np.diff(start) > 0
    strongest[some] = np.maximum.reduceat(power, start[:-1][some])
    return PulseEchoes(
        first=profiles.first,
        start=start,
        power=power,
        floor=profiles.noise + PEDESTAL * strongest,
        response=sightings.response,
        doppler=sightings.doppler_s,
        cell_m=float(profiles.cell_m),
        unit_m=UNIT_M,
        mean=np.empty(len(power)),
        looks=np.full(len(profiles), sightings.looks_per_cell),
    )


def slopes_within(
    height_m: Float[np.ndarray, "row column"], region: Int[np.ndarray, "row column"], spacing_m: float
) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, "row column"]]:
    """Return the slopes of each cell toward its neighbours in the same region, along x and y."""

    def along(axis: int) -> Float[np.ndarray, "row column"]:
        """Return the mean slope to the neighbours on both sides along one axis."""
        rise, same = np.diff(height_m, axis=axis) / spacing_m, np.diff(region, axis=axis) == 0
        total, count = np.zeros(height_m.shape), np.zeros(height_m.shape)
        for side in (slice(None, -1), slice(1, None)):
            where = (slice(None),) * axis + (side,)
            total[where] += np.where(same, rise, 0.0)
            count[where] += same
        return np.asarray(total / np.maximum(count, 1))

    return along(1), along(0)
