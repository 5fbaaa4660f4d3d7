"""Our antenna as an antenna pattern of Sionna RT."""

import numpy as np
from jaxtyping import Float, Inexact
from scipy.spatial.transform import Rotation

from sionna_radar.radar.antenna import Antenna, Cut
from sionna_radar.raytracer.backend import load_mitsuba

mi = load_mitsuba()

import drjit as dr  # noqa: E402  (libLLVM and the variant must be chosen before these load)
import sionna.rt as rt  # noqa: E402


class SeparablePattern(rt.AntennaPattern):
    """An antenna of ours as a Sionna antenna pattern; |c|^2 is the power gain.

    jones: shares of the field along Sionna's two axes, theta (ours for V, pointing down) and phi; None for what the
    antenna transmits.
    """

    def __init__(self, antenna: Antenna, jones: Inexact[np.ndarray, "2"] | None = None) -> None:
        # Reversing one axis swaps the two senses of circular polarization.
        shares = (np.conj(antenna.jones[0]) if jones is None else jones).astype(complex).tolist()
        azimuth, elevation = (mi.Float(c.voltage.astype(np.float32)) for c in _cuts(antenna))
        peak = float(np.sqrt(antenna.peak_gain))

        def pattern(theta, phi):  # type: ignore[no-untyped-def]
            sin_theta, cos_theta = dr.sincos(theta)
            sin_phi, cos_phi = dr.sincos(phi)
            cos_boresight = sin_theta * cos_phi
            voltage = _lookup(azimuth, sin_theta * sin_phi) * _lookup(elevation, cos_theta)
            voltage *= peak * dr.sqrt(dr.maximum(cos_boresight, 0.0))
            return tuple(mi.Complex2f(voltage * share.real, voltage * share.imag) for share in shares)

        self.patterns = [pattern]


def _cuts(antenna: Antenna) -> tuple[Cut, Cut]:
    return antenna.azimuth, antenna.elevation


def _lookup(table, cosine):  # type: ignore[no-untyped-def]
    position = (dr.clip(cosine, -1.0, 1.0) + 1.0) * ((dr.width(table) - 1) / 2)
    below = mi.UInt32(dr.minimum(position, dr.width(table) - 2))
    share = position - mi.Float(below)
    return dr.lerp(dr.gather(mi.Float, table, below), dr.gather(mi.Float, table, below + 1), share)


def sionna_angles(R_world_antenna: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3"]:
    """Return the rotations about z, y and x by which Sionna describes an orientation."""
    # A beam straight down is in gimbal lock: any split of the rotation is right, so the warning is irrelevant.
    return Rotation.from_matrix(R_world_antenna).as_euler("ZYX", suppress_warnings=True)
