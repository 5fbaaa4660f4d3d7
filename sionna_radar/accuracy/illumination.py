"""The mappable ground of a survey: in the main beam, and not in geometric shadow."""

from collections.abc import Sequence
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.raster import Raster
from sionna_radar.mapping.coverage import Illumination
from sionna_radar.radar.antenna import LIT, Antenna, in_main_lobe, voltage_at
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.paths import Paths


def main_beam_hits(
    paths: Paths, pulses: Pulses, antenna: Antenna, beams: Sequence[Antenna] = ()
) -> tuple[Float[np.ndarray, "hit 3"], Float[np.ndarray, "hit 3"]]:
    """Return the surface hits of a block's paths inside the main beam, and the true radar positions.

    beams: of an electronic scan, each with its own pattern.
    """
    pose = pulses.true
    start = np.searchsorted(paths.pulse, np.append(pulses.index, pulses.index[-1] + 1))
    direction = np.empty((len(paths), 3))
    ahead(start, pose.position_m, np.ascontiguousarray(pose.R_world_antenna), paths.hit_m, direction)
    row = np.repeat(np.arange(len(pulses)), np.diff(start))
    in_lobe = paths.surface >= 0
    if beams and pulses.beam is not None:
        beam = pulses.beam[row]
        for number in np.unique(beam):
            hits = np.flatnonzero(beam == number)
            in_lobe[hits] &= in_main_lobe(beams[int(number)], direction[hits])
    else:
        in_lobe &= in_main_lobe(antenna, direction)
    return paths.hit_m[in_lobe], pose.position_m[row[in_lobe]]


def light(paths: Paths, pulses: Pulses, antenna: Antenna, beams: Sequence[Antenna], lit: Illumination) -> None:
    """Mark the cells below the hits of `main_beam_hits`; for a separable antenna in one pass."""
    if not antenna.separable or (beams and pulses.beam is not None):
        lit.add(*main_beam_hits(paths, pulses, antenna, beams))
        return

    pose = pulses.true
    start = np.searchsorted(paths.pulse, np.append(pulses.index, pulses.index[-1] + 1))
    lobe = (*(np.ascontiguousarray(cut.voltage) for cut in (antenna.azimuth, antenna.elevation)), LIT)
    # In the precision of the hits, as NumPy promotes Python numbers.
    grid = (paths.hit_m.dtype.type(number) for number in (lit.grid.west_m, lit.grid.south_m, lit.grid.spacing_m))
    axes = np.ascontiguousarray(pose.R_world_antenna)
    light_cells(start, pose.position_m, axes, paths.hit_m, paths.surface, lobe, tuple(grid), *lit.columns)


@compiled
@no_type_check
def ahead(first, position, axes, hit, out):
    """Write the unit vectors from the antennas to hits, in the antennas' frames.

    first: index of each pulse's first hit, plus the overall end.
    """
    for pulse in range(len(position)):
        for n in range(first[pulse], first[pulse + 1]):
            x, y, z = hit[n, 0] - position[pulse, 0], hit[n, 1] - position[pulse, 1], hit[n, 2] - position[pulse, 2]
            distance = np.sqrt(x * x + y * y + z * z)
            for k in range(3):
                out[n, k] = (x * axes[pulse, 0, k] + y * axes[pulse, 1, k] + z * axes[pulse, 2, k]) / distance


@compiled
@no_type_check
def light_cells(first, position, axes, hit, surface, lobe, grid, origin, seen):
    """Mark the cells of a grid under hits on surfaces inside the main lobe of a separable antenna.

    lobe: the cuts in azimuth and elevation, and the minimum two-way power over the peak's.
    grid: centre of its south-western cell, and the spacing, in the precision of the hits.
    origin, seen: radar position of each cell's last hit, and the mask of hit cells; both are written.
    """
    azimuth, elevation, level = lobe
    west, south, spacing = grid
    rows, columns = seen.shape
    for pulse in range(len(position)):
        px, py, pz = position[pulse, 0], position[pulse, 1], position[pulse, 2]
        for n in range(first[pulse], first[pulse + 1]):
            if surface[n] < 0:
                continue
            x, y, z = hit[n, 0] - px, hit[n, 1] - py, hit[n, 2] - pz
            distance = np.sqrt(x * x + y * y + z * z)
            ahead = (x * axes[pulse, 0, 0] + y * axes[pulse, 1, 0] + z * axes[pulse, 2, 0]) / distance
            left = (x * axes[pulse, 0, 1] + y * axes[pulse, 1, 1] + z * axes[pulse, 2, 1]) / distance
            up = (x * axes[pulse, 0, 2] + y * axes[pulse, 1, 2] + z * axes[pulse, 2, 2]) / distance
            voltage = voltage_at(azimuth, left) * voltage_at(elevation, up)
            gain = voltage * voltage * max(ahead, 0.0)
            if not gain * gain >= level:
                continue
            column, row = np.rint((hit[n, 0] - west) / spacing), np.rint((hit[n, 1] - south) / spacing)
            if 0 <= row < rows and 0 <= column < columns:
                i, j = int(row), int(column)
                seen[i, j] = True
                origin[i, j, 0], origin[i, j, 1], origin[i, j, 2] = px, py, pz


TOLERANCE_M = 0.05


def shadowed(
    truth: Raster,
    caster: RayCaster,
    track_m: Float[np.ndarray, "2 3"],
    incidence_rad: float,
    half_swath_rad: float,
) -> Bool[np.ndarray, "row column"]:
    """Return the mask of true-surface cells in radar shadow: scanned by a whisk-broom but not visible from the track.

    The angle between beam and track is the complement of the incidence. A cell that is y across and z below the
    track is therefore scanned from the place x = tan(incidence) hypot(y, z) short of it, and only from there.

    Parameters
    ----------
    truth, caster:
        The true surface as a raster, and rays against it.
    track_m:
        Start and end of a straight, level flight.
    incidence_rad, half_swath_rad:
        The scan.

    """
    start, end = track_m
    length = float(np.linalg.norm(end - start))
    ahead = (end - start) / length
    cell = np.column_stack([truth.grid.centres_m, truth.height_m.ravel()])
    cell[:, 2] = np.where(np.isfinite(cell[:, 2]), cell[:, 2], 0.0)
    offset = cell - start
    across = offset[:, 0] * ahead[1] - offset[:, 1] * ahead[0]
    below = -offset[:, 2]
    along = offset @ ahead - np.tan(incidence_rad) * np.hypot(across, below)
    scanned = (along >= 0) & (along <= length) & (np.abs(np.arctan2(across, below)) <= half_swath_rad)
    scanned &= truth.filled.ravel()
    visible = caster.visible(start + along[:, None] * ahead, cell, TOLERANCE_M)
    return (scanned & ~visible).reshape(truth.grid.shape)
