"""What the ground is: `[terrain]`, selected by `kind`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from sionna_radar.scenario.bases import CoveredTerrain, TerrainParameters
from sionna_radar.scenario.choice import ChosenBy
from sionna_radar.scenario.cover import MaterialField
from sionna_radar.scenario.mesh_file import MeshFile
from sionna_radar.scenario.parts import TERRAINS
from sionna_radar.scenario.table import InputPath, InputSource, Point3, Positive, Real, Seed, Table, refuse

KEEP_SIONNA = "sionna"


class FlatTerrain(CoveredTerrain):
    """A horizontal plane.

    size_m: along east and north.
    spacing_m: of the posts.
    fields: rectangles of other materials.
    """

    kind: Literal["flat"] = "flat"
    size_m: tuple[Positive, Positive] = (300.0, 300.0)
    spacing_m: Positive = 5.0
    fields: tuple[MaterialField, ...] = ()


class HillsTerrain(CoveredTerrain):
    """A seeded Gaussian random surface: white noise, Gaussian filter, scaled to a largest height.

    size_m: along east and north.
    spacing_m: of the posts.
    filter_sigma_m: standard deviation of the Gaussian filter, over which heights are alike.
    height_m: of the highest point over the lowest.
    seed: of the surface.
    fields: rectangles of other materials.
    """

    kind: Literal["hills"] = "hills"
    size_m: tuple[Positive, Positive] = (320.0, 320.0)
    spacing_m: Positive = 0.5
    filter_sigma_m: Positive = 25.0
    height_m: Positive = 8.0
    seed: Seed = 1
    fields: tuple[MaterialField, ...] = ()


class FractalTerrain(CoveredTerrain):
    """A seeded self-affine Gaussian random surface: height differences over d spread like d to the Hurst exponent.

    size_m: along east and north.
    spacing_m: of the posts.
    hurst: exponent: near 1 smooth, near 0 rough.
    height_m: of the highest point over the lowest.
    seed: of the surface.
    fields: rectangles of other materials.
    """

    kind: Literal["fractal"] = "fractal"
    size_m: tuple[Positive, Positive] = (320.0, 320.0)
    spacing_m: Positive = 0.5
    hurst: Annotated[Real, Field(gt=0, lt=1)] = 0.8
    height_m: Positive = 10.0
    seed: Seed = 1
    fields: tuple[MaterialField, ...] = ()


class SampleTerrain(CoveredTerrain):
    """The SRTM tile of Jacksboro, Tennessee, from matplotlib's sample data.

    spacing_m: of the posts; without it the tile's.
    """

    kind: Literal["jacksboro"] = "jacksboro"
    spacing_m: Positive | None = None


class Roughness(Table):
    """Seeded detail that a file's spacing leaves out: self-affine, of a Hurst exponent and a root mean square.

    hurst: exponent: near 1 smooth, near 0 rough.
    rms_m: root mean square of the detail.
    seed: of the detail.
    """

    hurst: Annotated[Real, Field(gt=0, lt=1)] = 0.7
    rms_m: Annotated[Positive, Field(le=100)]
    seed: Seed = 1


class RasterTerrain(CoveredTerrain):
    """The user's own elevation raster: GeoTIFF, Esri ASCII grid, SRTM .hgt, DTED or another plain grid.

    path: a file; or the address of a cloud-optimised GeoTIFF (https://, s3://, ...), read only with --allow-network.
    holes: cells without data are kept as holes, filled from around them, or refused.
    roughen: adds detail below the file's spacing; the mesh is then as fine as spacing_m, or a tenth of the file's.
    crs, vertical_crs, height_unit: what the file's coordinates and heights are, such as "EPSG:2154", "EPSG:5703" and
    "ft" or "ftUS"; without them what the file says, and metres where it says nothing of its heights.
    spacing_m: of the posts; without it the file's.
    """

    kind: Literal["raster"] = "raster"
    path: InputSource
    crs: str | None = None
    vertical_crs: str | None = None
    height_unit: Literal["m", "ft", "ftUS"] | None = None
    spacing_m: Positive | None = None
    holes: Literal["keep", "fill", "refuse"] = "keep"
    roughen: Roughness | None = None


class PointsTerrain(CoveredTerrain):
    """A point cloud, LAS or LAZ, gridded.

    points: the first return of each pulse, those classified as ground, or all; never noise or withheld ones.
    statistic: height of a cell: the mean of its points, the highest, or a percentile of them.
    spacing_m: of the cells; without it, four points fall into one on average.
    crs, vertical_crs, height_unit, holes: see `RasterTerrain`. A file without a CRS is in local metres, about its
        middle, unless crs says more.
    path: the point cloud.
    percentile: of the heights in a cell, where that is the statistic.
    """

    kind: Literal["points"] = "points"
    path: InputPath
    points: Literal["first", "ground", "all"] = "first"
    statistic: Literal["mean", "max", "percentile"] = "mean"
    percentile: Annotated[Real, Field(ge=0, le=100)] = 50.0
    spacing_m: Positive | None = None
    crs: str | None = None
    vertical_crs: str | None = None
    height_unit: Literal["m", "ft", "ftUS"] | None = None
    holes: Literal["keep", "fill", "refuse"] = "fill"

    @model_validator(mode="after")
    def _percentile_is_used(self) -> PointsTerrain:
        usual = type(self).model_fields["percentile"].default
        if self.statistic != "percentile" and self.percentile != usual:
            raise refuse("percentile", f"{self.percentile:g} has no effect; set statistic = 'percentile', or remove it")
        return self


class MeshTerrain(CoveredTerrain, MeshFile):
    """A mesh as the ground, with what stands on it: a site model, a photogrammetric mesh, a scene of Sionna.

    position_m: local place and height of the file's origin, or of the middle of its box at its lowest point.
    crs: that of the file's coordinates, such as "EPSG:32632", easting first; it is then its own place on the map.
    Land cover lies on the faces of `material`, not on those that `materials` names.

    The bare ground, that a flight's height counts from and objects stand on, is the lowest surface that faces up:
    ground under a bridge, and not a bottom plate.
    """

    kind: Literal["mesh"] = "mesh"
    material: str = "ground"
    position_m: Point3 = (0.0, 0.0, 0.0)
    crs: str | None = None

    @model_validator(mode="after")
    def _placed_once(self) -> MeshTerrain:
        for key in ("position_m", "heading_deg", "scale", "centre"):
            if self.crs is not None and getattr(self, key) != type(self).model_fields[key].default:
                raise refuse(key, "a mesh with a CRS has its place in its coordinates; remove it, or terrain.crs")
        return self


class CityTerrain(TerrainParameters):
    """A whole scene that Sionna ships; its materials are mapped to 77 GHz ones by name.

    A material mapped to "sionna" stays Sionna's own, where that is defined at the carrier and scatters.

    materials: materials of the scenario, by the names of Sionna's.
    """

    kind: Literal["sionna:san_francisco", "sionna:munich", "sionna:florence", "sionna:etoile"]
    materials: dict[str, str] = {}

    @property
    def city(self) -> str:
        """Name of the Sionna scene."""
        return self.kind.removeprefix("sionna:")


Terrain = Annotated[TerrainParameters, ChosenBy("kind", TERRAINS)]
