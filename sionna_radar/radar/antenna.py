"""Antennas that are separable in direction cosines, as planar arrays are.

In the antenna's frame (x boresight, y left, z up) a direction has the cosines u = y and v = z. The voltage
pattern is a product of two cuts and the projected aperture, f(u, v) = A(u) E(v) sqrt(cos), cos = x the angle
from boresight, nothing is sent backward, and the gain is 4 pi |f|^2 over its integral: that of a lossless
antenna.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Inexact
from scipy.integrate import cumulative_simpson, simpson
from scipy.optimize import brentq
from scipy.signal.windows import taylor

from sionna_radar.foundation.decibel import to_db
from sionna_radar.scenario.radar import AntennaTable

# Low side lobes lengthen the array by up to 1.7 at the same number of elements: this keeps them within half a
# wavelength, and leaves a wide beam enough of them to shape its side lobes.
SPACING_WAVELENGTHS = 0.25
# A taper has side lobes below its peak.
HIGHEST_DESIGN_DB = -3.0


@dataclass(frozen=True)
class Cut:
    """A principal-plane cut: voltage, 1 at its peak, on equally spaced direction cosines from -1 to 1."""

    voltage: Float[np.ndarray, " n"]

    @property
    def cosine(self) -> Float[np.ndarray, " n"]:
        """Direction cosines of the samples."""
        return np.linspace(-1.0, 1.0, len(self.voltage))

    def at(self, cosine: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the voltage at direction cosines, linear between the samples."""
        position = (np.clip(cosine, -1.0, 1.0) + 1.0) * ((len(self.voltage) - 1) / 2)
        below = np.minimum(position.astype(np.int64), len(self.voltage) - 2)
        share = position - below
        return self.voltage[below] * (1 - share) + self.voltage[below + 1] * share

    @cached_property
    def power(self) -> Float[np.ndarray, " n"]:
        """Power in the cut's plane over the peak's, with the projected aperture of the whole antenna."""
        return self.voltage**2 * np.sqrt(1 - self.cosine**2)

    @cached_property
    def half_power_width_rad(self) -> float:
        """Angle between the half-power directions on either side of the peak."""
        u, power = self.cosine, self.power
        peak = int(np.argmax(power))
        left = int(np.flatnonzero(power[:peak] < 0.5)[-1])
        right = peak + int(np.flatnonzero(power[peak:] < 0.5)[0])
        low = np.interp(0.5, power[[left, left + 1]], u[[left, left + 1]])
        high = np.interp(-0.5, -power[[right - 1, right]], u[[right - 1, right]])
        return float(np.arcsin(high) - np.arcsin(low))

    @cached_property
    def side_lobe_level(self) -> float:
        """Power of the strongest side lobe over the peak's; 0 without side lobes."""
        power = self.power
        inner = (power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:])
        lobes = np.sort(power[1:-1][inner])
        return float(lobes[-2]) if len(lobes) > 1 else 0.0

    @cached_property
    def two_way_distribution(self) -> Float[np.ndarray, " n"]:
        """Cumulative distribution of the cosine under a density proportional to the two-way power."""
        cumulative = cumulative_simpson(self.voltage**4, x=self.cosine, initial=0.0)
        cumulative = np.maximum.accumulate(cumulative)
        return cumulative / cumulative[-1]

    @cached_property
    def two_way_integral(self) -> float:
        """Integral of voltage^4 over the cosine."""
        return float(simpson(self.voltage**4, x=self.cosine))


@dataclass(frozen=True)
class Antenna:
    """A pencil-beam antenna, the same for sending and receiving.

    azimuth: cut in the plane of boresight and left; elevation: in that of boresight and up.
    polarization: of the sent field on boresight: up (V), left (H), or circular to the right or left (RHCP, LHCP).
    receives: the same polarisation ("co") or the orthogonal one ("cross"). Of a circular wave, "co" is the same
        sense, each as seen along its own way, and a mirror returns the opposite one.
    axial_ratio_db: of the ellipse of a circular antenna, its major axis along V; 0 for a circle.
    """

    azimuth: Cut
    elevation: Cut
    polarization: str = "V"
    receives: str = "co"
    axial_ratio_db: float = 0.0

    @cached_property
    def peak_gain(self) -> float:
        """Power gain at the peak, a ratio: 4 pi over the beam's solid angle."""
        # Integral of A^2 E^2 cos over the half sphere; dOmega = du dv / cos cancels the aperture factor.
        u, v = self.azimuth.cosine, self.elevation.cosine
        along_v = cumulative_simpson(self.elevation.voltage**2, x=v, initial=0.0)
        reach = np.sqrt(np.maximum(1 - u**2, 0.0))
        inner = np.interp(reach, v, along_v) - np.interp(-reach, v, along_v)
        return float(4 * np.pi / simpson(self.azimuth.voltage**2 * inner, x=u))

    def gain(self, direction: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return the power gain toward unit vectors in the antenna's frame."""
        cos, u, v = direction.T
        return self.peak_gain * (self.azimuth.at(u) * self.elevation.at(v)) ** 2 * np.maximum(cos, 0.0)

    @property
    def circular(self) -> bool:
        """Whether the wave is circular, well or badly."""
        return self.polarization in ("RHCP", "LHCP")

    @cached_property
    def jones(self) -> tuple[Inexact[np.ndarray, "2"], Inexact[np.ndarray, "2"]]:
        """The sent field and the one received, both as sent, by their shares of V and H; time as exp(+j w t).

        What is received of a field e is the product with the second one, no part of it conjugated (reciprocity).
        With V up and H left, the field turns to the right where H leads V by a quarter of a turn. The two ports of
        an antenna of axial ratio r are orthogonal: (r, j) and (1, -j r) over sqrt(r^2 + 1).
        """
        if not self.circular:
            ports = [np.array([1.0, 0.0]), np.array([0.0, 1.0])]
            own = ports.pop("VH".index(self.polarization))
            return own, own if self.receives == "co" else ports[0]
        ratio = 10 ** (self.axial_ratio_db / 20)
        hand = 1j if self.polarization == "RHCP" else -1j
        same, opposite = np.array([ratio, hand]), np.array([1.0, -hand * ratio])
        size = np.sqrt(ratio**2 + 1)
        return same / size, (same if self.receives == "co" else opposite) / size

    @property
    def mirrored(self) -> complex:
        """Share of the field that is received of a wave that a sphere or a mirror returns.

        One for a linear antenna that receives what it sends, zero for its cross-polar port. Of a circular antenna of
        axial ratio r it is (r^2 - 1) / (r^2 + 1) in the same sense and 2 r / (r^2 + 1) in the opposite one; the first
        bounds what it rejects of rain (the integrated cancellation ratio).
        """
        sent, received = self.jones
        return complex(sent @ received)

    def fields(
        self, direction: Float[np.ndarray, "n 3"]
    ) -> tuple[Inexact[np.ndarray, "n 3"], Inexact[np.ndarray, "n 3"]]:
        """Return the sent and the received field toward unit vectors, all in the antenna's frame."""
        if not self.circular:
            sent, received = ("VH"[int(port[1])] for port in self.jones)
            return self.field(direction, sent), self.field(direction, received)
        axes = np.stack([self.field(direction, p) for p in "VH"])
        sent_field, received_field = (np.tensordot(port, axes, 1) for port in self.jones)
        return sent_field, received_field

    @staticmethod
    def field(direction: Float[np.ndarray, "n 3"], polarization: str) -> Float[np.ndarray, "n 3"]:
        """Return the unit electric field sent toward unit vectors, both in the antenna's frame.

        V is the meridian through the antenna's up axis, H the circle of latitude, the fields of a
        short vertical electric dipole and of a short vertical magnetic one.
        """
        x, y, z = direction.T
        zero = np.zeros(len(direction))
        level = np.maximum(np.hypot(x, y), 1e-12)
        if polarization == "H":
            return np.stack([-y, x, zero], axis=1) / level[:, None]
        return np.stack([-x * z, -y * z, level**2], axis=1) / level[:, None]

    @property
    def beamwidths_rad(self) -> tuple[float, float]:
        """Measured half-power beamwidths in azimuth and elevation."""
        return self.azimuth.half_power_width_rad, self.elevation.half_power_width_rad


def taylor_cut(beamwidth_rad: float, side_lobe_db: float) -> Cut:
    """Return the cut of a line of elements, half a wavelength apart or closer, with a Taylor taper.

    The spacing is trimmed so that the half-power width is exact, and the taper's design level so that the
    measured side lobe is the wanted one. The number of nearly equal side lobes, nbar, is the least for which
    the taper falls monotonically (Taylor 1955, "Design of line-source antennas": nbar >= 2 A^2 + 1/2, with
    cosh(pi A) the voltage ratio).
    """
    design_db = side_lobe_db
    cut = _designed_cut(beamwidth_rad, design_db)
    for _ in range(3):
        if cut.side_lobe_level == 0.0:  # a beam too wide to have side lobes
            break
        wanted_db = design_db + (side_lobe_db - to_db(cut.side_lobe_level))
        if wanted_db > HIGHEST_DESIGN_DB:  # what is left of a side lobe at the horizon says nothing of the taper
            break
        design_db = wanted_db
        cut = _designed_cut(beamwidth_rad, design_db)
    return cut


def _designed_cut(beamwidth_rad: float, side_lobe_db: float) -> Cut:
    ratio = np.arccosh(10 ** (-side_lobe_db / 20)) / np.pi
    nbar = max(2, int(np.ceil(2 * ratio**2 + 0.5)))
    # The half-power width of a line source of length L wavelengths is near 1 / L.
    elements = max(4, int(np.ceil(1.05 / beamwidth_rad / SPACING_WAVELENGTHS)))
    weights = taylor(elements, nbar=nbar, sll=-side_lobe_db, norm=False, sym=True)
    weights /= weights.sum()
    place = (np.arange(elements) - (elements - 1) / 2) / elements
    half = beamwidth_rad / 2

    def miss(length: float) -> float:
        voltage = weights @ np.cos(2 * np.pi * length * place * np.sin(half))
        return float(voltage - np.sqrt(0.5 / np.cos(half)))

    length = brentq(miss, 0.1 / beamwidth_rad, 1.8 / beamwidth_rad)
    # Odd, so that boresight is a sample; 256 samples per lobe keep linear interpolation within 1e-5.
    u = np.linspace(-1.0, 1.0, 2 * int(np.ceil(256 * length)) + 1)
    voltage = np.zeros(len(u))
    for weight, x in zip(weights, length * place, strict=True):
        voltage += weight * np.cos(2 * np.pi * x * u)
    return Cut(voltage)


def measured_cut(angle_rad: Float[np.ndarray, " n"], power_db: Float[np.ndarray, " n"]) -> Cut:
    """Return a cut from measured power against the angle from boresight, in increasing order.

    Angles outside the measurement get the power of its nearest end. Raises ValueError for angles out of order.
    """
    if np.any(np.diff(angle_rad) <= 0):
        message = "angle_rad must increase from sample to sample; sort the cut"
        raise ValueError(message)
    finest = float(np.min(np.diff(angle_rad)))
    u = np.linspace(-1.0, 1.0, 2 * int(np.ceil(8 / finest)) + 1)
    level_db = np.interp(np.arcsin(u), angle_rad, power_db - np.max(power_db))
    return Cut(10 ** (level_db / 20))


def build_antenna(table: AntennaTable) -> Antenna:
    """Return the antenna of a scenario."""
    azimuth, elevation = table.beamwidths_rad
    return Antenna(
        taylor_cut(azimuth, table.side_lobe_db),
        taylor_cut(elevation, table.side_lobe_db),
        table.polarization,
        table.receive_polarization,
        table.axial_ratio_db,
    )
