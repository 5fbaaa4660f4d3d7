"""Antenna patterns: separable in direction cosines (planar arrays) or arbitrary; gain, beamwidth, main lobe.

In the antenna's frame (x boresight, y left, z up) a direction has the cosines u = y and v = z. The voltage
pattern of a separable one is a product of two cuts and the projected aperture, f(u, v) = A(u) E(v) sqrt(cos), cos = x
the angle from boresight, there is no backward radiation, and the gain is 4 pi |f|^2 over its integral: that of a
lossless antenna.

The extent of a main lobe has a level for each use, as two-way power over the peak: `LIT` for the mappable ground of a
survey, `FOLDING` for echoes that must not alias into an image, `FOLLOWED` for models of the whole echo.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, Protocol, no_type_check, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Inexact
from scipy.integrate import cumulative_simpson, simpson

from sionna_radar.foundation.compiled import compiled
from sionna_radar.radar.two_way_grid import TwoWayGrid, two_way_grid

# Largest number of samples on either side of a cut.
MAX_CUT_SAMPLES = 50_000


@runtime_checkable
class Pattern(Protocol):
    """A radiation pattern: amplitudes relative to the peak, and derived quantities."""

    def amplitude(self, direction: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
        """Return the amplitude over the peak's toward unit vectors in the antenna's frame."""

    @property
    def directivity(self) -> float:
        """4 pi over the integral of the relative power over the sphere."""

    @property
    def step_rad(self) -> float:
        """Angle within which the pattern hardly changes."""

    @property
    def R_face_antenna(self) -> Float[np.ndarray, "3 3"]:
        """Rotation from the antenna's frame to the frame of its radiating face."""


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
        lower = np.minimum(position.astype(np.int64), len(self.voltage) - 2)
        weight = position - lower
        return self.voltage[lower] * (1 - weight) + self.voltage[lower + 1] * weight

    @cached_property
    def power(self) -> Float[np.ndarray, " n"]:
        """Power in the cut's plane over the peak, including the projected aperture of the antenna."""
        return self.voltage**2 * np.sqrt(1 - self.cosine**2)

    @cached_property
    def half_power_width_rad(self) -> float:
        """Angle between the half-power directions on either side of the peak."""
        return half_power_width_rad(self.cosine, self.power)

    @cached_property
    def side_lobe_level(self) -> float:
        """Power of the strongest side lobe over the peak; 0 without side lobes."""
        power = self.power
        inner = (power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:])
        lobes = np.sort(power[1:-1][inner])
        return float(lobes[-2]) if len(lobes) > 1 else 0.0

    @cached_property
    def two_way_distribution(self) -> Float[np.ndarray, " n"]:
        """Cumulative distribution of the cosine under a density proportional to the two-way power."""
        return self._distribution(self.voltage**4)

    @cached_property
    def one_way_distribution(self) -> Float[np.ndarray, " n"]:
        """Cumulative distribution of the cosine under a density proportional to the one-way power."""
        return self._distribution(self.voltage**2)

    def _distribution(self, density: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        cumulative = cumulative_simpson(density, x=self.cosine, initial=0.0)
        cumulative = np.maximum.accumulate(cumulative)
        return cumulative / cumulative[-1]

    @cached_property
    def two_way_integral(self) -> float:
        """Integral of voltage^4 over the cosine."""
        return float(simpson(self.voltage**4, x=self.cosine))


def half_power_width_rad(cosine: Float[np.ndarray, " n"], power: Float[np.ndarray, " n"]) -> float:
    """Return the angle between the half-power directions on either side of the peak, whose power is 1."""
    peak = int(np.argmax(power))
    left = int(np.flatnonzero(power[:peak] < 0.5)[-1])
    right = peak + int(np.flatnonzero(power[peak:] < 0.5)[0])
    low = np.interp(0.5, power[[left, left + 1]], cosine[[left, left + 1]])
    high = np.interp(-0.5, -power[[right - 1, right]], cosine[[right - 1, right]])
    return float(np.arcsin(high) - np.arcsin(low))


@dataclass(frozen=True, eq=False)
class Antenna:
    """An antenna: separable, or with a pattern of its own for transmission and perhaps another for reception.

    azimuth: cut in the plane of boresight and left; elevation: in that of boresight and up. Their product is the
        pattern of an antenna without `transmit`; see `antenna_of` for the others.
    polarization: of the transmitted field on boresight: up (V), left (H), or right- or left-hand circular (RHCP, LHCP).
    receives: the same polarization ("co") or the orthogonal one ("cross"). For a circular wave, "co" is the same
        sense, each viewed along its own propagation, and a mirror returns the opposite one.
    axial_ratio_db: of a circular antenna's polarization ellipse, major axis along V; 0 for a circle.
    transmit, receive: patterns that are not the product of two cuts; without `receive` both are the same.
    efficiency: gain over directivity, each way.
    """

    azimuth: Cut
    elevation: Cut
    polarization: str = "V"
    receives: str = "co"
    axial_ratio_db: float = 0.0
    transmit: Pattern | None = None
    receive: Pattern | None = None
    efficiency: float = 1.0

    @cached_property
    def peak_gain(self) -> float:
        """Power gain at the peak, a ratio: 4 pi over the beam's solid angle.

        For different transmit and receive patterns: the geometric mean of both on boresight.
        """
        if self.transmit is not None and self.receive is None:
            return self.efficiency * self.transmit.directivity
        if self.transmit is not None:
            return float(self.gain(np.array([[1.0, 0.0, 0.0]]))[0])
        # Integral of A^2 E^2 cos over the half sphere; dOmega = du dv / cos cancels the aperture factor.
        u, v = self.azimuth.cosine, self.elevation.cosine
        along_v = cumulative_simpson(self.elevation.voltage**2, x=v, initial=0.0)
        reach = np.sqrt(np.maximum(1 - u**2, 0.0))
        inner = np.interp(reach, v, along_v) - np.interp(-reach, v, along_v)
        return self.efficiency * float(4 * np.pi / simpson(self.azimuth.voltage**2 * inner, x=u))

    def gain(self, direction: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return the power gain toward unit vectors in the antenna's frame: its square is the two-way gain.

        For different transmit and receive patterns: their geometric mean.
        """
        if self.receive is not None:
            return np.sqrt(self.transmit_gain(direction) * self.receive_gain(direction))
        if self.transmit is not None:
            return self.transmit_gain(direction)
        cos, u, v = direction.T
        return self.peak_gain * (self.azimuth.at(u) * self.elevation.at(v)) ** 2 * np.maximum(cos, 0.0)

    def transmit_gain(self, direction: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return the power gain in transmission toward unit vectors in the antenna's frame."""
        return self.gain(direction) if self.transmit is None else self.efficiency * gain_of(self.transmit, direction)

    def receive_gain(self, direction: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return the power gain in reception toward unit vectors in the antenna's frame."""
        if self.receive is None:
            return self.transmit_gain(direction)
        return self.efficiency * gain_of(self.receive, direction)

    @property
    def separable(self) -> bool:
        """Whether the pattern is the product of the two cuts."""
        return self.transmit is None

    @cached_property
    def two_way(self) -> TwoWayGrid:
        """The two-way power in front of the antenna."""
        face = np.eye(3) if self.transmit is None else self.transmit.R_face_antenna
        return two_way_grid(lambda direction: self.gain(direction) / self.peak_gain, self.step_rad, face)

    @property
    def step_rad(self) -> float:
        """Angle within which the gain hardly changes."""
        patterns = [pattern for pattern in (self.transmit, self.receive) if pattern is not None]
        return min(pattern.step_rad for pattern in patterns) if patterns else 0.1 * min(self.beamwidths_rad)

    @property
    def circular(self) -> bool:
        """Whether the wave is circular, whatever its axial ratio."""
        return self.polarization in ("RHCP", "LHCP")

    @cached_property
    def jones(self) -> tuple[Inexact[np.ndarray, "2"], Inexact[np.ndarray, "2"]]:
        """V and H components of the transmit and the receive field, both as if transmitting; time as exp(+j w t).

        The received part of a field e is its product with the second one, without conjugation (reciprocity).
        With V up and H left, the field rotates to the right if H leads V by a quarter cycle. The two ports of
        an antenna of axial ratio r are orthogonal: (r, j) and (1, -j r) over sqrt(r^2 + 1).
        """
        if not self.circular:
            ports = [np.array([1.0, 0.0]), np.array([0.0, 1.0])]
            port = ports.pop("VH".index(self.polarization))
            return port, port if self.receives == "co" else ports[0]
        ratio = 10 ** (self.axial_ratio_db / 20)
        hand = 1j if self.polarization == "RHCP" else -1j
        co, cross = np.array([ratio, hand]), np.array([1.0, -hand * ratio])
        norm = np.sqrt(ratio**2 + 1)
        return co / norm, (co if self.receives == "co" else cross) / norm

    @property
    def mirrored(self) -> complex:
        """Share of the field received from the echo of a sphere or a mirror.

        One for a linear co-polar antenna, zero for its cross-polar port. For a circular antenna of
        axial ratio r it is (r^2 - 1) / (r^2 + 1) in the same sense and 2 r / (r^2 + 1) in the opposite one; the first
        bounds its rain rejection (the integrated cancellation ratio).
        """
        transmitted, received = self.jones
        return complex(transmitted @ received)

    def fields(
        self, direction: Float[np.ndarray, "n 3"]
    ) -> tuple[Inexact[np.ndarray, "n 3"], Inexact[np.ndarray, "n 3"]]:
        """Return the transmit and the receive field toward unit vectors, all in the antenna's frame."""
        if not self.circular:
            transmitted, received = ("VH"[int(port[1])] for port in self.jones)
            return self.field(direction, transmitted), self.field(direction, received)
        axes = np.stack([self.field(direction, p) for p in "VH"])
        sent_field, received_field = (np.tensordot(port, axes, 1) for port in self.jones)
        return sent_field, received_field

    @staticmethod
    def field(direction: Float[np.ndarray, "n 3"], polarization: str) -> Float[np.ndarray, "n 3"]:
        """Return the unit electric field transmitted toward unit vectors, both in the antenna's frame.

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
        if not self.separable:
            azimuth, elevation = (half_power_width_rad(c.cosine, c.voltage**2) for c in (self.azimuth, self.elevation))
            return azimuth, elevation
        return self.azimuth.half_power_width_rad, self.elevation.half_power_width_rad


# Directions of a squinting beam over which its two-way power is averaged.
SQUINT_STEPS = 64


@dataclass(frozen=True, eq=False)
class Squint:
    """The turn of a beam about the antenna's up axis with frequency, as of a slotted waveguide.

    antenna: in the middle of the sweep.
    mean: the antenna whose two-way gain is the root mean square of that over the sweep.
    rad_per_hz: turn to the left as the frequency rises.
    """

    antenna: Antenna
    mean: Antenna
    rad_per_hz: float

    @classmethod
    def of(cls, antenna: Antenna, rad_per_hz: float, bandwidth_hz: float) -> "Squint":
        """Return the squint of a separable antenna over a bandwidth around its carrier."""
        u = antenna.azimuth.cosine
        ahead = np.column_stack([np.sqrt(1 - u**2), u, np.zeros(len(u))])[1:-1]
        offset_hz = bandwidth_hz * ((np.arange(SQUINT_STEPS) + 0.5) / SQUINT_STEPS - 0.5)
        squint = cls(antenna, antenna, rad_per_hz)
        power = np.mean([squint._turned_gain(ahead, offset) ** 2 for offset in offset_hz], axis=0)
        # The projected aperture is not part of a cut.
        voltage = np.pad(np.sqrt(np.sqrt(power) / antenna.peak_gain / ahead[:, 0]), 1)
        mean = replace(antenna, azimuth=Cut(voltage / voltage.max()), efficiency=1.0)
        gain = antenna.peak_gain * float(voltage.max()) ** 2
        return replace(squint, mean=replace(mean, efficiency=gain / mean.peak_gain))

    def two_way_ratio(self, direction: Float[np.ndarray, "n 3"], offset_hz: float) -> Float[np.ndarray, " n"]:
        """Return the two-way amplitude at an offset from the carrier over that of `mean`, toward unit vectors."""
        mean = self.mean.gain(direction)
        return np.divide(self._turned_gain(direction, offset_hz), mean, out=np.zeros(len(mean)), where=mean > 0)

    def _turned_gain(self, direction: Float[np.ndarray, "n 3"], offset_hz: float) -> Float[np.ndarray, " n"]:
        sine, cosine = np.sin(self.rad_per_hz * offset_hz), np.cos(self.rad_per_hz * offset_hz)
        turn = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        return self.antenna.gain(direction @ turn.T)


def gain_of(pattern: Pattern, direction: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Return the directive gain of a pattern toward unit vectors in the antenna's frame."""
    return pattern.directivity * pattern.amplitude(direction) ** 2


def antenna_of(
    transmit: Pattern,
    receive: Pattern | None = None,
    *,
    polarization: str = "V",
    receives: str = "co",
    axial_ratio_db: float = 0.0,
    efficiency: float = 1.0,
) -> Antenna:
    """Return an antenna of any pattern; its cuts have the fourth root of its two-way gain as voltage.

    Parameters
    ----------
    transmit, receive:
        The patterns; without `receive` both are the same.
    polarization, receives, axial_ratio_db, efficiency:
        See `Antenna`.

    Returns
    -------
    The antenna.

    Examples
    --------
    >>> import numpy as np
    >>> from sionna_radar.radar import SphericalPattern, antenna_of
    >>> horn = SphericalPattern.of(lambda d: np.maximum(d[:, 0], 0) ** 50, step_rad=np.deg2rad(1.0))
    >>> round(float(10 * np.log10(antenna_of(horn).peak_gain)), 1)  # 2 (2 n + 1), n = 50
    23.1
    """
    step = min(p.step_rad for p in (transmit, receive) if p is not None)
    samples = 2 * int(np.clip(np.ceil(8 / step), 500, MAX_CUT_SAMPLES)) + 1
    cosine = np.linspace(-1.0, 1.0, samples)
    ahead, zeros = np.sqrt(1 - cosine**2), np.zeros(samples)
    uncut = Antenna(
        Cut(zeros),
        Cut(zeros),
        polarization,
        receives,
        axial_ratio_db,
        transmit=transmit,
        receive=receive,
        efficiency=efficiency,
    )
    cuts = []
    for direction in ([ahead, cosine, zeros], [ahead, zeros, cosine]):
        power = uncut.gain(np.column_stack(direction))
        power[[0, -1]] = 0.0  # no radiation at or beyond 90 deg
        cuts.append(Cut(np.sqrt(power / power.max())))
    return replace(uncut, azimuth=cuts[0], elevation=cuts[1])


def measured_cut(angle_rad: Float[np.ndarray, " n"], power_db: Float[np.ndarray, " n"]) -> Cut:
    """Return a cut from measured power against the angle from boresight, in increasing order.

    Angles outside the measurement get the power of the nearest end.

    Parameters
    ----------
    angle_rad:
        Angles from boresight, increasing, rad.
    power_db:
        Power in dB; its peak counts as 0 dB.

    Returns
    -------
    The cut on equally spaced direction cosines.

    Raises
    ------
    ValueError
        The angles do not increase.
    """
    if np.any(np.diff(angle_rad) <= 0):
        raise ValueError("angle_rad must increase from sample to sample; sort the cut")
    finest = float(np.min(np.diff(angle_rad)))
    u = np.linspace(-1.0, 1.0, 2 * int(np.ceil(8 / finest)) + 1)
    level_db = np.interp(np.arcsin(u), angle_rad, power_db - np.max(power_db))
    return Cut(10 ** (level_db / 20))


# Half of the one-way power: inside the usual half-power beam.
LIT: Final = 0.25
# Echoes aliasing in from farther out are 20 dB down, less than the side lobes of a focused point.
FOLDING: Final = 1e-2
# 0.3 % of an echo's power is farther out than 30 dB down, less than its speckle reveals.
FOLLOWED: Final = 1e-3


def lobe_samples(cut: Cut, level: float) -> slice:
    """Return the samples of a cut around its peak with at least a given level of the peak's two-way power."""
    power = cut.voltage**4
    peak = int(np.argmax(power))
    weak = np.flatnonzero(power < level * power[peak])
    left, right = weak[weak < peak], weak[weak > peak]
    return slice(int(left[-1]) + 1 if len(left) else 0, int(right[0]) if len(right) else len(power))


def two_way_spread(antenna: Antenna) -> tuple[float, float]:
    """Return the standard deviations of the two-way power over the direction cosines in azimuth and in elevation."""
    return _spread(antenna.azimuth), _spread(antenna.elevation)


def _spread(cut: Cut) -> float:
    lobe = lobe_samples(cut, FOLLOWED)
    power, cosine = cut.voltage[lobe] ** 4, cut.cosine[lobe]
    mean = power @ cosine / power.sum()
    return float(np.sqrt(power @ (cosine - mean) ** 2 / power.sum()))


def in_main_lobe(antenna: Antenna, direction: Float[np.ndarray, "n 3"], level: float = LIT) -> Bool[np.ndarray, " n"]:
    """Mark the unit vectors, in the antenna's frame, whose two-way gain relative to the peak is at least a level."""
    if not antenna.separable:
        return antenna.gain(direction) ** 2 >= level * antenna.peak_gain**2

    mask = np.empty(len(direction), dtype=np.bool_)
    cuts = (np.ascontiguousarray(cut.voltage, dtype=np.float64) for cut in (antenna.azimuth, antenna.elevation))
    within(np.ascontiguousarray(direction, dtype=np.float64), *cuts, float(level), mask)
    return mask


def reach_of_power(antenna: Antenna, outside: float) -> tuple[float, float]:
    """Return half extents (left, up) in direction cosines that contain all but a fraction of the two-way power."""
    if not antenna.separable:
        return antenna.two_way.reach(outside)
    return _reach(antenna.azimuth, outside), _reach(antenna.elevation, outside)


def _reach(cut: Cut, tail_power: float) -> float:
    lower, upper = np.interp([tail_power / 2, 1 - tail_power / 2], cut.two_way_distribution, cut.cosine)
    return float(max(-lower, upper))


@compiled
@no_type_check
def voltage_at(voltage, cosine):
    """Return a `Cut` at a direction cosine."""
    position = (min(max(cosine, -1.0), 1.0) + 1.0) * ((len(voltage) - 1) / 2)
    lower = min(int(position), len(voltage) - 2)
    weight = position - lower
    return voltage[lower] * (1 - weight) + voltage[lower + 1] * weight


@compiled
@no_type_check
def within(direction, azimuth, elevation, level, inside):
    """Mark the unit vectors at which the two-way power, relative to the peak, is at least a level."""
    for n in range(len(direction)):
        voltage = voltage_at(azimuth, direction[n, 1]) * voltage_at(elevation, direction[n, 2])
        gain = voltage * voltage * max(direction[n, 0], 0.0)
        inside[n] = gain * gain >= level
