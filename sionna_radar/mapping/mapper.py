"""The mapper: inputs and registration of DEM methods, and the grid of the DEM.

A mapper has access to the measured poses, the antenna and the echoes, but not to the truth.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Int

from sionna_radar.detection.detector import RESPONSE_CELLS
from sionna_radar.detection.echoes import Profiles
from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.errors import PluginError, ScenarioError
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.raster import Georeference, Grid, Raster
from sionna_radar.inference.echo.beam import BeamNodes, beam_nodes
from sionna_radar.inference.echo.likelihood import LandCover, Sightings
from sionna_radar.inference.echo.speckle import STILL, SpeckleMemory
from sionna_radar.inference.terrain.heights import Heights
from sionna_radar.inference.terrain.uncertainty import Uncertainty
from sionna_radar.mapping.coverage import closing_cells
from sionna_radar.mapping.obstacles import ObstacleRule, above_ground
from sionna_radar.mapping.point_heights import PointFootprints, point_footprints, point_heights
from sionna_radar.mapping.points import Points
from sionna_radar.mapping.tiles import EachPiece, MapTiles, pieces_here
from sionna_radar.radar.antenna import Antenna

# Usual RMS difference of heights 1 m apart that real ground adds to its landforms: its roughness is 0.5 to 4 cm at the
# scale of metres (Ulaby and Long 2014, section 4-10).
MICRORELIEF_M = 0.03
# The DEM method that maps roofs.
OF_ROOFS = "stepped"


@dataclass(frozen=True, kw_only=True)
class MapInputs:
    """Input of a DEM method.

    points: located echoes.
    sightings: range profiles of the pulses with their measured poses; None if the sensor provides none.
    grid: cells of the DEM.
    max_gap_m: largest distance of a filled cell from a measured one.
    shadow_incidence_rad: surfaces seen at a greater incidence count as shadow.
    find_footprints: computes `footprints` on first use.
    each_piece: evaluates the tiles of a map, in this process or on workers.
    uncertain: whether the errors of the heights are asked for; a method may leave out what only they need.
    microrelief_m: see `Mapper`.
    """

    points: Points
    sightings: Sightings | None
    grid: Grid
    max_gap_m: float
    shadow_incidence_rad: float
    find_footprints: Callable[[], PointFootprints | None] = lambda: None
    each_piece: EachPiece = pieces_here
    uncertain: bool = True
    microrelief_m: float = 0.0

    @cached_property
    def footprints(self) -> PointFootprints | None:
        """Footprints of the points, and over how many pulses their speckle repeats; None if the beam is unknown."""
        return self.find_footprints()

    def heights(self) -> Heights:
        """Return the points as heights over their footprints, with the errors of their ranges."""
        return point_heights(self.points, self.footprints)


@dataclass(frozen=True, kw_only=True)
class CanopyMap:
    """Ground and plants of a map, in the cells that it fills.

    ground, ground_sigma: of the ground, with its standard deviation.
    top, height: of the plants, the latter over the ground; of bare ground that itself, and 0. With their standard
        deviations: without plants that of the ground, and NaN.
    plants: probability of plants.
    cover: what is seen: `GROUND_ALONE`, `PLANTS_ALONE` where the echoes do not tell the ground from them, or `BOTH`.
    """

    ground: Raster
    ground_sigma: Raster
    top: Raster
    top_sigma: Raster
    height: Raster
    height_sigma: Raster
    plants: Raster
    cover: Raster


GROUND_ALONE, PLANTS_ALONE, BOTH = 1, 2, 3


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A DEM with its uncertainty.

    dem: NaN where nothing was seen; sigma: standard deviation of each of its cells, m.
    uncertainty: of other means over cells. Both are None for a method without stated errors.
    canopy: the plants on the ground; None for a method that knows one surface.
    """

    dem: Raster
    sigma: Raster | None = None
    uncertainty: Uncertainty | None = None
    canopy: CanopyMap | None = None

    @classmethod
    def with_sigma(cls, dem: Raster, uncertainty: Uncertainty) -> "Estimate":
        """Return a DEM with the standard deviations of its cells."""
        sigma_m = uncertainty.sigma_m(dem.grid, dem.filled)
        sigma = Raster(grid=dem.grid, height_m=sigma_m, quantity="standard deviation of the height")
        return cls(dem=dem, sigma=sigma, uncertainty=uncertainty)

    def with_shared_error(self, sigma_m: float) -> "Estimate":
        """Return it with an error of this standard deviation that the heights of all cells share.

        Ground and top of plants share it, so that the plants' height is without it.
        """

        def widened(sigma: Raster) -> Raster:
            return replace(sigma, height_m=np.hypot(sigma.height_m, sigma_m))

        canopy = self.canopy
        if canopy is not None:
            widths = {"ground_sigma": widened(canopy.ground_sigma), "top_sigma": widened(canopy.top_sigma)}
            canopy = replace(canopy, **widths)
        return replace(self, sigma=None if self.sigma is None else widened(self.sigma), canopy=canopy)

    def within_sigma(self, least_m: float) -> "Estimate":
        """Return it without cells of a larger standard deviation."""
        if self.sigma is None:
            return self
        kept = self.sigma.height_m <= least_m
        return replace(self, dem=self.dem.within(kept), sigma=self.sigma.within(kept))

    @property
    def of_top(self) -> "Estimate":
        """The plants' top in place of the ground under them; itself for a method that knows one surface."""
        if self.canopy is None:
            return self
        return replace(self, dem=self.canopy.top, sigma=self.canopy.top_sigma, uncertainty=None)


@runtime_checkable
class DemMethod(Protocol):
    """Computes a DEM."""

    @property
    def profiles(self) -> Literal["unused", "optional", "required"]:
        """How the method uses range profiles; if they are required, the sensor must provide them."""
        ...

    def __call__(self, inputs: MapInputs) -> "Raster | Estimate":
        """Return the DEM on `inputs.grid`, NaN where nothing was seen, or an `Estimate` with its uncertainty."""
        ...


@runtime_checkable
class TiledMethod(DemMethod, Protocol):
    """A method that maps in tiles."""

    def tiles(self, inputs: MapInputs) -> MapTiles[Any] | None:
        """Return the tiles of a map; None where it is made at once."""
        ...


@dataclass(frozen=True, kw_only=True)
class Mapper:
    """Computes the DEMs of a survey.

    method, name: the method, and its name in the scenario.
    grid, max_gap_m, shadow_incidence_rad: see `MapInputs`.
    antenna, analyser: for methods that know the beam; no antenna for a lidar.
    doppler_corrected: whether ranges are corrected for Doppler shift.
    memory: temporal decorrelation of speckle.
    microrelief_m: usual RMS difference, over 1 m, of fractal relief upon the landforms; part of what a method states.
    min_confidence_m: cells known less well than by this standard deviation are left out; None keeps all.
    uncertain: see `MapInputs`.
    range_bias_m, range_scale: errors of the radar that are known; see `Sightings`.
    cover: of the ground, where it is known; see `Sightings`.
    surface: which of two surfaces the DEM is of.
    obstacles: what is reported as an obstacle, whose echoes are none of the ground; None where nothing is.
    """

    method: DemMethod
    name: str
    grid: Grid
    max_gap_m: float
    shadow_incidence_rad: float
    antenna: Antenna | None
    analyser: SpectrumAnalyser
    doppler_corrected: bool
    memory: SpeckleMemory = STILL
    microrelief_m: float = 0.0
    min_confidence_m: float | None = None
    uncertain: bool = True
    range_bias_m: float = 0.0
    range_scale: float = 0.0
    cover: LandCover | None = None
    surface: Literal["ground", "top"] = "ground"
    obstacles: ObstacleRule | None = None

    @property
    def keeps_profiles(self) -> bool:
        """Whether the method uses range profiles."""
        return self.method.profiles != "unused"

    @on_one_thread
    def map(
        self,
        points: Points,
        profiles: Profiles | None,
        measured: Callable[[Int[np.ndarray, " pulse"]], Pose],
        each_piece: EachPiece = pieces_here,
    ) -> Estimate:
        """Return the DEM of a survey, with its stated uncertainty; an empty one of a beam that does not scan.

        profiles: range profiles around the points' echoes; None if the sensor provides none, ScenarioError if the
        method requires them.
        measured: returns the measured poses of pulses by their indices.
        each_piece: evaluates the tiles of a map; default: in this process.
        """
        if profiles is None and self.method.profiles == "required":
            message = f"{self.name!r} needs range profiles, which this sensor lacks; set dem.method = 'smooth'"
            raise ScenarioError.of("dem.method", message)
        points, profiles = self._of_ground(points, profiles, measured)
        if points.spread_by_noise:
            return Estimate(dem=Raster(grid=self.grid, height_m=np.full(self.grid.shape, np.nan)))
        made = self.method(self._inputs(points, profiles, measured, each_piece))
        estimate = made if isinstance(made, Estimate) else Estimate(dem=made)
        dem = estimate.dem
        if not isinstance(dem, Raster) or dem.grid != self.grid or np.shape(dem.height_m) != self.grid.shape:
            raise PluginError(f"DEM method {self.name!r}: return a `Raster` on the requested grid, {self.grid}")
        # A method of one's own may return rasters on an equal grid, without its place on the map.
        sigma = None if estimate.sigma is None else replace(estimate.sigma, grid=self.grid)
        estimate = replace(estimate, dem=Raster(grid=self.grid, height_m=dem.height_m), sigma=sigma)
        estimate = estimate.with_shared_error(points.shared_height_sigma_m)
        if self.surface == "top":
            estimate = estimate.of_top
        return estimate if self.min_confidence_m is None else estimate.within_sigma(self.min_confidence_m)

    def tiles(
        self, points: Points, profiles: Profiles | None, measured: Callable[[Int[np.ndarray, " pulse"]], Pose]
    ) -> MapTiles[Any] | None:
        """Return the tiles of a map; None if the method has none."""
        if not isinstance(self.method, TiledMethod):
            return None
        return self.method.tiles(self._inputs(*self._of_ground(points, profiles, measured), measured))

    def _of_ground(
        self, points: Points, profiles: Profiles | None, measured: Callable[[Int[np.ndarray, " pulse"]], Pose]
    ) -> tuple[Points, Profiles | None]:
        """Return the points and the profiles without those from above the ground, where obstacles are reported.

        A map of walls and roofs keeps all: roofs stand out of the ground around them, too.
        """
        if self.obstacles is None or self.antenna is None or len(points) == 0 or self.name == OF_ROOFS:
            return points, profiles
        above = above_ground(points, measured(points.pulse), self.antenna, self.obstacles)
        if not above.any():
            return points, profiles
        if profiles is not None:
            profiles = profiles.rows(np.flatnonzero(~np.isin(profiles.pulse, points.pulse[above])))
        return points.rows(~above), profiles

    def _inputs(
        self,
        points: Points,
        profiles: Profiles | None,
        measured: Callable[[Int[np.ndarray, " pulse"]], Pose],
        each_piece: EachPiece = pieces_here,
    ) -> MapInputs:
        seen = None if profiles is None or not self.keeps_profiles else profiles
        sightings = None if seen is None else self.sightings(seen, measured(seen.pulse))
        return self.inputs(points, sightings, partial(self._footprints, points, measured), each_piece)

    def _footprints(
        self, points: Points, measured: Callable[[Int[np.ndarray, " pulse"]], Pose]
    ) -> PointFootprints | None:
        """Return the footprint and speckle reach of each point; None without a beam of radio waves."""
        if self.beam is None or len(points) == 0:
            return None
        return point_footprints(points, measured, self.beam, self.analyser.chirp, self.memory)

    @cached_property
    def beam(self) -> BeamNodes | None:
        """Directions of the antenna's main lobe; None for a sensor without an antenna."""
        return None if self.antenna is None else beam_nodes(self.antenna)

    def inputs(
        self,
        points: Points,
        sightings: Sightings | None = None,
        find_footprints: Callable[[], PointFootprints | None] = lambda: None,
        each_piece: EachPiece = pieces_here,
    ) -> MapInputs:
        """Return the input of the method."""
        return MapInputs(
            points=points,
            sightings=sightings,
            grid=self.grid,
            max_gap_m=self.max_gap_m,
            shadow_incidence_rad=self.shadow_incidence_rad,
            find_footprints=find_footprints,
            each_piece=each_piece,
            uncertain=self.uncertain,
            microrelief_m=self.microrelief_m,
        )

    def sightings(self, profiles: Profiles, pose: Pose) -> Sightings:
        """Return range profiles with what mapping may know of the radar: its measured pose, its sweep and its beam."""
        assert self.beam is not None  # only a radar has profiles
        return Sightings(
            profiles=profiles,
            pose=pose,
            chirp=self.analyser.chirp,
            beam=self.beam,
            response=self.analyser.response(RESPONSE_CELLS, 1),
            looks_per_cell=self.analyser.looks_per_cell,
            doppler=1.0 if self.doppler_corrected else 0.0,
            reach_m=self.analyser.chirp.max_range_m,
            memory=self.memory,
            microrelief_m=self.microrelief_m,
            range_bias_m=self.range_bias_m,
            range_scale=self.range_scale,
            cover=self.cover,
        )


# West, south, east and north in local metres.
Extent = tuple[float, float, float, float]

MAX_DEM_CELLS = 25_000_000
MAX_CLOSED_CELLS = 100_000_000


def dem_grid(spacing_m: float, extent_m: Extent, max_gap_m: float, place: Georeference | None) -> Grid:
    """Return the cells of the DEM: the map's where the terrain has a place on it, so that other rasters fit it.

    spacing_m: size of the cells.
    extent_m: ground that the beam's axis meets.
    max_gap_m: widest gap that a map of them closes.
    place: georeference of the local frame, if it has one.

    Raises ScenarioError if there are too many cells, or too many in a gap.
    """
    west, south, east, north = extent_m
    cells = (east - west + 2 * spacing_m) * (north - south + 2 * spacing_m) / spacing_m**2
    if cells > MAX_DEM_CELLS:
        enough = spacing_m * 1.05 * np.sqrt(cells / MAX_DEM_CELLS)
        message = (
            f"{spacing_m:g} m makes {cells:.3g} cells of {east - west:.0f} x {north - south:.0f} m, more than "
            f"{MAX_DEM_CELLS:,}; raise it to {enough:.2g}"
        )
        raise ScenarioError.of("dem.spacing_m", message)
    centre_m = place.cell_centre_m(spacing_m) if place else (0.0, 0.0)
    grid = replace(Grid.covering(west, south, east, north, spacing_m, centre_m), georeference=place)
    border = 2 * closing_cells(max_gap_m, spacing_m)
    if (grid.rows + border) * (grid.columns + border) > MAX_CLOSED_CELLS:
        message = (
            f"gaps of {max_gap_m:.3g} m (without the key: as wide as the beams lie apart) are {border:,} cells of "
            f"{spacing_m:g} m wide; give a smaller one, or raise dem.spacing_m"
        )
        raise ScenarioError.of("dem.max_gap_m", message)
    return grid
