"""Table `[terrain]`, one for each kind of ground, and the keys of mesh files.

`[terrain]` of kind "mesh" and `[[objects]]` share the keys of a mesh file: axes, size and materials.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from sionna_radar.scenario.bases import CoveredTerrain, TerrainParameters
from sionna_radar.scenario.choice import ChosenBy
from sionna_radar.scenario.cover import MaterialField
from sionna_radar.scenario.parts import TERRAINS
from sionna_radar.scenario.table import Conflicts, InputPath, InputSource, Point3, Positive, Real, Seed, Table

Unit = Literal["m", "cm", "mm", "km", "in", "ft", "ftUS", "yd"]
METRES = {
    "m": 1.0,
    "cm": 0.01,
    "mm": 0.001,
    "km": 1000.0,
    "in": 0.0254,
    "ft": 0.3048,
    "ftUS": 1200 / 3937,
    "yd": 0.9144,
}


class MeshShape(Table):
    """A file of triangles: PLY, OBJ, STL, GLB, glTF, or an XML scene of Mitsuba or Sionna."""

    path: InputPath
    """Mesh file."""
    units: Unit = "m"
    """Unit of the file's coordinates."""
    up: Literal["y", "z"] | None = None
    """Axis of the file that points up. Default: y for GLB and glTF, whose standard says so, and z for all others."""
    scale: Positive = 1.0
    """Extra scale factor, in addition to `units`."""
    heading_deg: Real = 0.0
    """Clockwise turn of the mesh's y axis (of -z where y is up) from north; on a target, from the target's front."""

    @property
    def metres_per_unit(self) -> float:
        """Metres of one unit of the file's coordinates, the scale included."""
        return METRES[self.units] * self.scale


class MeshFile(MeshShape):
    """A file of triangles, with its materials."""

    material: str = "building"
    """Material of all parts that `materials` does not name; a table is taken for `materials`."""
    materials: dict[str, str] = {}
    """Materials of the scenario by the mesh's own material names (without Sionna's "mat-"), or by the names of its
    objects where these have no material."""
    centre: Literal["origin", "box"] = "origin"
    """Point of the mesh that stands at `position_m`: the file's origin, or the middle of its bounding box in plan at
    its lowest point, for files whose coordinates are far from their origin."""

    @model_validator(mode="before")
    @classmethod
    def _table_of_materials(cls, values: Any) -> Any:
        if isinstance(values, Mapping) and isinstance(values.get("material"), Mapping) and "materials" not in values:
            return {
                **{key: value for key, value in values.items() if key != "material"},
                "materials": values["material"],
            }
        return values


KEEP_SIONNA = "sionna"


class FlatTerrain(CoveredTerrain):
    """A horizontal plane."""

    kind: Literal["flat"] = "flat"
    size_m: tuple[Positive, Positive] = (300.0, 300.0)
    """Size along east and north."""
    spacing_m: Positive = 5.0
    """Spacing of the posts."""
    fields: tuple[MaterialField, ...] = ()
    """Rectangles of other materials."""


class HillsTerrain(CoveredTerrain):
    """A seeded Gaussian random surface: white noise, Gaussian filter, scaled to a largest height."""

    kind: Literal["hills"] = "hills"
    size_m: tuple[Positive, Positive] = (320.0, 320.0)
    """Size along east and north."""
    spacing_m: Positive = 0.5
    """Spacing of the posts."""
    filter_sigma_m: Positive = 25.0
    """Standard deviation of the Gaussian filter; it sets the correlation length of the heights."""
    height_m: Positive = 8.0
    """Height of the highest point above the lowest."""
    seed: Seed = 1
    """Seed of the surface."""
    fields: tuple[MaterialField, ...] = ()
    """Rectangles of other materials."""


class FractalTerrain(CoveredTerrain):
    """A seeded self-affine Gaussian random surface: height differences over d spread like d to the Hurst exponent."""

    kind: Literal["fractal"] = "fractal"
    size_m: tuple[Positive, Positive] = (320.0, 320.0)
    """Size along east and north."""
    spacing_m: Positive = 0.5
    """Spacing of the posts."""
    hurst: Annotated[Real, Field(gt=0, lt=1)] = 0.8
    """Hurst exponent: near 1 smooth, near 0 rough."""
    height_m: Positive = 10.0
    """Height of the highest point above the lowest."""
    seed: Seed = 1
    """Seed of the surface."""
    fields: tuple[MaterialField, ...] = ()
    """Rectangles of other materials."""


class SampleTerrain(CoveredTerrain):
    """The SRTM tile of Jacksboro, Tennessee, from matplotlib's sample data."""

    kind: Literal["jacksboro"] = "jacksboro"
    spacing_m: Positive | None = None
    """Spacing of the posts. Default: that of the tile."""


class Roughness(Table):
    """Seeded fractal detail below a file's spacing, by Hurst exponent and root mean square height."""

    hurst: Annotated[Real, Field(gt=0, lt=1)] = 0.7
    """Hurst exponent: near 1 smooth, near 0 rough."""
    rms_m: Annotated[Positive, Field(le=100)]
    """Root mean square height of the detail."""
    seed: Seed = 1
    """Seed of the detail."""


class RasterTerrain(CoveredTerrain):
    """The user's own elevation raster: GeoTIFF, Esri ASCII grid, SRTM .hgt, DTED or another plain grid."""

    kind: Literal["raster"] = "raster"
    path: InputSource
    """Elevation file; or the address of a cloud-optimised GeoTIFF (https://, s3://, ...), read only with
    --allow-network."""
    crs: str | None = None
    """Horizontal CRS of the file, such as "EPSG:2154". Default: as the file states."""
    vertical_crs: str | None = None
    """Vertical CRS of the file's heights, such as "EPSG:5703". Default: as the file states."""
    height_unit: Literal["m", "ft", "ftUS"] | None = None
    """Unit of the file's heights. Default: as the file states, or metres if it does not."""
    band: Annotated[int, Field(strict=True, ge=1, le=65535)] | None = None
    """Number of the file's band with the heights, counted from 1. Default: the first, with a warning where there are
    more."""
    spacing_m: Positive | None = None
    """Spacing of the posts. Default: that of the file."""
    holes: Literal["keep", "fill", "refuse"] = "keep"
    """Treatment of cells without data: kept as holes, filled from around them, or refused."""
    roughen: Roughness | None = None
    """Detail below the file's spacing that is added; the mesh is then as fine as spacing_m, or a tenth of the file's
    spacing."""


class PointsTerrain(CoveredTerrain):
    """A point cloud, LAS or LAZ, gridded."""

    kind: Literal["points"] = "points"
    path: InputPath
    """Point-cloud file."""
    points: Literal["first", "ground", "all"] = "first"
    """Points that are used: the first return of each pulse, those classified as ground, or all; never noise or withheld
    ones."""
    statistic: Literal["mean", "max", "percentile"] = "mean"
    """Height of a cell: the mean of its points, the highest, or a percentile of them."""
    percentile: Annotated[Real, Field(ge=0, le=100)] = 50.0
    """Percentile of the heights in a cell, if `statistic` is "percentile"."""
    spacing_m: Positive | None = None
    """Spacing of the cells. Default: four points fall into one on average."""
    crs: str | None = None
    """Horizontal CRS of the file, such as "EPSG:2154". Default: as the file states; a file without one is in local
    metres, about its middle."""
    vertical_crs: str | None = None
    """Vertical CRS of the file's heights, such as "EPSG:5703". Default: as the file states."""
    height_unit: Literal["m", "ft", "ftUS"] | None = None
    """Unit of the file's heights. Default: as the file states, or metres if it does not."""
    holes: Literal["keep", "fill", "refuse"] = "fill"
    """Treatment of cells without points: kept as holes, filled from around them, or refused."""

    def _conflicts(self) -> Conflicts:
        if self.statistic != "percentile" and self.changed("percentile"):
            yield "percentile", f"{self.percentile:g} has no effect; set statistic = 'percentile', or remove it"


class MeshTerrain(CoveredTerrain, MeshFile):
    """A mesh as the ground, with the objects on it: a site model, a photogrammetric mesh, a scene of Sionna.

    The bare ground, from which heights of flight count and on which objects stand, is the lowest surface that faces up:
    ground under a bridge, and not a bottom plate.
    """

    kind: Literal["mesh"] = "mesh"
    material: str = "ground"
    """Material of the ground; a name of the scenario's materials."""
    position_m: Point3 = (0.0, 0.0, 0.0)
    """Local position and height of the file's origin, or of the middle of its bounding box at its lowest point."""
    crs: str | None = None
    """CRS of the file's coordinates, such as "EPSG:32632", easting first; they are then its place on the map. Land
    cover lies on the faces of `material`, not on those that `materials` names."""

    def _conflicts(self) -> Conflicts:
        placed = self.changed("position_m", "heading_deg", "scale", "centre")
        if self.crs is not None and placed:
            yield (
                placed[0],
                "has no effect on a mesh with a CRS, whose coordinates are its position; remove it, or terrain.crs",
            )


class CityTerrain(TerrainParameters):
    """A whole scene that Sionna ships; its materials are mapped to 77 GHz ones by name.

    A material mapped to "sionna" stays Sionna's own, where that is defined at the carrier and scatters.
    """

    kind: Literal["sionna:san_francisco", "sionna:munich", "sionna:florence", "sionna:etoile"]
    materials: dict[str, str] = {}
    """Materials of the scenario by the names of Sionna's."""

    @property
    def city(self) -> str:
        """Name of the Sionna scene."""
        return self.kind.removeprefix("sionna:")


Terrain = Annotated[TerrainParameters, ChosenBy("kind", TERRAINS)]
