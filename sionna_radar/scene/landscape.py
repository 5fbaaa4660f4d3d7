"""The ground of a survey from any source, and the registry of sources.

Ground from a file has its georeference; any other has one if its scenario states its position. Everything is in the
local frame: metres, x east, y north, z up.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Float
from scipy.ndimage import distance_transform_edt

from sionna_radar.elevation.local_frame import MapFrame, frame_at
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.raster import Georeference, Raster
from sionna_radar.scenario.bases import CoveredTerrain, TerrainParameters
from sionna_radar.scenario.parts import TERRAINS
from sionna_radar.scenario.registry import Facts, require
from sionna_radar.scene.ground_cover import cover_ground
from sionna_radar.scene.model import Surface, mesh_of
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.surfaces.backscatter import Backscatter
from sionna_radar.surfaces.radar_material import Channel

Heights = Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]]
Builder = TypeVar("Builder", bound=Callable[..., "Landscape"])


@dataclass(frozen=True, kw_only=True)
class TerrainInputs:
    """Inputs of a terrain, besides its parameters.

    window_m: extent visible to the survey (west, south, east, north); ground beyond it is not needed.
    carrier_hz, channel: of the radar, for terrain with its own materials.
    """

    window_m: tuple[float, float, float, float]
    carrier_hz: float
    channel: Channel


INPUTS = tuple(field.name for field in fields(TerrainInputs))


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


def landscape_of_heights(
    raster: Raster, terrain: CoveredTerrain, georeference: Georeference | None = None
) -> Landscape:
    """Return ground of given heights, with the covers of its table.

    Raises
    ------
    ScenarioError, InputFileError
        A polygon covers no face; the raster of classes cannot be read or georeferenced.

    """
    georeference = georeference or _stated_place(terrain)
    surfaces = cover_ground(*mesh_of(raster), terrain, georeference)
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
        ground_material=terrain.material,
        georeference=georeference,
        heights=raster,
    )


def landscape_of_raster(raster: Raster, terrain: TerrainParameters, given: TerrainInputs) -> Landscape:
    """Return ground from a raster in local metres, with the material and the covers of a table.

    Raises ScenarioError if it lies outside the survey's window.
    """
    (west, east, south, north), window_m = raster.grid.extent_m, given.window_m
    if west > window_m[2] or east < window_m[0] or south > window_m[3] or north < window_m[1]:
        message = (
            f"it spans {west:.0f} to {east:.0f} m east and {south:.0f} to {north:.0f} m north, of which the survey "
            "sees nothing; give the path of its file, or Raster.from_array(raster.height_m, spacing_m)"
        )
        raise ScenarioError([Problem("terrain", message)])
    if not isinstance(terrain, CoveredTerrain):
        terrain = CoveredTerrain(kind="raster", centre_lonlat_deg=terrain.centre_lonlat_deg)
    return replace(landscape_of_heights(raster, terrain), posting_m=raster.grid.spacing_m)


def _bridged(raster: Raster) -> Raster:
    """Return a raster with voids filled by the nearest height, so that a flight can be planned across a lake."""
    if raster.filled.all():
        return raster
    nearest = distance_transform_edt(~raster.filled, return_distances=False, return_indices=True)
    return Raster(grid=raster.grid, height_m=raster.height_m[tuple(nearest)])


def register_terrain(
    name: str,
    parameters: type[TerrainParameters],
    *,
    frame: Callable[..., MapFrame | None] | None = None,
    uses: Sequence[str] = INPUTS,
) -> Callable[[Builder], Builder]:
    """Register a terrain, for `terrain.kind` in a scenario.

    Parameters
    ----------
    name:
        Its name in scenarios.
    parameters:
        Its table of parameters, `[terrain]`; one derived from `CoveredTerrain` also has the keys of land cover.
    frame:
        Returns, from the parameters, the local frame of a terrain with a map position of its own, or None.
    uses:
        The `TerrainInputs` on which the landscape depends; surveys that differ in others share it.

    Returns
    -------
    A decorator for a function that builds a `Landscape`; it is called with the parameters and `TerrainInputs`.

    Raises
    ------
    PluginError
        The name is taken, or the parameters are not `TerrainParameters`.

    Examples
    --------
    >>> import numpy as np
    >>> from sionna_radar.foundation import Grid
    >>> from sionna_radar.scenario import CoveredTerrain
    >>> from sionna_radar.scene import landscape_of_heights
    >>> class Dunes(CoveredTerrain):
    ...     height_m: float = 3.0
    >>> @register_terrain("dunes", Dunes)
    ... def dunes(parameters, given):
    ...     grid = Grid(west_m=-200.0, south_m=-200.0, spacing_m=2.0, columns=201, rows=201)
    ...     height_m = parameters.height_m * np.cos(grid.centres_m[:, 0] / 10).reshape(grid.shape)
    ...     return landscape_of_heights(Raster(grid=grid, height_m=height_m), parameters)
    >>> prepared = prepare(load_scenario("hills", {"terrain": {"kind": "dunes"}, "platform.length_m": 10.0}))
    >>> float(prepared.scene.scene.bounds_m[1, 2])
    3.0

    """
    return TERRAINS.register(name, parameters, Facts(uses=tuple(uses), frame=frame))


def map_frame(table: TerrainParameters) -> MapFrame | None:
    """Return the local frame of a scenario's terrain on the map; None without a map position.

    Raises ScenarioError or InputFileError if its file cannot be read or georeferenced.
    """
    frame = TERRAINS.entry(table.kind).facts.frame
    if frame is not None:
        own: MapFrame | None = frame(table)
        return own
    return frame_at(*table.centre_lonlat_deg) if table.centre_lonlat_deg else None


def build_landscape(table: TerrainParameters, given: TerrainInputs) -> Landscape:
    """Return the ground of a scenario."""
    landscape: Landscape = TERRAINS.entry(table.kind)(table, given)
    require(landscape, Landscape, str(TERRAINS.entry(table.kind)))
    if landscape.georeference is None:
        return replace(landscape, georeference=_stated_place(table))
    return landscape


def _stated_place(table: TerrainParameters) -> Georeference | None:
    return frame_at(*table.centre_lonlat_deg).georeference() if table.centre_lonlat_deg else None
