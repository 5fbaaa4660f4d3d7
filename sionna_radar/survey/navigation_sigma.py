"""DEM height errors due to the stated errors of the navigation system.

An echo is placed at o + r b: the measured position, the range, and the boresight. Errors of these move it by

    do + r (dtheta x b) + b dr,   dr = -D (dv . b),

dtheta turning the platform and D being the range shift of an echo per range rate, where that is corrected. On ground of
the normal n = (-slope east, -slope north, 1) a displacement d changes the height of the map by n . d. To first order
the squares of all stated errors add up. Neighbouring cells share them, for the errors of a navigation system change
slowly: unlike those of speckle they do not become less when cells are averaged.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from sionna_radar.accuracy.checkpoints import gradient
from sionna_radar.flight.frames import world_from_body
from sionna_radar.flight.navigation import InertialErrors
from sionna_radar.flight.pulses import PulseSchedule
from sionna_radar.foundation.raster import Raster
from sionna_radar.mapping.points import Points
from sionna_radar.radar.chirp import Chirp


def navigation_sigma(
    dem: Raster, points: Points, schedule: PulseSchedule, chirp: Chirp, doppler_corrected: bool
) -> Raster | None:
    """Return the standard deviation of the heights of a DEM from errors of navigation.

    Parameters
    ----------
    dem, points:
        The map, and the located echoes.
    schedule:
        The pulses, with their navigation system.
    chirp, doppler_corrected:
        The sweep, and whether ranges are corrected for Doppler shift by the measured velocity.

    Returns
    -------
    None for exact navigation, or a system that states no errors.

    """
    system = schedule.navigation
    if not isinstance(system, InertialErrors) or len(points) == 0 or not dem.filled.any():
        return None
    pulse, row = np.unique(points.pulse, return_inverse=True)
    pulses, time_s = schedule.pulses(pulse), schedule.time_s[pulse]
    size = system.sizes(time_s)[row]
    body = world_from_body(schedule.trajectory.euler(time_s))[row]
    boresight, velocity = pulses.measured.boresight[row], pulses.measured.velocity_mps[row]
    east, north = (np.nan_to_num(slope) for slope in gradient(dem))
    nearest = KDTree(points.position_m[:, :2]).query(dem.grid.centres_m[dem.filled.ravel()])[1]
    normal = np.stack([-east[dem.filled], -north[dem.filled], np.ones(len(nearest))], axis=1)
    shift = chirp.doppler_range_m(np.ones(1))[0] if doppler_corrected else 0.0
    turns = np.cross(body.transpose(0, 2, 1), boresight[:, None]) * points.range_m[:, None, None]
    lever = np.array(system.lever_arm_m) - np.array(schedule.lever_arm_m)
    variance = (
        _squares(normal, np.eye(3) * size[:, 0, None, :], nearest)
        + _squares(normal, turns * size[:, 2, :, None], nearest)
        + _squares(normal, turns * np.array(system.boresight_rad)[:, None], nearest)
        + _squares(normal, shift * size[:, 1, :, None] * boresight[:, :, None] * boresight[:, None], nearest)
        + _squares(normal, body.transpose(0, 2, 1) * lever[:, None], nearest)
        + _squares(normal, (system.time_offset_s * velocity)[:, None], nearest)
    )
    sigma = np.full(dem.grid.shape, np.nan)
    sigma[dem.filled] = np.sqrt(variance)
    return Raster(grid=dem.grid, height_m=sigma, quantity="standard deviation of the height")


def _squares(
    normal: Float[np.ndarray, "cell 3"], moved: Float[np.ndarray, "point error 3"], nearest: np.ndarray
) -> Float[np.ndarray, " cell"]:
    """Return the sum of squared height changes from independent errors that move points."""
    return np.sum(np.einsum("ci,cei->ce", normal, moved[nearest]) ** 2, axis=1)
