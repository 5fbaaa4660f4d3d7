"""The interface of terrains: ground surfaces, bare-ground heights and covers from any source.

Ground from a file has its georeference; any other has one if its scenario states its position. Everything is in the
local frame: metres, x east, y north, z up.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float
from scipy.ndimage import distance_transform_edt

from sionna_radar.foundation.raster import Georeference, Heights, Raster
from sionna_radar.scene.ground_cover import GroundCover, cover_ground
from sionna_radar.scene.model import Surface, mesh_of
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.surfaces.backscatter import Backscatter
from sionna_radar.surfaces.radar_material import Channel


@dataclass(frozen=True, kw_only=True)
class TerrainInputs:
    """Inputs of a terrain, besides its parameters.

    window_m: extent visible to the survey (west, south, east, north); ground beyond it is not needed.
    carrier_hz, channel: of the radar, for terrain with its own materials.
    """

    window_m: tuple[float, float, float, float]
    carrier_hz: float
    channel: Channel


@dataclass(frozen=True, kw_only=True)
class Landscape:
    """The ground of a survey.

    surfaces: its triangles.
    ground_m: height of the bare ground at horizontal positions, voids filled; NaN beyond the terrain.
    standing_m: height of the ground under objects: that of the triangles themselves.
    ground_material: the material of the ground where a single one is needed, as for a reference echo.
    georeference: None if the ground is not georeferenced.
    materials: those defined by the terrain.
    heights: the raster of the triangles, if any.
    may_overhang: whether there may be air under some of it.
    posting_m: posting of the source file or array, below which it has no detail; None without a source, or with
        synthetic detail.
    caster: rays against the surfaces, where their heights already need one.
    """

    surfaces: tuple[Surface, ...]
    ground_m: Heights
    standing_m: Heights
    ground_material: str = "ground"
    georeference: Georeference | None = None
    materials: dict[str, Backscatter] = field(default_factory=dict)
    heights: Raster | None = None
    may_overhang: bool = False
    posting_m: float | None = None
    caster: RayCaster | None = None


def covered_landscape(raster: Raster, cover: GroundCover, georeference: Georeference | None = None) -> Landscape:
    """Return ground of given heights, with its covers.

    Raises ScenarioError, InputFileError if a polygon covers no face; the raster of classes cannot be read or
        georeferenced.
    """
    surfaces = cover_ground(*mesh_of(raster), cover, georeference)
    if len(surfaces) == 1 and raster.filled.all():
        surfaces = (replace(surfaces[0], relief=raster),)
    ground_m = _bridged(raster).at

    def standing_m(place_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        # Between the posts of a coarse raster the bilinear ground is metres above or below the triangles.
        top_m = max(float(surface.bounds_m[1, 2]) for surface in surfaces) + 10.0
        mesh = RayCaster(surfaces).from_above(place_m, top_m)
        return np.where(np.isnan(mesh), ground_m(place_m), mesh)

    return Landscape(
        surfaces=surfaces,
        ground_m=ground_m,
        standing_m=standing_m,
        ground_material=cover.material,
        georeference=georeference,
        heights=raster,
    )


def _bridged(raster: Raster) -> Raster:
    """Return a raster with voids filled by the nearest height, so that a flight can be planned across a lake."""
    if raster.filled.all():
        return raster
    nearest = distance_transform_edt(~raster.filled, return_distances=False, return_indices=True)
    return Raster(grid=raster.grid, height_m=raster.height_m[tuple(nearest)])
