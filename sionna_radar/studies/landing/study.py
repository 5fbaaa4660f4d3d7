"""Where to land: the probability that a place of a map is fit, by simulation of the map's errors.

A place is a circle of ground, the footprint, with the plane of least squares through its cells. It is fit if the plane
is no steeper than the largest slope, no cell of the footprint is farther from it than the roughness allows, and neither
ground nor obstacles within the clearance rise above the plane, extended, by more than the height of an obstacle. The
ground is the expected one plus Gaussian errors, with the stated standard deviations and the correlation of
`correlation`, drawn many times; the probability is (fit + 1) / (draws + 2), the posterior mean of a uniform prior. The
slope alone has a closed form, a noncentral chi-square distribution; the largest of many correlated residuals has none
(so also Tomita and Ho 2024, arXiv 2409.09309). A cell of a `stepped` map is, with its stated probability, of the other
side of a step, and higher by the step, together with its neighbours: where a second field of the same correlation is
below the quantile of that probability. Places with an empty cell are unknown.

Sources of the limits:

- Slope: 7 deg, up to which every helicopter may land without an advisory (US Army, FM 3-21.38 "Pathfinder operations",
  chapter 4, as quoted in training notes).
- Obstacle: whatever is 18 inches high (ibid.). Clearance: ten times that, since a landing point should be 10 times as
  far from an obstacle as the obstacle is high (US Marine Corps, MEF personnel qualification standard, p. 106-26).
- Footprint: twice the landing radius of 2 m of PX4's safe landing planner (PX4-Avoidance,
  `waypoint_generator_node.cfg`). FM 3-21.38 asks for 25 m for the smallest helicopters, 50 m for a UH-60.
- Roughness: 0.2 m, that planner's largest standard deviation in a cell; here the largest residual.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
import scipy.fft
from jaxtyping import Bool, Complex, Float, Int
from scipy.ndimage import binary_erosion
from scipy.special import ndtr, ndtri

from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.progress import advance, stage
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.foundation.threads import chunks, in_threads
from sionna_radar.studies.landing.correlation import Correlation

DRAWS, DRAWS_AT_ONCE, MAX_DRAWS = 500, 25, 100_000
# Probability from which on a place is stated fit, and the bins of the check against the truth.
STATED = 0.99
BINS = (0.0, 0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 1.0)
# Places per diameter of the footprint; number and least probability of sites.
PLACES_PER_DIAMETER, MAX_SITES, MIN_PROBABILITY = 8, 10, 0.5
CRITERIA = ("slope", "roughness", "clearance")


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a landing place must be; see the module for sources.

    footprint_m: its diameter. slope_deg, roughness_m: of its plane, and of its ground about that.
    obstacle_m, clearance_m: highest rise above the plane, and radius around its middle within which nothing is higher.
    """

    footprint_m: float = 4.0
    slope_deg: float = 7.0
    roughness_m: float = 0.2
    obstacle_m: float = 0.46
    clearance_m: float = 4.6

    def __post_init__(self) -> None:
        problems = [
            Problem(name, f"must be a positive number{' below 90' * (name == 'slope_deg')}, not {value:g}")
            for name, value in vars(self).items()
            if not 0 < value < (90.0 if name == "slope_deg" else math.inf)
        ]
        if problems:
            raise ScenarioError(problems, "landing")

    def check(self, grid: Grid) -> None:
        """Raise ScenarioError for a footprint that a grid does not resolve or hold."""
        cell_m, reach_m = grid.spacing_m, max(self.clearance_m, self.footprint_m / 2)
        if self.footprint_m < 2 * cell_m:
            message = f"{self.footprint_m:g} m is too small for a plane through cells of {cell_m:g} m"
            raise ScenarioError.of("footprint_m", f"{message}; give {2 * cell_m:g} or more", "landing")
        if 2 * int(reach_m / cell_m) + 1 > min(grid.shape):
            field = "clearance_m" if reach_m == self.clearance_m else "footprint_m"
            size = f"{grid.columns * cell_m:g} x {grid.rows * cell_m:g} m"
            message = f"{reach_m:g} m about a place reach beyond the map of {size}; give a smaller one"
            raise ScenarioError.of(field, message, "landing")


@dataclass(frozen=True, kw_only=True)
class Obstacles:
    """What a survey reports above its map: place (east, north), height and standard deviation of the top, m.

    radius_m: horizontal extent. probability: that it is there.
    """

    place_m: Float[np.ndarray, "n 2"]
    top_m: Float[np.ndarray, " n"]
    sigma_m: Float[np.ndarray, " n"]
    radius_m: Float[np.ndarray, " n"]
    probability: Float[np.ndarray, " n"]


@dataclass(frozen=True, kw_only=True)
class Ground:
    """A map, and what it states of its errors.

    name, crs_wkt: of the map; no CRS for local metres. dem: expected heights.
    sigma_m, correlation: standard deviations of their errors, and correlation between these.
    other_side, step_m: probability that a cell is of the other side of a step, and its height; None without steps.
    truth: true heights, where they are known.
    """

    name: str
    dem: Raster
    sigma_m: Float[np.ndarray, "row column"]
    correlation: Correlation
    crs_wkt: str = ""
    other_side: Float[np.ndarray, "row column"] | None = None
    step_m: Float[np.ndarray, "row column"] | None = None
    obstacles: Obstacles | None = None
    truth: Raster | None = None


@dataclass(frozen=True, kw_only=True)
class Site:
    """A landing site on the map; criteria: value, sigma and probability of each, by name, in degrees and metres."""

    east_m: float
    north_m: float
    height_m: float
    probability: float
    criteria: dict[str, dict[str, float]]


@dataclass(frozen=True, kw_only=True)
class Check:
    """Stated probabilities against the truth.

    bins: low, high, number of places, mean stated probability, and fraction that is fit.
    stated, precision: places stated fit at `STATED`, and the fraction of them that is fit.
    fit, recall: places that are fit, unknown ones too, and the fraction of them that is stated fit.
    """

    bins: tuple[dict[str, float], ...]
    stated: int
    precision: float
    fit: int
    recall: float


@dataclass(frozen=True, kw_only=True)
class Landing:
    """Landing places of a map.

    probability: that a place with its middle in a cell is fit; NaN where it is unknown.
    unknown: fraction of the places that are. sites: the best, at least a footprint apart.
    check: against the truth; None without.
    """

    ground: Ground = field(repr=False)
    limits: Limits
    draws: int
    seed: int
    probability: Raster
    unknown: float
    sites: tuple[Site, ...]
    check: Check | None


def disc(radius_m: float, spacing_m: float) -> Int[np.ndarray, "cell 2"]:
    """Return the offsets (row, column) of cells whose centres lie within a radius."""
    reach = int(radius_m / spacing_m + 1e-9)
    offset = np.argwhere(np.ones((2 * reach + 1, 2 * reach + 1))) - reach
    return offset[np.hypot(*offset.T) * spacing_m <= radius_m * (1 + 1e-9)]


def error_fields(
    correlation: Correlation, grid: Grid, seed: int, draws: range
) -> Iterator[Complex[np.ndarray, "row column"]]:
    """Yield complex Gaussian fields whose parts are independent, of unit variance, by circulant embedding."""
    pad = math.ceil(min(6 * correlation.length_m, correlation.distance_m[-1]) / grid.spacing_m)
    shape = scipy.fft.next_fast_len(grid.rows + pad), scipy.fft.next_fast_len(grid.columns + pad)
    power = np.maximum(correlation.spectrum(shape, grid.spacing_m), 0.0)
    root = np.sqrt(power / power.mean())
    for draw in draws:
        white = np.random.default_rng((seed, draw)).standard_normal((2, *shape))
        yield scipy.fft.ifft2(root * scipy.fft.fft2(white[0] + 1j * white[1]))[: grid.rows, : grid.columns]


@dataclass(frozen=True, kw_only=True)
class Places:
    """The places of a grid, every `step` cells, whose cells are all filled.

    row, column: of their middles. footprint, ring: offsets of the cells of a footprint, and of those around it.
    """

    grid: Grid
    step: int
    row: Int[np.ndarray, " place"]
    column: Int[np.ndarray, " place"]
    footprint: Int[np.ndarray, "cell 2"]
    ring: Int[np.ndarray, "cell 2"]

    @classmethod
    def of(cls, limits: Limits, grid: Grid, filled: Bool[np.ndarray, "row column"]) -> "Places":
        """Return the places; raises ScenarioError as `Limits.check`."""
        limits.check(grid)
        spacing_m, radius_m = grid.spacing_m, limits.footprint_m / 2
        around = disc(max(limits.clearance_m, radius_m), spacing_m)
        within = np.hypot(*around.T) * spacing_m <= radius_m * (1 + 1e-9)
        width = int(np.ptp(around[:, 0])) + 1
        mask = np.zeros((width, width), dtype=bool)
        mask[tuple((around - around.min()).T)] = True
        step = max(1, int(limits.footprint_m / spacing_m / PLACES_PER_DIAMETER))
        every = np.zeros(grid.shape, dtype=bool)
        every[step // 2 :: step, step // 2 :: step] = True
        row, column = np.nonzero(every & binary_erosion(filled, mask))
        return cls(grid=grid, step=step, row=row, column=column, footprint=around[within], ring=around[~within])

    @property
    def place_m(self) -> tuple[Float[np.ndarray, " place"], Float[np.ndarray, " place"]]:
        """East and north of the middles."""
        return self.grid.x_m[self.column], self.grid.y_m[self.row]

    def fitted(self, height_m: Float[np.ndarray, "row column"]) -> Float[np.ndarray, "6 place"]:
        """Return slope, roughness, rise, and the plane of each place; see `fit_places`."""
        from sionna_radar.studies.landing.footprint_kernel import fit_places

        result = np.empty((6, len(self.row)))
        cells = self.row, self.column, self.footprint, self.ring
        fit_places(np.ascontiguousarray(height_m, dtype=float), *cells, self.grid.spacing_m, result)
        return result

    def raster(self, value: Float[np.ndarray, " place"]) -> Raster:
        """Return values of places as a raster of all places, NaN where they are unknown."""
        first, step = self.step // 2, self.step
        cells = np.full(self.grid.shape, np.nan)
        cells[self.row, self.column] = value
        west_m, south_m = float(self.grid.x_m[first]), float(self.grid.y_m[first])
        spacing_m = self.grid.spacing_m * step
        return Raster.from_array(cells[first::step, first::step], spacing_m, west_m=west_m, south_m=south_m)


def assess(ground: Ground, limits: Limits | None = None, *, draws: int = DRAWS, seed: int = 0) -> Landing:
    """Return the landing places of a map.

    Raises ScenarioError without heights, for other draws than 1 to `MAX_DRAWS`, and as `Places.of`.
    """
    if not 1 <= draws <= MAX_DRAWS:
        raise ScenarioError.of("draws", f"must be at least 1 and at most {MAX_DRAWS}, not {draws}", "landing")
    limits, grid = limits or Limits(), ground.dem.grid
    filled = ground.dem.filled & np.isfinite(ground.sigma_m)
    if not filled.any():
        raise ScenarioError.of("survey", "has no cell with a height and its standard deviation; fly again", "landing")
    places = Places.of(limits, grid, filled)
    dem_m, sigma_m = (np.where(filled, values, 0.0) for values in (ground.dem.height_m, ground.sigma_m))
    here = places.fitted(dem_m)
    quantile = None if ground.other_side is None else ndtri(np.nan_to_num(ground.other_side))
    step_m = None if ground.step_m is None else np.nan_to_num(ground.step_m)
    most = np.array([math.tan(math.radians(limits.slope_deg)), limits.roughness_m, limits.obstacle_m])[:, None]

    def some(low: int, high: int) -> Float[np.ndarray, "10 place"]:
        """Return sums over some draws: fit places, fit by each limit, and deviations of each quantity with squares."""
        total = np.zeros((10, len(places.row)))
        for error in error_fields(ground.correlation, grid, seed, range(low, high)):
            drawn_m = dem_m + sigma_m * error.real
            if quantile is not None and step_m is not None:
                drawn_m += np.where(error.imag < quantile, step_m, 0.0)
            off = places.fitted(drawn_m)[:3] - here[:3]
            fit = here[:3] + off <= most
            total += np.concatenate([fit.all(axis=0)[None], fit, off, off**2])
        return total

    summed = np.zeros((10, len(places.row)))
    with stage("drawing", draws):
        for (low, high), part in zip(bounds := chunks(draws, DRAWS_AT_ONCE), in_threads(some, bounds), strict=True):
            summed += part
            advance(high - low)
    chance = (summed[:4] + 1) / (draws + 2)
    sigma = np.sqrt(np.maximum(summed[7:] / draws - (summed[4:7] / draws) ** 2, 0.0))
    clear, rise_m = clear_of_obstacles(ground.obstacles, places, here, limits)
    chance[[0, 3]] *= clear
    here[2] = np.maximum(here[2], rise_m)
    probability = places.raster(chance[0])

    def is_fit(of: Places, truth: Raster) -> Bool[np.ndarray, " place"]:
        return np.asarray(np.all(of.fitted(np.nan_to_num(truth.height_m))[:3] <= most, axis=0))

    return Landing(
        ground=ground,
        limits=limits,
        draws=draws,
        seed=seed,
        probability=probability,
        unknown=1 - len(places.row) / probability.height_m.size,
        sites=tuple(_best(places, here, sigma, chance, limits)),
        check=None if ground.truth is None else _check(ground.truth, places, chance[0], limits, is_fit),
    )


def clear_of_obstacles(
    obstacles: Obstacles | None, places: Places, plane: Float[np.ndarray, "6 place"], limits: Limits
) -> tuple[Float[np.ndarray, " place"], Float[np.ndarray, " place"]]:
    """Return the probability that no reported obstacle is in the way of each place, and the highest rise of one, m.

    Obstacles are independent. One is in the way if it is there, in reach, and its top, Gaussian, is too high.
    """
    (x, y), clear, highest = places.place_m, np.ones(len(places.row)), np.full(len(places.row), -np.inf)
    for number in range(0 if obstacles is None else len(obstacles.top_m)):
        assert obstacles is not None
        east, north = obstacles.place_m[number, 0] - x, obstacles.place_m[number, 1] - y
        near = np.hypot(east, north) <= max(limits.clearance_m, limits.footprint_m / 2) + obstacles.radius_m[number]
        rise = obstacles.top_m[number] - plane[3] - east * plane[4] - north * plane[5]
        too_high = ndtr((rise - limits.obstacle_m) / max(float(obstacles.sigma_m[number]), 1e-9))
        clear = np.where(near, clear * (1 - obstacles.probability[number] * too_high), clear)
        highest = np.where(near, np.maximum(highest, rise), highest)
    return clear, highest


def _best(
    places: Places,
    here: Float[np.ndarray, "6 place"],
    sigma: Float[np.ndarray, "3 place"],
    chance: Float[np.ndarray, "4 place"],
    limits: Limits,
) -> Iterator[Site]:
    """Yield the most probable sites, of equal ones the flattest, each a footprint or more from those before."""
    place_m, taken = np.column_stack(places.place_m), np.zeros((0, 2))
    for place in np.lexsort((here[0], -chance[0])):
        if len(taken) == MAX_SITES or chance[0, place] < MIN_PROBABILITY:
            return
        if np.hypot(*(taken - place_m[place]).T).min(initial=np.inf) < limits.footprint_m:
            continue
        taken = np.concatenate([taken, place_m[place, None]])
        # Degrees of the slope, a tangent.
        turn = np.degrees(1 / (1 + here[0, place] ** 2))
        value, spread = here[:3, place].copy(), sigma[:, place] * (turn, 1, 1)
        value[0] = np.degrees(np.arctan(value[0]))
        rows = zip(CRITERIA, value.tolist(), spread.tolist(), chance[1:, place].tolist(), strict=True)
        yield Site(
            east_m=float(place_m[place, 0]),
            north_m=float(place_m[place, 1]),
            height_m=float(here[3, place]),
            probability=float(chance[0, place]),
            criteria={name: {"value": v, "sigma": s, "probability": p} for name, v, s, p in rows},
        )


def _check(
    truth: Raster,
    places: Places,
    chance: Float[np.ndarray, " place"],
    limits: Limits,
    is_fit: Callable[[Places, Raster], Bool[np.ndarray, " place"]],
) -> Check:
    """Return stated probabilities against the truth."""
    fit, number, stated = is_fit(places, truth), np.digitize(chance, BINS[1:-1]), chance >= STATED
    every = int(is_fit(Places.of(limits, truth.grid, truth.filled), truth).sum())

    def mean(values: Float[np.ndarray, " n"] | Bool[np.ndarray, " n"]) -> float:
        return float(np.mean(values)) if len(values) else float("nan")

    rows = ((number == k, BINS[k], BINS[k + 1]) for k in range(len(BINS) - 1))
    return Check(
        bins=tuple(
            {"low": low, "high": high, "places": int(b.sum()), "stated": mean(chance[b]), "fit": mean(fit[b])}
            for b, low, high in rows
        ),
        stated=int(stated.sum()),
        precision=mean(fit[stated]),
        fit=every,
        recall=float((stated & fit).sum() / every) if every else float("nan"),
    )
