"""Outlines of raised parts of a map, such as buildings, finer than its cells: from how roof and ground share echoes.

Where a beam crosses an edge, echoes of the roof and of the ground behind it trade places, and the ground in front ends
at the range of the foot of the wall. So the mean profile of every pulse near a part depends on where its walls stand.
The part becomes a body with a plane top and vertical walls on straight edges. Its mean echoes, those of its walls and
those of what is behind it have one reflectivity each (constant gamma, as in `echo_model`). The outline is the likeliest
for all profiles, by Fisher scoring with the reflectivities as further unknowns.

An outline begins as the rectangle around the part's cells, and as its simplified contour. The rectangle, of fewer
unknowns, is taken unless the contour is likelier by more than its further unknowns explain (Schwarz's criterion). A
part keeps its cells if neither is likelier than they.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from scipy.ndimage import binary_dilation, distance_transform_edt, find_objects
from shapely import affinity

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import in_threads, parts
from sionna_radar.mapping.echo_model import Sightings
from sionna_radar.mapping.lobe_samples import lobe_samples

SAMPLES = 1500
# Reflectivity is relative to this range.
UNIT_M = 50.0
# Power in a pulse's cells that the body does not explain, relative to its strongest.
PEDESTAL = 2e-2
HIGHEST_RATIO = 8.0
# Distance by which edges are moved to differentiate, and the most that they move in one step.
PROBE_M, STRIDE_M = 0.1, 1.0
ITERATIONS, HALVINGS = 14, 3
# Edges stay within about this distance of where they begin.
PRIOR_M = 3.0
SIMPLE_M = 1.5
# An outline with less or more of the area of the part than this has found something else.
MOST_CHANGE = 1.5
# A step that gains less, in nepers, is the last.
ENOUGH = 0.05
FEWEST_PULSES, FEWEST_CELLS = 4, 12
# Share of a contour and its rectangle that both cover, above which the rectangle needs no rival.
LIKE_A_BOX = 0.75
MOST_CORNERS = 8
# A raised part is a step above this share of the cells beside it.
BESIDE_CELLS, MOST_OF_RING, WINDOW_CELLS = 2, 0.75, 6
MARGIN_M = 5.0
# An edge is known to within so many standard deviations, with 95 % confidence.
EDGE_SIGMAS = 2.0
Outline = Callable[[Float[np.ndarray, " parameter"]], Float[np.ndarray, "corner 2"]]


class EdgeLikelihood:
    """The likelihood of the profiles around a body, as a function of the outline of its top."""

    def __init__(
        self, sightings: Sightings, behind: Heightfield, top: Float[np.ndarray, "3"], pulses: Int[np.ndarray, " near"]
    ) -> None:
        profiles = sightings.profiles
        self._pulses = pulses
        self._top = top
        direction, share = lobe_samples(sightings.beam, SAMPLES)
        length = np.diff(profiles.start)[pulses]
        self._into = np.concatenate([[0], np.cumsum(length)])
        values = np.arange(self._into[-1]) + np.repeat(profiles.start[pulses] - self._into[:-1], length)
        self._power = profiles.power[values].astype(np.float64)
        strongest = np.maximum.reduceat(self._power, self._into[:-1])
        self._floor = np.repeat(profiles.noise[pulses] + PEDESTAL * strongest, length)
        self._looks = sightings.looks_per_cell
        self.looks = self._looks * len(self._power)
        pose = sightings.pose
        doppler = sightings.doppler * float(sightings.chirp.doppler_range_m(np.ones(1))[0])
        ready = [np.ascontiguousarray(each) for each in (pose.position_m, pose.velocity_mps, pose.R_world_antenna)]
        self._behind = _ranges(sightings, behind, direction, pulses)
        self._given = (
            *(*ready, direction, share, doppler, UNIT_M, float(profiles.cell_m), profiles.first, profiles.start),
            sightings.response,
        )
        self.reflectivity = np.full(3, self._power.sum() / max(len(pulses), 1) / max(share.sum(), 1e-12) / 10)

    def shapes(self, corner: Float[np.ndarray, "corner 2"]) -> Float[np.ndarray, "3 value"]:
        """Return the mean profiles of what is behind, top, and walls, at unit reflectivity."""
        from sionna_radar.mapping.outline_kernels import components

        result = np.empty((3, self._into[-1]))
        ready = np.ascontiguousarray(corner)

        def some(low: int, high: int) -> None:
            which = self._pulses[low:high]
            components(ready, self._top, which, self._behind[low:high], *self._given, self._into[low:high], result)

        list(in_threads(some, parts(len(self._pulses), 16)))
        return result

    def loss(self, shapes: Float[np.ndarray, "3 value"]) -> float:
        """Return the negative log-likelihood at the likeliest reflectivities, which are kept."""
        g = self.reflectivity
        for _ in range(12):
            mean = g @ shapes + self._floor
            excess = np.minimum(self._power / mean, HIGHEST_RATIO) - 1
            share = g[:, None] * shapes / mean
            g = g * np.exp(np.clip(share @ excess / np.maximum(share.sum(axis=1), 1e-9), -1.0, 1.0))
        self.reflectivity = g
        mean = g @ shapes + self._floor
        ratio = self._power / mean
        clipped = np.where(ratio > HIGHEST_RATIO, HIGHEST_RATIO + np.log(ratio / HIGHEST_RATIO), ratio)
        return self._looks * float(np.sum(clipped + np.log(mean)))

    def fit(self, outline: Outline, start: Float[np.ndarray, " n"]) -> "Fit":
        """Return the likeliest parameters of an outline, which are in metres, under a normal prior about the start."""
        state, shapes = start, self.shapes(outline(start))
        best = self.loss(shapes)
        for _ in range(ITERATIONS):
            score, fisher = self._linearised(outline, state, shapes)
            score[: len(state)] -= (state - start) / PRIOR_M**2
            step = np.clip(np.linalg.solve(fisher, score)[: len(state)], -STRIDE_M, STRIDE_M)
            for _ in range(HALVINGS):
                trial = state + step
                trial_shapes = self.shapes(outline(trial))
                loss = self.loss(trial_shapes) + float(np.sum((trial - start) ** 2)) / 2 / PRIOR_M**2
                if loss < best:
                    break
                step /= 2
            else:
                break
            done = best - loss < ENOUGH
            state, shapes, best = trial, trial_shapes, loss
            if done:
                break
        variance = np.diag(np.linalg.inv(self._linearised(outline, state, shapes)[1]))[: len(state)]
        return Fit(best, state, float(np.sqrt(np.median(variance))))

    def _linearised(
        self, outline: Outline, state: Float[np.ndarray, " n"], shapes: Float[np.ndarray, "3 value"]
    ) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m m"]]:
        """Return score and information, prior included, of the parameters and then of log-reflectivities."""
        mean = self.reflectivity @ shapes + self._floor
        moved = [
            self.reflectivity @ (self.shapes(outline(state + probe)) - shapes) / PROBE_M / mean
            for probe in PROBE_M * np.eye(len(state))
        ]
        jacobian = np.array([*moved, *(self.reflectivity[:, None] * shapes / mean)])
        excess = np.minimum(self._power / mean, HIGHEST_RATIO) - 1
        prior = np.concatenate([np.full(len(state), 1 / PRIOR_M**2), np.full(len(shapes), 1e-6)])
        return self._looks * jacobian @ excess, self._looks * jacobian @ jacobian.T + np.diag(prior)


@dataclass(frozen=True)
class Fit:
    """The likeliest outline: its negative log-likelihood with the prior, parameters, and a typical edge's deviation."""

    loss: float
    parameters: Float[np.ndarray, " n"]
    sigma_m: float


def _ranges(
    sightings: Sightings, surface: Heightfield, direction: Float[np.ndarray, "sample 3"], pulses: Int[np.ndarray, " n"]
) -> Float[np.ndarray, "n sample"]:
    from sionna_radar.mapping.outline_kernels import ranges_behind

    height, grid = np.ascontiguousarray(surface.height_m), surface.grid
    on = height, grid.west_m, grid.south_m, grid.spacing_m, surface.steepest, float(height.max())
    position = np.ascontiguousarray(sightings.pose.position_m[pulses])
    R = np.ascontiguousarray(sightings.pose.R_world_antenna[pulses])
    range_m = np.empty((len(pulses), len(direction)))
    reach = float(sightings.reach_m)
    list(
        in_threads(
            lambda low, high: ranges_behind(*on, position, R, direction, reach, range_m, low, high),
            parts(len(pulses), 16),
        )
    )
    return range_m


def rectangle(corner: Float[np.ndarray, "4 2"]) -> Outline:
    """Return the rectangles around one: offsets of its four edges outward, and how far turning moves its corners."""
    centre = corner.mean(axis=0)
    along, across = corner[1] - corner[0], corner[3] - corner[0]
    half = np.hypot(*along) / 2, np.hypot(*across) / 2
    along, across = along / (2 * half[0]), across / (2 * half[1])
    reach = np.hypot(*half)

    def of(parameters: Float[np.ndarray, "5"]) -> Float[np.ndarray, "corner 2"]:
        east, west, north, south, turn = parameters
        angle = turn / reach
        a = np.cos(angle) * along + np.sin(angle) * across
        b = np.cos(angle) * across - np.sin(angle) * along
        low, high = (-half[0] - west, half[0] + east), (-half[1] - south, half[1] + north)
        ends = [(low[0], high[0]), (low[1], high[0]), (low[1], high[1]), (low[0], high[1])]
        return np.array([centre + p * a + q * b for p, q in ends])

    return of


def polygon(corner: Float[np.ndarray, "corner 2"]) -> Outline:
    """Return the polygons around one: offsets of all of its corners."""
    return lambda parameters: corner + parameters.reshape(-1, 2)


def with_outlines(
    sightings: Sightings,
    axis_m: Float[np.ndarray, "pulse 3"],
    height_m: Float[np.ndarray, "row column"],
    part: Int[np.ndarray, "row column"],
    supported: Bool[np.ndarray, "row column"],
    grid: Grid,
    step_m: float,
    flat_m: float,
) -> Float[np.ndarray, "row column"]:
    """Return a map whose raised parts end at their likeliest outlines: each cell has the height at its centre.

    Parameters
    ----------
    sightings, axis_m:
        Profiles, measured poses, and where on their axes the echoes of the pulses are.
    height_m, part, supported:
        The map, the part that each cell belongs to, and whether echoes support it.
    grid, step_m:
        Cells of the map, and the least difference between parts.
    flat_m:
        Median distance of its heights from a plane above which a part has no plane top, and keeps its cells.

    """
    result = height_m.copy()
    raised, crumbs = raised_parts(height_m, part, step_m)
    low = ~np.isin(part, [*raised, *crumbs])
    if not low.any():
        return result
    row, column = distance_transform_edt(~low, return_distances=False, return_indices=True)
    ground_m = height_m[row, column]
    of_crumb = np.isin(part, crumbs)
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    for number, window in raised.items():
        cells = part[window] == number
        pulses = _near(axis_m, x[window][cells], y[window][cells])
        if len(pulses) < FEWEST_PULSES or (cells & supported[window]).sum() < FEWEST_CELLS:
            continue
        top = _plane_through(height_m[window], cells, x[window], y[window])
        plane = top[0] + top[1] * x[window] + top[2] * y[window]
        if np.median(np.abs(height_m[window] - plane)[cells]) > flat_m:
            continue
        beside = binary_dilation(cells, iterations=BESIDE_CELLS)
        around = cells | (of_crumb[window] & np.isin(part[window], part[window][beside]))
        behind = height_m.copy()
        behind[window][around] = ground_m[window][around]
        likelihood = EdgeLikelihood(sightings, Heightfield(grid=grid, height_m=behind), top, pulses)
        inside = _inside_outline(likelihood, cells & supported[window], grid.cut(*window))
        if inside is not None:
            kept = np.where(cells, height_m[window], plane)
            result[window] = np.where(inside, kept, np.where(around, ground_m[window], result[window]))
    return result


def raised_parts(
    height_m: Float[np.ndarray, "row column"], part: Int[np.ndarray, "row column"], step_m: float
) -> tuple[dict[int, tuple[slice, slice]], list[int]]:
    """Return the parts that stand higher than most of what is around them, and those of them too small to outline.

    Of each of the former, the window of the map with its cells and some more around them.
    """
    raised: dict[int, tuple[slice, slice]] = {}
    crumbs: list[int] = []
    for number, found in enumerate(find_objects(part + 1)):
        if found is None:  # a number that is no part's
            continue
        rows, columns = found
        window = (
            slice(max(rows.start - WINDOW_CELLS, 0), min(rows.stop + WINDOW_CELLS, part.shape[0])),
            slice(max(columns.start - WINDOW_CELLS, 0), min(columns.stop + WINDOW_CELLS, part.shape[1])),
        )
        cells, height = part[window] == number, height_m[window]
        ring = binary_dilation(cells, iterations=BESIDE_CELLS) & ~cells
        if ring.any() and np.mean(np.median(height[cells]) - height[ring] > step_m) > MOST_OF_RING:
            if cells.sum() >= FEWEST_CELLS:
                raised[number] = window
            else:
                crumbs.append(number)
    return raised, crumbs


def _near(
    axis_m: Float[np.ndarray, "pulse 3"], x_m: Float[np.ndarray, " cell"], y_m: Float[np.ndarray, " cell"]
) -> Int[np.ndarray, " near"]:
    """Return the pulses whose axes come near some cells."""
    east = (axis_m[:, 0] > x_m.min() - MARGIN_M) & (axis_m[:, 0] < x_m.max() + MARGIN_M)
    return np.flatnonzero(east & (axis_m[:, 1] > y_m.min() - MARGIN_M) & (axis_m[:, 1] < y_m.max() + MARGIN_M))


def _plane_through(
    height_m: Float[np.ndarray, "row column"],
    cells: Bool[np.ndarray, "row column"],
    x_m: Float[np.ndarray, "row column"],
    y_m: Float[np.ndarray, "row column"],
) -> Float[np.ndarray, "3"]:
    design = np.column_stack([np.ones(int(cells.sum())), x_m[cells], y_m[cells]])
    plane: Float[np.ndarray, 3] = np.linalg.lstsq(design, height_m[cells], rcond=None)[0]
    return plane


def _inside_outline(
    likelihood: EdgeLikelihood, cells: Bool[np.ndarray, "row column"], grid: Grid
) -> Bool[np.ndarray, "row column"] | None:
    """Return the cells within the likeliest outline of a part; None if the part's cells are likelier themselves.

    A cell whose centre may as well be within the outline as not, from how well the edges are known, counts as within:
    of heights that are as good the highest counts, as in `levels`.
    """
    contour = _contour(cells, grid)
    if contour is None:
        return None
    at_cells = likelihood.loss(likelihood.shapes(_corners(contour)))
    around = contour.minimum_rotated_rectangle
    # A ragged contour touches its rectangle with its farthest corners only.
    box = affinity.scale(around, *[np.sqrt(contour.area / around.area)] * 2)
    outline = rectangle(_corners(box))
    found = likelihood.fit(outline, np.zeros(5))
    corner = outline(found.parameters)
    simple = _corners(contour.simplify(SIMPLE_M))
    if contour.intersection(box).area < LIKE_A_BOX * contour.union(box).area and 4 < len(simple) <= MOST_CORNERS:
        outline = polygon(simple)
        other = likelihood.fit(outline, np.zeros(2 * len(simple)))
        further = (len(other.parameters) - len(found.parameters)) / 2 * np.log(likelihood.looks)
        if other.loss + further < found.loss:
            found, corner = other, outline(other.parameters)
    area = shapely.Polygon(corner).area
    if found.loss > at_cells or not contour.area / MOST_CHANGE < area < MOST_CHANGE * contour.area:
        return None
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    shape = shapely.Polygon(corner).buffer(0).buffer(EDGE_SIGMAS * found.sigma_m, join_style="mitre")
    inside: Bool[np.ndarray, "row column"] = shapely.contains_xy(shape, x, y)
    return inside


def _contour(cells: Bool[np.ndarray, "row column"], grid: Grid) -> shapely.Polygon | None:
    row, column = np.nonzero(cells)
    half = grid.spacing_m / 2
    x, y = grid.x_m[column], grid.y_m[row]
    joined = shapely.union_all(shapely.box(x - half, y - half, x + half, y + half))
    if joined.geom_type == "MultiPolygon":
        joined = max(joined.geoms, key=lambda one: one.area)
    return shapely.Polygon(joined.exterior) if joined.geom_type == "Polygon" and joined.area > 0 else None


def _corners(shape: shapely.Polygon) -> Float[np.ndarray, "corner 2"]:
    return np.array(shape.exterior.coords)[:-1]
