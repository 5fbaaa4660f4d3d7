"""From echoes to points along the measured flight, and what the navigation's errors make of a map.

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
from sionna_radar.detection.echoes import Echoes
from sionna_radar.flight.frames import world_from_body
from sionna_radar.flight.navigation import InertialErrors, KnownPoses
from sionna_radar.flight.pulses import PulseSchedule, PulseSequence
from sionna_radar.foundation.raster import Raster
from sionna_radar.foundation.threads import chunks
from sionna_radar.mapping.points import Points, locate
from sionna_radar.radar.chirp import Chirp
from sionna_radar.survey.sensors.sensor import Sensor, corrected, loop_of

# Echoes located, and cells whose errors are found, at once.
PLACED_AT_ONCE = 4096


def place(echoes: Echoes, sensor: Sensor, schedule: PulseSequence) -> Points:
    """Correct the ranges of all echoes of a survey for Doppler, and locate them by measured poses, block by block."""
    located, loop = [], loop_of(sensor)
    for pulses in schedule.blocks(PLACED_AT_ONCE):
        echoes_of_block = corrected(sensor, echoes.of_pulses(pulses.index), pulses, loop)
        located.append(locate(echoes_of_block, pulses.index, pulses.measured))
    return Points.concatenate(located)


def navigation_sigma(
    dem: Raster, points: Points, schedule: PulseSchedule, chirp: Chirp, doppler_corrected: bool
) -> Raster | None:
    """Return the standard deviation of DEM heights from errors of navigation; None if none are stated."""
    system = schedule.navigation
    if not isinstance(system, InertialErrors | KnownPoses) or len(points) == 0 or not dem.filled.any():
        return None
    east, north = (np.nan_to_num(slope)[dem.filled] for slope in gradient(dem))
    normal = np.stack([-east, -north, np.ones(len(east))], axis=1)
    nearest = KDTree(points.position_m[:, :2]).query(dem.grid.centres_m[dem.filled.ravel()])[1]
    shift = chirp.doppler_range_s if doppler_corrected else 0.0
    # Estimated poses have all errors in their own standard deviations.
    constant = system if isinstance(system, InertialErrors) else None
    lever = np.zeros(3) if constant is None else np.array(constant.lever_arm_m) - np.array(schedule.lever_arm_m)
    boresight_rad = np.zeros(3) if constant is None else np.array(constant.boresight_rad)
    lag_s = 0.0 if constant is None else constant.time_offset_s

    def variance(low: int, high: int) -> Float[np.ndarray, " cell"]:
        """Return the variance of some cells: the sum of squares of the height changes by independent errors."""
        of_cells, range_m = normal[low:high], points.range_m[nearest[low:high]]
        pulse, row = np.unique(points.pulse[nearest[low:high]], return_inverse=True)
        pulses, time_s = schedule.pulses(pulse), schedule.time_s[pulse]
        size = system.sizes(time_s)[row]
        body = world_from_body(schedule.trajectory.euler(time_s))[row].transpose(0, 2, 1)
        boresight, velocity = pulses.measured.boresight[row], pulses.measured.velocity_mps[row]
        turns = np.cross(body, boresight[:, None]) * range_m[:, None, None]
        moved = (
            np.eye(3) * size[:, 0, None, :],
            turns * size[:, 2, :, None],
            turns * boresight_rad[:, None],
            shift * size[:, 1, :, None] * boresight[:, :, None] * boresight[:, None],
            body * lever[:, None],
            (lag_s * velocity)[:, None],
        )
        return sum(np.sum(np.einsum("ci,cei->ce", of_cells, each) ** 2, axis=1) for each in moved)

    each = [variance(*bounds) for bounds in chunks(len(nearest), PLACED_AT_ONCE)]
    sigma = np.full(dem.grid.shape, np.nan)
    sigma[dem.filled] = np.sqrt(np.concatenate(each))
    return Raster(grid=dem.grid, height_m=sigma, quantity="standard deviation of the height")
