"""Builder and registry of terrains: the ground of a scenario from `[terrain]`."""

from collections.abc import Callable, Sequence
from dataclasses import fields, replace

import numpy as np
from jaxtyping import Bool, Int

from sionna_radar.elevation.local_frame import MapFrame, StatedFrame, frame_at
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.raster import Georeference, Grid, Raster
from sionna_radar.scenario.bases import CoveredTerrain, TerrainParameters
from sionna_radar.scenario.cover import MaterialField
from sionna_radar.scenario.parts import TERRAINS
from sionna_radar.scenario.registry import Builder, Facts
from sionna_radar.scenario.terrain import (
    KEEP_SIONNA,
    CityTerrain,
    FlatTerrain,
    FractalTerrain,
    HillsTerrain,
    MeshShape,
    MeshTerrain,
    PointsTerrain,
    RasterTerrain,
    SampleTerrain,
)
from sionna_radar.scene.ground_cover import (
    ClassPolygons,
    ClassRaster,
    GroundCover,
    MaterialPolygon,
    MaterialRectangle,
    materials_at,
)
from sionna_radar.scene.landscape import Landscape, TerrainInputs, covered_landscape
from sionna_radar.scene.objects import MeshSource
from sionna_radar.scene.terrains import synthetic
from sionna_radar.scene.terrains.city import city_landscape
from sionna_radar.scene.terrains.elevation import (
    SAMPLE_CRS,
    SAMPLE_VERTICAL_CRS,
    CloudSource,
    ElevationSource,
    Roughness,
    elevation,
    points,
)
from sionna_radar.scene.terrains.elevation import cloud_frame as points_frame
from sionna_radar.scene.terrains.elevation import file_frame as elevation_frame
from sionna_radar.scene.terrains.mesh import MeshGround, mesh
from sionna_radar.scene.terrains.mesh import mesh_frame as ground_mesh_frame


def cover_of(terrain: CoveredTerrain) -> GroundCover:
    """Return the material of a terrain and its covers."""
    raster, vector = terrain.cover_raster, terrain.cover_vector
    fields: tuple[MaterialField, ...] = getattr(terrain, "fields", ())
    return GroundCover(
        material=terrain.material,
        raster=None if raster is None else ClassRaster(path=raster.path, materials=raster.material_of_class),
        vector=None if vector is None else vector.to(ClassPolygons, materials=vector.classes),
        fields=tuple(rectangle.to(MaterialRectangle) for rectangle in fields),
        polygons=tuple(MaterialPolygon(corners_m=p.polygon_m, material=p.material) for p in terrain.cover),
    )


def covers_on(terrain: TerrainParameters, grid: Grid) -> dict[str, Bool[np.ndarray, "row column"]]:
    """Return the cells of each material of a terrain's covers, without objects on it; empty where nothing covers it.

    Raises ScenarioError, InputFileError as `landscape_of_heights`, and where one of terrain and grid has no map.
    """
    names, number = cover_numbers(terrain, grid)
    name = np.array(names)[number]
    return {str(cover): name == cover for cover in (np.unique(name) if names else ())}


def cover_numbers(terrain: TerrainParameters, grid: Grid) -> tuple[list[str], Int[np.ndarray, "row column"]]:
    """Return the materials of a terrain's covers, and the number of the one in each cell; else as `covers_on`."""
    if not isinstance(terrain, CoveredTerrain) or (cover := cover_of(terrain)).bare:
        return [], np.empty((0, 0), dtype=np.int64)
    frame, place = map_frame(terrain), grid.georeference
    if (frame is None) != (place is None):
        message = "the covers and the DEM are in different coordinates; give a DEM of this scenario"
        raise ScenarioError.of("terrain", message)
    point_m = grid.centres_m
    if frame is not None and place is not None:
        point_m = point_m + place.origin_m[:2] - frame.origin_m
    names, owner = materials_at(cover, point_m, None if frame is None else frame.georeference())
    return names, owner.reshape(grid.shape)


def landscape_of_heights(
    raster: Raster, terrain: CoveredTerrain, georeference: Georeference | None = None
) -> Landscape:
    """Return ground of given heights, with the covers of its table.

    Parameters
    ----------
    raster:
        Heights in local metres.
    terrain:
        Table with the material and the covers of the ground.
    georeference:
        Position of the local frame on the map; None if unknown.

    Returns
    -------
    The ground with its surfaces, bare heights and covers.

    Raises
    ------
    ScenarioError, InputFileError
        A polygon covers no face; the raster of classes cannot be read or georeferenced.
    """
    return covered_landscape(raster, cover_of(terrain), georeference or _stated_place(terrain))


def flat(terrain: FlatTerrain, _: TerrainInputs) -> Landscape:
    """Return level ground at height zero."""
    return landscape_of_heights(synthetic.flat(terrain.size_m, terrain.spacing_m), terrain)


def hills(terrain: HillsTerrain, _: TerrainInputs) -> Landscape:
    """Return a seeded Gaussian random surface."""
    heights = synthetic.hills(terrain.size_m, terrain.spacing_m, terrain.filter_sigma_m, terrain.height_m, terrain.seed)
    return landscape_of_heights(heights, terrain)


def fractal(terrain: FractalTerrain, _: TerrainInputs) -> Landscape:
    """Return a seeded self-affine random surface."""
    heights = synthetic.fractal(terrain.size_m, terrain.spacing_m, terrain.hurst, terrain.height_m, terrain.seed)
    return landscape_of_heights(heights, terrain)


def sample_or_raster(terrain: SampleTerrain | RasterTerrain, inputs: TerrainInputs) -> Landscape:
    """Return the ground of an elevation raster, read only within the survey's window."""
    return elevation(_elevation_source(terrain), cover_of(terrain), inputs.window_m)


def raster_frame(terrain: SampleTerrain | RasterTerrain) -> MapFrame:
    """Return the local frame of an elevation raster; see `terrains.elevation.file_frame`."""
    return elevation_frame(_elevation_source(terrain))


def _elevation_source(terrain: SampleTerrain | RasterTerrain) -> ElevationSource:
    if isinstance(terrain, SampleTerrain):
        stated = terrain.to(StatedFrame, crs=SAMPLE_CRS, vertical_crs=SAMPLE_VERTICAL_CRS)
        return ElevationSource(path=None, stated=stated, spacing_m=terrain.spacing_m)
    rough = None if terrain.roughen is None else terrain.roughen.to(Roughness)
    return terrain.to(ElevationSource, stated=terrain.to(StatedFrame), roughness=rough)


def cloud(terrain: PointsTerrain, inputs: TerrainInputs) -> Landscape:
    """Return the ground of a point cloud, gridded within the survey's window."""
    return points(_cloud_source(terrain), cover_of(terrain), inputs.window_m)


def cloud_frame(terrain: PointsTerrain) -> MapFrame | None:
    """Return the local frame of a cloud on the map; None for one without a CRS."""
    return points_frame(_cloud_source(terrain))


def _cloud_source(terrain: PointsTerrain) -> CloudSource:
    return terrain.to(CloudSource, stated=terrain.to(StatedFrame))


def mesh_source(table: MeshShape) -> MeshSource:
    """Return a file of triangles with its axes, size and materials."""
    return table.to(MeshSource, heading_rad=float(np.deg2rad(table.heading_deg)))


def mesh_ground(terrain: MeshTerrain, _: TerrainInputs) -> Landscape:
    """Return the ground of a mesh file, with the objects in it."""
    return mesh(_mesh_ground(terrain), cover_of(terrain))


def mesh_frame(terrain: MeshTerrain) -> MapFrame | None:
    """Return the local frame of a mesh on the map; None for one without a place on it."""
    return ground_mesh_frame(_mesh_ground(terrain))


def _mesh_ground(terrain: MeshTerrain) -> MeshGround:
    return terrain.to(MeshGround, source=mesh_source(terrain))


def city(terrain: CityTerrain, inputs: TerrainInputs) -> Landscape:
    """Return one of Sionna's cities."""
    chosen = {name: None if material == KEEP_SIONNA else material for name, material in terrain.materials.items()}
    return city_landscape(terrain.city, chosen, inputs.carrier_hz, inputs.channel)


INPUTS = tuple(field.name for field in fields(TerrainInputs))


def landscape_of_raster(raster: Raster, terrain: TerrainParameters, inputs: TerrainInputs) -> Landscape:
    """Return ground from a raster in local metres, with the material and the covers of a table.

    Raises ScenarioError if it lies outside the survey's window.
    """
    (west, east, south, north), window_m = raster.grid.extent_m, inputs.window_m
    if west > window_m[2] or east < window_m[0] or south > window_m[3] or north < window_m[1]:
        message = (
            f"it spans {west:.0f} to {east:.0f} m east and {south:.0f} to {north:.0f} m north, of which the survey "
            "sees nothing; give the path of its file, or Raster.from_array(raster.height_m, spacing_m)"
        )
        raise ScenarioError.of("terrain", message)
    if not isinstance(terrain, CoveredTerrain):
        terrain = CoveredTerrain(kind="raster", centre_lonlat_deg=terrain.centre_lonlat_deg)
    return replace(landscape_of_heights(raster, terrain), posting_m=raster.grid.spacing_m)


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
    ... def dunes(parameters, inputs):
    ...     grid = Grid(west_m=-200.0, south_m=-200.0, spacing_m=2.0, columns=201, rows=201)
    ...     height_m = parameters.height_m * np.cos(grid.centres_m[:, 0] / 10).reshape(grid.shape)
    ...     return landscape_of_heights(Raster(grid=grid, height_m=height_m), parameters)
    >>> prepared = prepare(load_scenario("hills", {"terrain": {"kind": "dunes"}, "platform.length_m": 10.0}))
    >>> float(prepared.world.scene.bounds_m[1, 2])
    3.0
    """
    return TERRAINS.register(name, parameters, Facts(uses=tuple(uses), frame=frame))


def map_frame(table: TerrainParameters) -> MapFrame | None:
    """Return the local frame of a scenario's terrain on the map; None without a map position.

    Raises ScenarioError or InputFileError if its file cannot be read or georeferenced.
    """
    frame = TERRAINS.entry(table.kind).facts.frame
    if frame is not None:
        return frame(table)
    return frame_at(*table.centre_lonlat_deg) if table.centre_lonlat_deg else None


def build_landscape(table: TerrainParameters, inputs: TerrainInputs) -> Landscape:
    """Return the ground of a scenario.

    Parameters
    ----------
    table:
        Table `[terrain]`.
    inputs:
        Window of the survey, carrier, materials and further inputs.

    Returns
    -------
    The ground with its surfaces, bare heights and covers.

    Raises
    ------
    ScenarioError, InputFileError
        The terrain cannot be built from its table or its files.
    """
    landscape: Landscape = TERRAINS.build(table.kind, Landscape, table, inputs)
    if landscape.georeference is None:
        return replace(landscape, georeference=_stated_place(table))
    return landscape


def _stated_place(table: TerrainParameters) -> Georeference | None:
    return frame_at(*table.centre_lonlat_deg).georeference() if table.centre_lonlat_deg else None
