"""Self-test of the undocumented parts of Sionna RT that the engines rely on.

The engines fill Sionna's path buffer through private names. Another release may rename one, and would then compute from
zeros, or from uninitialised memory, without an error.
"""

import functools
import math
from importlib import metadata

import numpy as np
from scipy.constants import speed_of_light

from sionna_radar.flight.frames import whisk_broom_from_antenna, world_from_body
from sionna_radar.foundation.errors import BackendError
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.array_antenna import taylor_cut
from sionna_radar.scene.model import Scene, Surface
from sionna_radar.surfaces.backscatter import ConstantGammaBackscatter
from sionna_radar.tracing.sionna.fields import calculate_fields, diffuse_buffer
from sionna_radar.tracing.sionna.material import mi
from sionna_radar.tracing.sionna.pattern import sionna_angles
from sionna_radar.tracing.sionna.scene import SionnaScene

TESTED = "2.2.0"
CARRIER_HZ, HEIGHT_M, GAMMA, SOLID_ANGLE_SR = 77e9, 10.0, 0.1, 1e-4
TOLERANCE = 1e-3


@functools.cache
def check_sionna() -> None:
    """Compute the echo of a small patch of ground at nadir, and compare it with the radar equation.

    Raises BackendError if Sionna RT gives a different gain or delay, or lacks something that the engines rely on.
    """
    corner = np.array([[-50.0, -50.0, 0.0], [50.0, -50.0, 0.0], [0.0, 50.0, 0.0]])
    ground = Surface(name="plane", vertices_m=corner, faces=np.array([[0, 1, 2]]), material="ground")
    scene = Scene(
        surfaces=(ground,),
        materials={"ground": ConstantGammaBackscatter(GAMMA)},
        targets=(),
        ground_material="ground",
        georeference=None,
    )
    cut = taylor_cut(math.radians(10.0), -20.0)
    antenna = Antenna(cut, cut, "V")
    sionna = SionnaScene(scene, antenna, CARRIER_HZ)
    down = world_from_body(np.zeros((1, 3))) @ whisk_broom_from_antenna(0.0, np.zeros(1))
    buffer = diffuse_buffer(
        mi.UInt32([0]),
        mi.Point3f(0.0, 0.0, [0.0]),
        mi.UInt32(sionna.shape_of_surface.astype(np.uint32)),
        mi.UInt32([0]),
        mi.Float([4 * math.pi / SOLID_ANGLE_SR]),
        mi.Bool([True]),
    )
    fields = calculate_fields(
        sionna, buffer, mi.Point3f(0.0, 0.0, [HEIGHT_M]), mi.Point3f(sionna_angles(down).T.astype(np.float32))
    )
    gain = complex(fields.a[0][0].real.numpy()[0], fields.a[0][0].imag.numpy()[0])
    wavelength_m = speed_of_light / CARRIER_HZ
    expected = (wavelength_m * antenna.peak_gain / HEIGHT_M) ** 2 * GAMMA * SOLID_ANGLE_SR / (4 * math.pi) ** 3
    delay_s = 2 * HEIGHT_M / speed_of_light
    right = abs(abs(gain) ** 2 / expected - 1) < TOLERANCE and abs(fields.tau.numpy()[0] / delay_s - 1) < TOLERANCE
    if not right:
        raise BackendError(
            f"sionna-rt {metadata.version('sionna-rt')} gives a test path the power {abs(gain) ** 2:.3g} instead of "
            f"{expected:.3g}; install sionna-rt=={TESTED}, which was tested"
        )
