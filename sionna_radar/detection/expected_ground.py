"""Range gate of the expected ground for each pulse, from altitude or a rough DEM.

Echoes are searched in a range window only: from the beam's intersection with the expected ground raised by the
tolerance to that with the ground lowered by as much. Only the measured pose is used.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from sionna_radar.elevation.file_heights import MAX_HEIGHT_M, bilinear
from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.elevation.placed_raster import apply_affine, in_crs_of
from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.raster import Georeference, Grid
from sionna_radar.foundation.raster_band import band_values
from sionna_radar.radar.chirp import Chirp

KEY = "processing.expected_ground.path"
MAX_CELLS_READ = 100_000_000
# Minimum downward cosine of a beam that meets level ground.
MIN_DOWN = 0.01


@dataclass(frozen=True, kw_only=True, eq=False)
class ExpectedGround:
    """Prior knowledge of the ground.

    surface: rough heights; None for level ground `altitude_m` below the platform.
    tolerance_m: largest deviation of the true ground, up or down.
    half_beam_rad: angle from boresight to the beam's edge, in azimuth and elevation.
    """

    surface: Heightfield | None
    altitude_m: float
    tolerance_m: float
    half_beam_rad: tuple[float, float]

    def window_m(self, pulses: Pulses, chirp: Chirp) -> Float[np.ndarray, "pulse 2"]:
        """Return the nearest and farthest possible range of ground in each pulse, as measured by the sweep.

        A pulse whose beam meets no expected ground keeps all ranges.
        """
        pose, (azimuth, elevation) = pulses.measured, self.half_beam_rad
        turns = Rotation.from_euler("zy", [[0, 0], [azimuth, 0], [-azimuth, 0], [0, elevation], [0, -elevation]])
        nearest, farthest = np.full(len(pulses), np.inf), np.zeros(len(pulses))
        for axis in turns.as_matrix()[:, :, 0]:
            direction = pose.R_world_antenna @ axis
            nearest = np.fmin(nearest, self._meets(pose, direction, self.tolerance_m, chirp.max_range_m))
            lowest = self._meets(pose, direction, -self.tolerance_m, chirp.max_range_m)
            farthest = np.maximum(farthest, np.nan_to_num(lowest, nan=np.inf))
        met = np.isfinite(nearest)
        shift_m = chirp.doppler_range_m(pose.boresight_range_rate_mps)
        window = np.column_stack([nearest + shift_m, farthest + shift_m])
        return np.where(met[:, None], window, [-np.inf, np.inf])

    def holds(
        self, place_m: Float[np.ndarray, "point 3"], platform_m: Float[np.ndarray, "3"]
    ) -> Bool[np.ndarray, " point"]:
        """Return True where points seen from a platform lie within the tolerance of the expected ground."""
        return np.abs(self.above_m(place_m, platform_m)) <= self.tolerance_m

    def above_m(
        self, place_m: Float[np.ndarray, "point 3"], platform_m: Float[np.ndarray, "*points 3"]
    ) -> Float[np.ndarray, " point"]:
        """Return the heights of points over the expected ground, m; NaN beyond a rough DEM.

        platform_m: where they are seen from: one place for all, or one for each.
        """
        if self.surface is None:
            return place_m[:, 2] - (platform_m[..., 2] - self.altitude_m)
        above_m: Float[np.ndarray, " point"] = place_m[:, 2] - self.surface.at(*place_m[:, :2].T)
        return above_m

    def _meets(
        self, pose: Pose, direction: Float[np.ndarray, "pulse 3"], raised_m: float, reach_m: float
    ) -> Float[np.ndarray, " pulse"]:
        """Return the range at which each ray meets the expected ground raised by `raised_m`, m; NaN without a hit."""
        if self.surface is None:
            down = np.where(direction[:, 2] < -MIN_DOWN, -direction[:, 2], np.nan)
            return max(self.altitude_m - raised_m, 0.0) / down
        raised = Heightfield(grid=self.surface.grid, height_m=self.surface.height_m + raised_m)
        return raised.first_hit(pose.position_m, direction, reach_m)


def rough_surface(path: Path, grid: Grid, place: Georeference | None) -> Heightfield:
    """Return the heights of a rough DEM in the cells of a map; raises as `build_expected_ground` does."""
    # rasterio, which nothing but a file needs, takes long to import.
    from sionna_radar.foundation.raster_file import open_raster, require_cells

    with open_raster(path, KEY) as source:
        require_cells(source, f"{KEY} = {path}", "heights; give an elevation raster in metres")
        x, y = in_crs_of(source, grid.centres_m, place, KEY)
        column, row = (c - 0.5 for c in apply_affine(~source.transform, x, y))
        # Between the outermost cell centres and the raster's edge use the heights of those cells.
        covered = (np.abs(column - (source.width - 1) / 2) <= source.width / 2) & (
            np.abs(row - (source.height - 1) / 2) <= source.height / 2
        )
        if not covered.any():
            raise InputFileError(f"{KEY} = {path}: does not overlap the survey; check its position and CRS")
        column, row = np.clip(column, 0, source.width - 1), np.clip(row, 0, source.height - 1)
        left, top = int(column[covered].min()), int(row[covered].min())
        width, height = (
            min(int(np.ceil(c[covered].max())) - start + 2, size - start)
            for c, start, size in ((column, left, source.width), (row, top, source.height))
        )
        if width * height > MAX_CELLS_READ:
            raise InputFileError(f"{KEY} = {path}: has more than {MAX_CELLS_READ:,} cells under the survey; coarsen it")
        window = (top, top + height), (left, left + width)
        cells = band_values(source, source.read(1, window=window, masked=True))
    height_m = np.full(len(x), np.nan)
    cells[np.abs(cells) > MAX_HEIGHT_M] = np.nan
    height_m[covered] = bilinear(cells, row[covered] - top, column[covered] - left)
    valid = np.isfinite(height_m)
    if not valid.any():
        raise InputFileError(f"{KEY} = {path}: has no heights under the survey; fill its voids, or give another raster")
    # In voids the ground is expected at the mean height: a rough height is enough.
    height_m = np.where(valid, height_m, float(height_m[valid].mean())) - (place.origin_m[2] if place else 0.0)
    return Heightfield(grid=grid, height_m=height_m.reshape(grid.shape))
