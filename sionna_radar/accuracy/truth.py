"""Ground truth of a survey: true surface, illuminated cells, DEM error, and echoes of volume clutter.

The label of an echo as volume clutter (rain, snow, fog, dust) serves a warning, and is not available to mapping.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.accuracy.compare import DemError, difference, summarise
from sionna_radar.accuracy.illumination import Walls, edge_cells, light, walls_on
from sionna_radar.accuracy.obstacles import POINTS_PER_BEAM, Inventory, Looks, looks_at
from sionna_radar.detection.echoes import Echoes
from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.mapping.coverage import Illumination
from sionna_radar.mapping.points import Points
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.build import CLEAR_M, World
from sionna_radar.scene.footprints import Box
from sionna_radar.scene.ground_cover import Overhang, overhang
from sionna_radar.tracing.paths import VEGETATION, VOLUME, Paths

# Paths this many range cells from an echo are within the main lobe of every window.
REACH_CELLS = 2.0


def mostly_of(
    surface: int, echoes: Echoes, paths: Paths, chirp: Chirp, shift_s: float = 0.0
) -> Bool[np.ndarray, " echo"]:
    """Return the mask of echoes with more power from one surface than from all other paths.

    surface: its number; `VOLUME` for rain, snow, fog or dust, `VEGETATION` for plants.
    echoes: echoes of a block of pulses, ranges as read.
    paths: paths of the same pulses, sorted by pulse.
    chirp: the sweep, for its range cells. shift_s: its range shift per range rate; 0 for ranges without.
    """
    wanted = paths.surface == surface
    if not wanted.any() or len(echoes) == 0:
        return np.zeros(len(echoes), dtype=bool)
    first_pulse = paths.pulse[0]
    # Pulses are laid end to end on one range axis, so that one search serves them all.
    length_m = 2 * chirp.max_range_m + 4 * REACH_CELLS * chirp.range_resolution_m
    range_m = np.minimum(paths.read_m(shift_s), length_m / 2)
    place = (paths.pulse - first_pulse) * length_m + range_m
    order = np.argsort(place)
    power = np.abs(paths.gain.astype(np.complex128)) ** 2 * np.where(wanted, 1.0, -1.0)
    total = np.concatenate([[0.0], np.cumsum(power[order])])
    centre = (echoes.pulse - first_pulse) * length_m + echoes.range_m
    reach_m = REACH_CELLS * chirp.range_resolution_m
    low, high = (np.searchsorted(place[order], centre + side * reach_m) for side in (-1, 1))
    # A range without nearby paths is noise.
    return total[high] - total[low] > 0


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """A DEM against the truth.

    truth, error: rasters on the DEM's grid; error is DEM minus truth.
    lit: cells with a true height that the main beam reached.
    dem_error: of all cells that the DEM fills; lit_error: of those among them that the main beam reached.
    off_wall_error: of lit cells farther than half a footprint from any wall; None where there are no walls.
    beside_wall: cells within half a footprint of a wall; None where there are no walls.
    overhang: cells with more than one surface, of which the highest is the truth; None where nothing can overhang.
    """

    truth: Raster
    error: Raster
    lit: Bool[np.ndarray, "row column"]
    dem_error: DemError
    lit_error: DemError
    off_wall_error: DemError | None
    beside_wall: Bool[np.ndarray, "row column"] | None
    overhang: Overhang | None = None


def compare_dem(
    dem: Raster,
    truth: Raster,
    lit: Bool[np.ndarray, "row column"],
    beside_wall: Bool[np.ndarray, "row column"] | None,
    overhang: Overhang | None = None,
) -> Comparison:
    """Compare a DEM with the true surface on its grid; see `Comparison`."""
    error, lit = difference(dem, truth), lit & truth.filled
    off_wall = None if beside_wall is None else lit & ~beside_wall
    return Comparison(
        truth=truth,
        error=error,
        lit=lit,
        dem_error=summarise(error, lit),
        lit_error=summarise(error.within(lit), lit),
        off_wall_error=None if off_wall is None else summarise(error.within(off_wall), off_wall),
        beside_wall=beside_wall,
        overhang=overhang,
    )


@dataclass(frozen=True, kw_only=True)
class GroundTruth:
    """The true surface under a survey.

    world, buildings: the scene, and the scenario's buildings in it.
    grid, max_gap_m: of the DEM.
    antenna: its main beam illuminates the ground; beams: those of an electronic scan, replacing it.
    altitude_m: of the flight; sets how closely thin obstacles are looked for.
    compared: the surface that a DEM is held against: the ground, or the top of the plants on it.
    """

    world: World
    buildings: tuple[Box, ...]
    grid: Grid
    max_gap_m: float
    antenna: Antenna
    altitude_m: float
    beams: tuple[Antenna, ...] = ()
    compared: Literal["ground", "top"] = "ground"

    @cached_property
    def surface(self) -> Raster:
        """The surface that a DEM is held against."""
        plants = self.world.scene.vegetation
        if self.compared == "ground" or plants is None:
            return self.ground
        top_m = self.ground.height_m + np.nan_to_num(plants.mean_over(self.grid))
        return replace(self.ground, height_m=top_m)

    @cached_property
    def ground(self) -> Raster:
        """Height hit by a vertical ray from above at every cell centre; plants do not count."""
        return Raster(grid=self.grid, height_m=self.world.top_m(self.grid.centres_m).reshape(self.grid.shape))

    @cached_property
    def inventory(self) -> Inventory:
        """The obstacles of the scene."""
        return Inventory.of(self.world, self.altitude_m * min(self.antenna.beamwidths_rad) / POINTS_PER_BEAM)

    @cached_property
    def overhang(self) -> Overhang | None:
        """Cells with more than one surface; None for scenes of ground and solid buildings only, without a count."""
        if not self.world.may_overhang:
            return None
        return overhang(self.world.caster, self.grid, float(self.world.scene.bounds_m[0, 2]) - CLEAR_M)

    @cached_property
    def walls(self) -> Walls:
        """The walls within the map."""
        scene, key = self.world.scene, (repr(self.grid), repr(self.buildings))
        return self.world.caster.once("walls", key, lambda: walls_on(self.grid, scene, self.buildings))

    @cached_property
    def covers(self) -> dict[str, Bool[np.ndarray, "row column"]]:
        """Cells of each cover, seen from above; empty where all are the same."""
        scene, centres_m = self.world.scene, self.grid.centres_m
        if len({surface.material for surface in scene.surfaces}) == 1 and scene.vegetation is None:
            return {}
        above = np.column_stack([centres_m, np.full(len(centres_m), scene.bounds_m[1, 2] + CLEAR_M)])
        hits = self.world.caster.cast(above, np.broadcast_to([0.0, 0.0, -1.0], above.shape))
        name = scene.covers(hits.surface, centres_m).reshape(self.grid.shape)
        return {str(cover): name == cover for cover in np.unique(name[name != ""])}

    def compare(self, dem: Raster, points: Points, lit: Bool[np.ndarray, "row column"]) -> Comparison:
        """Return a DEM's error; the points give the size of the footprints next to walls."""
        beside_wall = edge_cells(self.grid, points, self.antenna.beamwidths_rad[1], self.walls) if self.walls else None
        return compare_dem(dem, self.surface, lit, beside_wall, self.overhang)

    def lit_error(self, dem: Raster, lit: Bool[np.ndarray, "row column"]) -> DemError:
        """Return the error over the illuminated cells of a DEM."""
        lit = lit & self.surface.filled
        return summarise(difference(dem, self.surface).within(lit), lit)


@dataclass(frozen=True, kw_only=True)
class Counted:
    """True hits of a stretch of pulses.

    cell: indices of the DEM's cells that the main beam reached, each once; origin_m: radar position of its last hit.
    silent_cell, silent_origin_m: the same for pulses without an echo only.
    paths: number of paths traced; rain_echoes: number of echoes dominated by rain.
    looks: at obstacles; None where there are none.
    of_plants: whether plants return most of the power of each echo; None without plants.
    """

    cell: Int[np.ndarray, " lit"]
    origin_m: Float[np.ndarray, "lit 3"]
    silent_cell: Int[np.ndarray, " silent"]
    silent_origin_m: Float[np.ndarray, "silent 3"]
    paths: int
    rain_echoes: int
    looks: Looks | None = None
    of_plants: Bool[np.ndarray, " echo"] | None = None


@dataclass(frozen=True, kw_only=True)
class TrueHits:
    """True hits of a survey.

    lit: cells of the DEM that the main beam reached; silent: those reached in pulses without an echo.
    paths: number of paths traced; rain_echoes: number of echoes dominated by rain.
    looks: at obstacles; None where there are none.
    of_plants: as of `Counted`.
    """

    lit: Bool[np.ndarray, "row column"]
    silent: Bool[np.ndarray, "row column"]
    paths: int
    rain_echoes: int
    looks: Looks | None = None
    of_plants: Bool[np.ndarray, " echo"] | None = None


class Tally:
    """True hits of the pulses of a survey, counted block by block.

    shift_s: shift of the ranges that the sensor reads, m per m/s of range rate; 0 for one that knows no Doppler.
    paths: number of paths traced.
    rain_echoes: number of echoes dominated by rain.
    """

    def __init__(self, truth: GroundTruth, chirp: Chirp, shift_s: float) -> None:
        self._truth, self._chirp, self._shift_s = truth, chirp, shift_s
        self._illumination, self._silence = Illumination(truth.grid), Illumination(truth.grid)
        self.paths = self.rain_echoes = 0
        self._reported = (0, 0)
        self._inventory = truth.inventory if truth.inventory.obstacles else None
        self._looks: list[Looks] = []
        self._planted = truth.world.scene.vegetation is not None
        self._of_plants: list[Bool[np.ndarray, " echo"]] = []

    def add(self, paths: Paths, pulses: Pulses) -> None:
        """Count the paths of a block of pulses."""
        light(paths, pulses, self._truth.antenna, self._truth.beams, self._illumination)
        self.paths += len(paths)

    def add_silence(self, paths: Paths, pulses: Pulses, echoes: Echoes) -> None:
        """Count the paths of a block's pulses without an echo."""
        silent = ~np.isin(pulses.index, echoes.pulse)
        if silent.any():
            unanswered = paths.rows(np.flatnonzero(silent[pulses.row_of(paths.pulse)]))
            light(
                unanswered, pulses.rows(np.flatnonzero(silent)), self._truth.antenna, self._truth.beams, self._silence
            )

    def add_looks(self, echoes: Echoes, paths: Paths, pulses: Pulses) -> None:
        """Keep the looks at obstacles of a block, whose echoes have ranges as read."""
        if self._inventory is not None:
            antennas = self._truth.beams or (self._truth.antenna,)
            looks = looks_at(self._inventory, pulses, paths, echoes, antennas, self._chirp, self._shift_s)
            self._looks.append(looks)

    def add_echoes(self, echoes: Echoes, paths: Paths) -> None:
        """Count the echoes of rain and plants among a block's, whose ranges are as read."""
        if np.any(paths.surface == VOLUME):
            self.rain_echoes += int(mostly_of(VOLUME, echoes, paths, self._chirp, self._shift_s).sum())
        if self._planted:
            self._of_plants.append(mostly_of(VEGETATION, echoes, paths, self._chirp, self._shift_s))

    def taken(self) -> Counted:
        """Return the counts since the last call."""
        cell, origin_m = self._illumination.taken()
        silent_cell, silent_origin_m = self._silence.taken()
        paths, rain_echoes = self.paths - self._reported[0], self.rain_echoes - self._reported[1]
        self._reported = self.paths, self.rain_echoes
        looks, self._looks = Looks.concatenate(self._looks) if self._looks else None, []
        of_plants, self._of_plants = np.concatenate(self._of_plants) if self._of_plants else None, []
        return Counted(
            looks=looks,
            of_plants=of_plants,
            cell=cell,
            origin_m=origin_m,
            silent_cell=silent_cell,
            silent_origin_m=silent_origin_m,
            paths=paths,
            rain_echoes=rain_echoes,
        )

    def add_counted(self, counted: Counted) -> None:
        """Add the counts of the following pulses."""
        self._illumination.add_cells(counted.cell, counted.origin_m)
        self._silence.add_cells(counted.silent_cell, counted.silent_origin_m)
        if counted.looks is not None:
            self._looks.append(counted.looks)
        if counted.of_plants is not None:
            self._of_plants.append(counted.of_plants)
        self.paths += counted.paths
        self.rain_echoes += counted.rain_echoes
        self._reported = self._reported[0] + counted.paths, self._reported[1] + counted.rain_echoes

    def hits(self) -> TrueHits:
        """Return the total counts."""
        return TrueHits(
            lit=self._mask(self._illumination),
            silent=self._mask(self._silence),
            paths=self.paths,
            rain_echoes=self.rain_echoes,
            looks=Looks.concatenate(self._looks) if self._looks else None,
            of_plants=np.concatenate(self._of_plants) if self._of_plants else None,
        )

    def _mask(self, cells: Illumination) -> Bool[np.ndarray, "row column"]:
        truth = self._truth
        return cells.mask(truth.max_gap_m, truth.surface, truth.world.caster.visible)
