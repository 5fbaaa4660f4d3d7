"""What the ground is: `[terrain]`, selected by `kind`."""

from __future__ import annotations

from typing import Annotated, Any, Literal, get_args

from pydantic import BeforeValidator, Discriminator, Field, Tag

from sionna_radar.scenario.cover import CoverPolygon, CoverRaster, MaterialField
from sionna_radar.scenario.problems import unknown
from sionna_radar.scenario.table import InputPath, Point2, Positive, Real, Seed, Table, refuse

KEEP_SIONNA = "sionna"


class CoveredTerrain(Table):
    """Ground of one material, with others over it: classes of a raster, then polygons in the order given."""

    material: str = "ground"
    cover_raster: CoverRaster | None = None
    cover: tuple[CoverPolygon, ...] = ()


class FlatTerrain(CoveredTerrain):
    """A horizontal plane."""

    kind: Literal["flat"]
    size_m: tuple[Positive, Positive] = (300.0, 300.0)
    spacing_m: Positive = 5.0
    fields: tuple[MaterialField, ...] = ()


class HillsTerrain(CoveredTerrain):
    """A seeded Gaussian random surface: white noise, Gaussian filter, scaled to a largest height."""

    kind: Literal["hills"]
    size_m: tuple[Positive, Positive] = (320.0, 320.0)
    spacing_m: Positive = 0.5
    filter_sigma_m: Positive = 25.0
    height_m: Positive = 8.0
    seed: Seed = 1
    fields: tuple[MaterialField, ...] = ()


class FractalTerrain(CoveredTerrain):
    """A seeded self-affine Gaussian random surface: height differences over d spread like d to the Hurst exponent."""

    kind: Literal["fractal"]
    size_m: tuple[Positive, Positive] = (320.0, 320.0)
    spacing_m: Positive = 0.5
    hurst: Annotated[Real, Field(gt=0, lt=1)] = 0.8
    height_m: Positive = 10.0
    seed: Seed = 1
    fields: tuple[MaterialField, ...] = ()


class SampleTerrain(CoveredTerrain):
    """The SRTM tile of Jacksboro, Tennessee, from matplotlib's sample data."""

    kind: Literal["jacksboro"]
    centre_lonlat_deg: Point2 | None = None
    spacing_m: Positive | None = None


class RasterTerrain(CoveredTerrain):
    """The user's own elevation raster: GeoTIFF, Esri ASCII grid, SRTM .hgt, DTED or another plain grid.

    crs, vertical_crs, height_unit: what the file's coordinates and heights are, such as "EPSG:2154", "EPSG:5703" and
    "ft" or "ftUS"; without them what the file says, and metres where it says nothing of its heights.
    centre_lonlat_deg: longitude and latitude of the local origin; without it the middle of the file.
    """

    kind: Literal["raster"]
    path: InputPath
    crs: str | None = None
    vertical_crs: str | None = None
    height_unit: Literal["m", "ft", "ftUS"] | None = None
    centre_lonlat_deg: Point2 | None = None
    spacing_m: Positive | None = None


class CityTerrain(Table):
    """A whole scene that Sionna ships; its materials are mapped to 77 GHz ones by name.

    A material mapped to "sionna" stays Sionna's own, where that is defined at the carrier and scatters.
    """

    kind: Literal["sionna:san_francisco", "sionna:munich", "sionna:florence", "sionna:etoile"]
    materials: dict[str, str] = {}

    @property
    def city(self) -> str:
        """Name of the Sionna scene."""
        return self.kind.removeprefix("sionna:")


TERRAIN_KINDS = tuple(
    kind
    for table in (FlatTerrain, HillsTerrain, FractalTerrain, SampleTerrain, RasterTerrain, CityTerrain)
    for kind in get_args(table.model_fields["kind"].annotation)
)


def _known_kind(value: Any) -> Any:
    """Refuse a table whose kind is unknown, in the words of the file."""
    if isinstance(value, dict):
        kind = value.get("kind")
        if kind is None:
            raise refuse("kind", "required, but not given; add it")
        if kind not in TERRAIN_KINDS:
            raise refuse("kind", unknown(kind, TERRAIN_KINDS))
    return value


def _terrain_tag(value: Any) -> str | None:
    kind = value.get("kind") if isinstance(value, dict) else getattr(value, "kind", None)
    if not isinstance(kind, str):
        return None
    return "sionna" if kind.startswith("sionna:") else kind


Terrain = Annotated[
    Annotated[FlatTerrain, Tag("flat")]
    | Annotated[HillsTerrain, Tag("hills")]
    | Annotated[FractalTerrain, Tag("fractal")]
    | Annotated[SampleTerrain, Tag("jacksboro")]
    | Annotated[RasterTerrain, Tag("raster")]
    | Annotated[CityTerrain, Tag("sionna")],
    Discriminator(_terrain_tag),
    BeforeValidator(_known_kind),
]
