"""Maps of vegetated ground against the truth: how high they lie in the canopy, and how well they tell both surfaces."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation

from sionna_radar.accuracy.uncertainty import calibration
from sionna_radar.foundation.raster import Raster
from sionna_radar.mapping.mapper import CanopyMap
from sionna_radar.mapping.points import Points


@dataclass(frozen=True, kw_only=True)
class CanopyReading:
    """The heights of a DEM in vegetation; the truth is the ground below.

    count: filled cells with plants.
    height_m: mean height of these plants.
    above_ground_m: mean height of the DEM above ground in these cells.
    share: the second over the first: 0 for a DEM of the ground, 1 for one of the tops.
    ground_rms_m, top_rms_m: root mean square of the DEM less the ground, and less the tops.
    """

    count: int
    height_m: float
    above_ground_m: float
    share: float
    ground_rms_m: float
    top_rms_m: float


def read_canopy(error: Raster, height_m: Float[np.ndarray, "row column"]) -> CanopyReading:
    """Return the statistics of a DEM's height within the canopy.

    error: the DEM less the ground.
    height_m: height of the plants over each cell; NaN where none stand.
    """
    among = error.filled & np.isfinite(height_m)
    if not among.any():
        nothing = float("nan")
        return CanopyReading(
            count=0, height_m=nothing, above_ground_m=nothing, share=nothing, ground_rms_m=nothing, top_rms_m=nothing
        )
    above, height = error.height_m[among], height_m[among]
    return CanopyReading(
        count=int(among.sum()),
        height_m=float(height.mean()),
        above_ground_m=float(above.mean()),
        share=float(above.mean() / height.mean()),
        ground_rms_m=float(np.sqrt(np.mean(above**2))),
        top_rms_m=float(np.sqrt(np.mean((above - height) ** 2))),
    )


@dataclass(frozen=True, kw_only=True)
class SurfaceErrors:
    """Errors of a surface over some cells.

    count: of cells. mean_m, rms_m: of the errors.
    coverage: shares of the cells within the stated intervals of 68 and 95 %; NaN without stated errors.
    """

    count: int
    mean_m: float
    rms_m: float
    coverage: dict[str, float]

    @classmethod
    def of(cls, error_m: Float[np.ndarray, " cell"], sigma_m: Float[np.ndarray, " cell"]) -> "SurfaceErrors":
        """Return the statistics of errors and their stated standard deviations."""
        if len(error_m) == 0:
            nothing = float("nan")
            return cls(count=0, mean_m=nothing, rms_m=nothing, coverage={"68": nothing, "95": nothing})
        shares = calibration(error_m, sigma_m).coverage
        return cls(
            count=len(error_m),
            mean_m=float(np.mean(error_m)),
            rms_m=float(np.sqrt(np.mean(error_m**2))),
            coverage={share: shares[share] for share in ("68", "95")},
        )


@dataclass(frozen=True, kw_only=True)
class CanopyCheck:
    """The two surfaces of a map of vegetated ground against the truth, over lit cells.

    ground: under plants, by the share of a cell that they cover: up to 60 %, up to 90 %, and more.
    bare: ground farther than a footprint from all plants.
    height: of plants over the ground, against their mean in each cell, where plants are mapped as such.
    missed: share of the cells more than half under plants that the map takes for bare.
    invented: share of the bare cells that it takes for plants.
    precision, recall, f1: of the points that it takes for ground, NaN without any; an echo is of what returns most of
        its power.
    """

    ground: dict[str, SurfaceErrors]
    bare: SurfaceErrors
    height: SurfaceErrors
    missed: float
    invented: float
    precision: float
    recall: float
    f1: float


_COVERS = {"up to 60 %": (0.0, 0.6), "60 to 90 %": (0.6, 0.9), "over 90 %": (0.9, 1.01)}


def errors_by_cover(
    error_m: Float[np.ndarray, " cell"], sigma_m: Float[np.ndarray, " cell"], share: Float[np.ndarray, " cell"]
) -> dict[str, SurfaceErrors]:
    """Return the statistics of errors under plants, by the share of a cell that these cover.

    Parameters
    ----------
    error_m, sigma_m:
        Errors in metres, and their stated standard deviations.
    share:
        Share of each cell under plants, 0 to 1; bare cells are left out.

    Returns
    -------
    Statistics for each class of cover, by its name: up to 60 %, up to 90 %, and more.
    """
    classes = {name: (share > low) & (share <= high) for name, (low, high) in _COVERS.items()}
    return {name: SurfaceErrors.of(error_m[cells], sigma_m[cells]) for name, cells in classes.items()}


def check_canopy(
    canopy: CanopyMap,
    truth: tuple[Raster, Float[np.ndarray, "row column"], Float[np.ndarray, "row column"]],
    lit: Bool[np.ndarray, "row column"],
    points: tuple[Points, Bool[np.ndarray, " point"]],
    footprint_m: float,
) -> CanopyCheck:
    """Return the errors of a map's ground and canopy heights, and its detection rates of plants.

    canopy: the map of both.
    truth: the true ground, the mean height of the plants in each cell, NaN for none, and the share under plants.
    lit: cells that the main beam reached.
    points: the located echoes, and whether plants return most of the power of each.
    footprint_m: width of the beam on the ground.
    """
    true_ground, plants_m, share = truth
    dem, sigma = canopy.ground, canopy.ground_sigma
    some = lit & dem.filled & true_ground.filled
    error_m = dem.height_m - true_ground.height_m
    planted = share > 0
    reach = max(1, round(footprint_m / dem.grid.spacing_m))
    bare = some & ~binary_dilation(planted, iterations=reach)
    found = canopy.plants.height_m > 0.5
    tops = some & planted & found
    located, of_plants = points
    is_ground = np.zeros(0, dtype=bool) if located.ground_probability is None else located.ground_probability > 0.5
    right = int(np.sum(is_ground & ~of_plants)) if len(is_ground) else 0
    taken, true = int(is_ground.sum()), int(np.sum(~of_plants))
    half = some & (share > 0.5)
    return CanopyCheck(
        ground=errors_by_cover(error_m[some], sigma.height_m[some], share[some]),
        bare=_errors(error_m, sigma.height_m, bare),
        height=_errors(canopy.height.height_m - plants_m, canopy.height_sigma.height_m, tops),
        missed=float(np.mean(~found[half])) if half.any() else float("nan"),
        invented=float(np.mean(found[bare])) if bare.any() else float("nan"),
        precision=right / taken if taken else float("nan"),
        recall=right / true if true else float("nan"),
        f1=2 * right / (taken + true) if taken + true else float("nan"),
    )


def _errors(
    error_m: Float[np.ndarray, "row column"],
    sigma_m: Float[np.ndarray, "row column"],
    cells: Bool[np.ndarray, "row column"],
) -> SurfaceErrors:
    return SurfaceErrors.of(error_m[cells], sigma_m[cells])
