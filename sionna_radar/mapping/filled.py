"""Planes through parts that fill the beam no more than partly: roofs, seen across their edges.

Located echoes lie on the axes of their beams. A roof that ends within the beam sends its echo from what it fills of it:
at the far edge that is nearer than the axis would meet the roof, and on the axis so short a range is too high. So once
it is known which cells are roof, the mean range over what they fill is predicted for each echo, and the plane is fitted
to the differences.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.flight.pulses import rows_of
from sionna_radar.foundation.raster import Grid
from sionna_radar.mapping.echo_model import Sightings
from sionna_radar.mapping.heights import Heights
from sionna_radar.mapping.lobe_samples import lobe_samples
from sionna_radar.mapping.map_parts import FEWEST_CELLS
from sionna_radar.mapping.planes import Plane, robust_plane
from sionna_radar.mapping.points import Points

SAMPLES = 400
# Of a beam that a part fills less of, its edges decide, and they are known to a cell. By trial of 0.3 to 0.9 on the
# seeds 1-8 of `buildings`; on 9-24 it serves as well.
MOST_OF_BEAM = 0.8
ROUNDS = 3
LEAST_FALL = 1e-3


@dataclass(frozen=True)
class FilledBeams:
    """Located echoes, and the beams that they were seen with."""

    points: Points
    sightings: Sightings

    def refitted(self, plane: Plane, inside: Bool[np.ndarray, "row column"], grid: Grid, step_m: float) -> Plane:
        """Return the plane of a part by the echoes that it sends from what it fills of their beams.

        Parameters
        ----------
        plane:
            The plane through located echoes, which stays where too few beams are filled.
        inside, grid:
            The cells of the part, of this grid.
        step_m:
            Echoes farther above or below are not of this part.

        """
        found = plane
        for _ in range(ROUNDS):
            heights = self._heights(found, inside, grid, step_m)
            if len(heights) < FEWEST_CELLS:
                return plane
            found = robust_plane(heights)
        return found

    def _heights(self, plane: Plane, inside: Bool[np.ndarray, "row column"], grid: Grid, step_m: float) -> Heights:
        """Return what the echoes say about a plane, as heights in the middle of what it fills of each beam."""
        (height, east, north), (x, y) = plane.coefficients, plane.middle_m
        near = self._near(grid, plane, step_m)
        points, pose = self.points.rows(near), self.sightings.pose.rows(self._row[near])
        sample, share = self._samples
        ray = np.einsum("pij,kj->pki", pose.R_world_antenna, sample)
        origin = pose.position_m

        def falls(direction: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "..."]:
            """Return by how much nearer the plane a ray comes per range; rays that rise over it come no nearer."""
            toward = east * direction[..., 0] + north * direction[..., 1] - direction[..., 2]
            return np.asarray(np.maximum(toward, LEAST_FALL))

        above = origin[:, 2] - height - east * (origin[:, 0] - x) - north * (origin[:, 1] - y)
        range_m = above[:, None] / falls(ray)
        place = origin[:, None] + range_m[..., None] * ray
        row, column, on = grid.cell_of(place.reshape(-1, 3))
        on[on] = inside[row[on], column[on]]
        power = np.where(range_m > 0, share / range_m**2, 0.0)
        own = power * on.reshape(power.shape)
        total = own.sum(axis=1)
        filled = total > MOST_OF_BEAM * power.sum(axis=1)
        own = own[filled] / total[filled, None]
        mean_m = np.sum(own * range_m[filled], axis=1)
        middle = np.einsum("pk,pki->pi", own, place[filled])
        excess = (mean_m - points.range_m[filled]) * falls(pose.boresight[filled])
        alike = np.abs(excess) < step_m
        count = int(alike.sum())
        level = height + (middle[alike, :2] - plane.middle_m) @ plane.coefficients[1:] + excess[alike]
        return Heights.at_places(middle[alike, :2], level, np.ones(count))

    def _near(self, grid: Grid, plane: Plane, step_m: float) -> Bool[np.ndarray, " point"]:
        """Return the echoes whose axes may be over a window, and that may lie on a plane."""
        west, east, south, north = grid.extent_m
        x, y, z = self.points.position_m.T
        reach_m = 2 * float(self.points.range_m.max(initial=0.0)) * float(np.ptp(self.sightings.beam.elevation))
        beside = (x > west - reach_m) & (x < east + reach_m) & (y > south - reach_m) & (y < north + reach_m)
        return np.asarray(beside & (np.abs(z - plane.at(self.points.position_m[:, :2])) < 2 * step_m))

    @cached_property
    def _row(self) -> Int[np.ndarray, " point"]:
        return rows_of(self.sightings.profiles.pulse, self.points.pulse)

    @cached_property
    def _samples(self) -> tuple[Float[np.ndarray, "sample 3"], Float[np.ndarray, " sample"]]:
        return lobe_samples(self.sightings.beam, SAMPLES)
