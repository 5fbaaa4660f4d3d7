"""The error by classes of terrain and of view: slope, distance from walls, incidence angle."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from sionna_radar.accuracy.compare import nmad
from sionna_radar.accuracy.slope import gradient
from sionna_radar.foundation.raster import Raster
from sionna_radar.mapping.points import Points

SLOPES_DEG = (0.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 90.0)
INCIDENCES_DEG = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 180.0)
DISTANCES_M = (0.0, 1.0, 2.0, 5.0, 10.0, 20.0, np.inf)


@dataclass(frozen=True, kw_only=True)
class ErrorClass:
    """The error over the cells of one class; NaN without any.

    low, high: its bounds, in degrees or metres; low belongs to it, high to the next one, if there is one.
    count: number of cells. Other fields are as in `DemError`.
    """

    low: float
    high: float
    count: int
    rms_m: float
    mean_m: float
    std_m: float
    nmad_m: float


def by_class(
    error_m: Float[np.ndarray, " cell"], value: Float[np.ndarray, " cell"], bounds: tuple[float, ...]
) -> tuple[ErrorClass, ...]:
    """Return the error by classes of a value; cells without the value belong to none, and empty classes are left out.

    Parameters
    ----------
    error_m:
        DEM minus truth, finite.
    value:
        What decides about the class.
    bounds:
        Of the classes, ascending.

    """
    number = np.searchsorted(bounds, value, side="right") - 1
    number[value == bounds[-1]] = len(bounds) - 2
    classes = []
    for place, (low, high) in enumerate(pairwise(bounds)):
        own = error_m[(number == place) & ~np.isnan(value)]
        if len(own):
            rms_m, mean_m, std_m = float(np.sqrt(np.mean(own**2))), float(own.mean()), float(own.std())
            found = ErrorClass(
                low=low, high=high, count=len(own), rms_m=rms_m, mean_m=mean_m, std_m=std_m, nmad_m=nmad(own)
            )
            classes.append(found)
    return tuple(classes)


def incidence_deg(truth: Raster, points: Points, cells: Bool[np.ndarray, "row column"]) -> Float[np.ndarray, " cell"]:
    """Return the angle between the normal of some cells and the direction to the radar that mapped each.

    That is the radar's measured position at the nearest point. NaN where the surface has no slope, or without points.
    """
    count = int(cells.sum())
    if len(points) == 0 or count == 0:
        return np.full(count, np.nan)
    inside = cells.ravel()
    place = np.column_stack([truth.grid.centres_m[inside], truth.height_m.ravel()[inside]])
    east, north = (part.ravel()[inside] for part in gradient(truth))
    nearest = KDTree(points.position_m[:, :2]).query(place[:, :2])[1]
    to_radar = points.origin_m[nearest] - place
    # The normal is (-east, -north, 1), not yet of unit length.
    cos = to_radar[:, 2] - to_radar[:, 0] * east - to_radar[:, 1] * north
    cos /= np.linalg.norm(to_radar, axis=1) * np.sqrt(1 + east**2 + north**2)
    return np.rad2deg(np.arccos(np.clip(cos, -1.0, 1.0)))
