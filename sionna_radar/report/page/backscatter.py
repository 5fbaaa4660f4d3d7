"""The backscatter coefficient of the ground as the radar saw it, cell by cell."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from sionna_radar.foundation.raster import Raster
from sionna_radar.survey.preparation import Prepared

MEANING = (
    "sigma0 is the backscatter coefficient that the scene's material has, in the radar's polarization, at the local "
    "incidence angle under which the pulse whose beam axis met the ground nearest saw the cell; it is a property of "
    "the scene, not an estimate from the echoes, and is empty where no main beam lit the cell or that pulse could not "
    "see it"
)
LOOKS = 20_000
ABOVE_M = 0.01


def sigma0_db(prepared: Prepared, surface: Raster) -> Float[np.ndarray, "row column"]:
    """Return sigma0 in dB of the cells of a surface, NaN where none is defined; see `MEANING`."""
    scene, caster = prepared.scene.scene, prepared.scene.caster
    pose = prepared.flight.sample(LOOKS).true
    range_m = caster.cast(pose.position_m, pose.boresight).distance_m
    met = np.isfinite(range_m)
    cells = np.column_stack([surface.grid.centres_m, surface.height_m.ravel()])
    known = np.isfinite(cells[:, 2])
    value = np.full(len(cells), np.nan)
    if not (met.any() and known.any()):
        return value.reshape(surface.grid.shape)
    origin = pose.position_m[met]
    hit = origin + range_m[met, None] * pose.boresight[met]
    _, nearest = cKDTree(hit[:, :2]).query(cells[known, :2])
    away = cells[known] + [0.0, 0.0, ABOVE_M] - origin[nearest]
    distance = np.linalg.norm(away, axis=1)
    seen = caster.cast(origin[nearest], away / distance[:, None])
    visible = seen.hit & (np.abs(seen.distance_m - distance) < 0.05 + 0.002 * distance)
    linear = np.full(len(away), np.nan)
    for number, own in enumerate(scene.surfaces):
        rows = visible & (seen.surface == number)
        linear[rows] = scene.materials[own.material].sigma0(np.arccos(seen.cosine[rows]))
    value[known] = 10 * np.log10(np.where(linear > 0, linear, np.nan))
    return value.reshape(surface.grid.shape)
