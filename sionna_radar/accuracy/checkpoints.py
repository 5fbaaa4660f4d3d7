"""The ASPRS vertical accuracy test with checkpoints, and the slopes of a raster.

American Society for Photogrammetry and Remote Sensing, "Positional Accuracy Standards for Digital Geospatial Data",
Edition 2 (2023): at least 30 checkpoints, 10 more for each 1000 km2 beyond the first, at most 120 (annex C);
spread over the whole area; on even ground no steeper than 10 %, so that their horizontal error does not count; and the
accuracy is their RMSE, no multiple of it. The checkpoints' own survey error is added in quadrature; simulated ones have
none. Checkpoints count as non-vegetated (NVA), on open ground: where plants or walls cover more of the map than
`MAX_COVERED` such a class is not representative, and none is stated.

Slopes are third-order finite differences of Horn (1981), as in GDAL and xDEM.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.foundation.randomness import Stream, pulse_generator
from sionna_radar.foundation.raster import Raster


def gradient(raster: Raster) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, "row column"]]:
    """Return the slopes toward east and north, as ratios; NaN at the border and next to empty cells.

    From the three differences on both sides of a cell, the middle ones counted twice (Horn 1981, "Hill shading and the
    reflectance map", Proceedings of the IEEE 69, 14-47).
    """
    z, width = raster.height_m, 8 * raster.grid.spacing_m
    east, north = np.full(z.shape, np.nan), np.full(z.shape, np.nan)
    if min(z.shape) < 3:
        return east, north
    along = z[:, 2:] - z[:, :-2]
    east[1:-1, 1:-1] = (along[:-2] + 2 * along[1:-1] + along[2:]) / width
    across = z[2:] - z[:-2]
    north[1:-1, 1:-1] = (across[:, :-2] + 2 * across[:, 1:-1] + across[:, 2:]) / width
    return east, north


def slope_deg(raster: Raster) -> Float[np.ndarray, "row column"]:
    """Return the slope of each cell in degrees; NaN at the border and next to empty cells."""
    return np.rad2deg(np.arctan(np.hypot(*gradient(raster))))


MIN, MAX = 30, 120
MAX_COVERED = 0.2
MORE, AREA_OF_MORE_KM2 = 10, 1000.0
STEEPEST_DEG = float(np.rad2deg(np.arctan(0.1)))
NOTHING_COVERED: Mapping[str, float] = MappingProxyType({})
# Initial distance of checkpoints as a share of the diagonal, and the factor by which it shrinks.
SPREAD, CLOSER = 0.1, 0.8
# Further candidates add nothing to 120 checkpoints.
MAX_CANDIDATES = 5000


@dataclass(frozen=True, kw_only=True)
class CheckpointTest:
    """A test with checkpoints; heights in metres, NaN without any.

    count, wanted: number of checkpoints, and number required by the standard.
    even: True if all lie on slopes up to 10 %; with too few such cells all lit ones are candidates.
    spacing_m: shortest distance between two of them.
    rms_m: RMSE_V; mean_m, std_m, greatest_m: bias, standard deviation and greatest |error|.
    class_cm: vertical accuracy class that is met, the RMSE_V rounded up to a centimetre; None with too few checkpoints,
        or too little open ground.
    where: the ground they lie on, in words; statement: the result in the words of the standard.
    """

    count: int
    wanted: int
    even: bool
    spacing_m: float
    rms_m: float
    mean_m: float
    std_m: float
    greatest_m: float
    class_cm: int | None
    where: str
    statement: str


def checkpoints_wanted(area_m2: float) -> int:
    """Return the number of checkpoints that the standard requires."""
    excess_km2 = max(area_m2 / 1e6 - AREA_OF_MORE_KM2, 0.0)
    return min(MIN + MORE * int(np.ceil(excess_km2 / AREA_OF_MORE_KM2)), MAX)


def checkpoint_test(
    error: Raster,
    truth: Raster,
    lit: Bool[np.ndarray, "row column"],
    seed: int,
    covered: Mapping[str, float] = NOTHING_COVERED,
    checkpoint_sigma_m: float | None = None,
) -> CheckpointTest:
    """Return the test of a DEM with seeded checkpoints on lit cells that it fills, heights in m.

    error, truth: DEM minus truth, and the truth, for its slopes.
    lit: cells that the main beam reached.
    covered: shares of the cells covered by anything but open ground, by kind of cover.
    checkpoint_sigma_m: standard deviation of measured checkpoints, 0 if unknown; None for simulated ones.
    """
    cells = error.filled & lit
    wanted = checkpoints_wanted(float(cells.sum()) * error.grid.spacing_m**2)
    with np.errstate(invalid="ignore"):
        level = cells & (slope_deg(truth) <= STEEPEST_DEG)
    even = int(level.sum()) >= wanted
    candidates = np.flatnonzero(level if even else cells)
    chosen, spacing_m = _spread(candidates, error, wanted, seed)
    values = error.height_m.ravel()[chosen]
    if len(values) == 0:
        rms_m = mean_m = std_m = greatest_m = float("nan")
    else:
        rms_m = float(np.sqrt(np.mean(values**2) + (checkpoint_sigma_m or 0.0) ** 2))
        mean_m, std_m = float(values.mean()), float(values.std())
        greatest_m = float(np.abs(values).max())
    hidden = [f"{what} hold {fraction:.0%}" for what, fraction in covered.items() if fraction >= MAX_COVERED]
    tested = len(values) >= wanted and not hidden
    class_cm = max(int(np.ceil(round(100 * rms_m, 6))), 1) if tested else None
    return CheckpointTest(
        count=len(values),
        wanted=wanted,
        even=even,
        spacing_m=spacing_m,
        rms_m=rms_m,
        mean_m=mean_m,
        std_m=std_m,
        greatest_m=greatest_m,
        class_cm=class_cm,
        where=_where(even),
        statement=_statement(len(values), wanted, _where(even), rms_m, class_cm, hidden, checkpoint_sigma_m),
    )


def _spread(
    candidates: Int[np.ndarray, " cell"], error: Raster, required: int, seed: int
) -> tuple[Int[np.ndarray, " checkpoint"], float]:
    """Return checkpoints drawn in random order at the largest tried minimum distance that yields enough of them."""
    generator = pulse_generator(seed, Stream.CHECKPOINTS, 0)
    drawn = generator.permutation(candidates)[:MAX_CANDIDATES]
    if len(drawn) <= required:
        return drawn, _closest_m(_places(drawn, error))
    place = _places(drawn, error)
    min_distance_m = SPREAD * float(np.linalg.norm(np.ptp(place, axis=0)))
    while True:
        selected = _darts(place, min_distance_m, required)
        if len(selected) == required:
            return drawn[selected], _closest_m(place[selected])
        min_distance_m *= CLOSER


def _darts(place_m: Float[np.ndarray, "n 2"], min_distance_m: float, required: int) -> list[int]:
    """Return the first places, in order, at the minimum distance from all earlier ones (dart throwing)."""
    free = np.ones(len(place_m), dtype=bool)
    selected: list[int] = []
    while len(selected) < required and free.any():
        selected.append(int(np.argmax(free)))
        free &= np.linalg.norm(place_m - place_m[selected[-1]], axis=1) >= max(min_distance_m, 1e-9)
    return selected


def _places(cell: Int[np.ndarray, " n"], error: Raster) -> Float[np.ndarray, "n 2"]:
    row, column = np.divmod(cell, error.grid.columns)
    return np.column_stack([error.grid.x_m[column], error.grid.y_m[row]])


def _closest_m(place_m: Float[np.ndarray, "n 2"]) -> float:
    if len(place_m) < 2:
        return float("nan")
    distance = np.linalg.norm(place_m[:, None] - place_m[None], axis=2)
    return float(distance[np.triu_indices(len(place_m), 1)].min())


def _where(even: bool) -> str:
    return "slopes up to 10 %" if even else "lit cells of any slope, as too few are no steeper than 10 %"


def _statement(
    count: int,
    required: int,
    where: str,
    rms_m: float,
    class_cm: int | None,
    hidden: Sequence[str],
    checkpoint_sigma_m: float | None,
) -> str:
    standard = "ASPRS Positional Accuracy Standards for Digital Geospatial Data, Edition 2 (2023)"
    if hidden:
        return f"not tested by the {standard}, whose checkpoints lie in the open: {' and '.join(hidden)} of the cells"
    if class_cm is None:
        return f"not tested by the {standard}: it asks for {required} checkpoints, and there are {count} cells for them"
    kind, sigma_text = "simulated", "without error"
    if checkpoint_sigma_m is not None:
        kind = "measured"
        sigma_text = (
            f"with an error of {100 * checkpoint_sigma_m:.1f} cm, included"
            if checkpoint_sigma_m
            else "with an error unknown"
        )
    return (
        f"tested to meet the {standard} for a {class_cm}-cm RMSE_V vertical accuracy class: non-vegetated RMSE_V = "
        f"{100 * rms_m:.1f} cm of {count} {kind} checkpoints on {where}, themselves {sigma_text}"
    )
