"""Time-of-flight lidar: range of the first or last return, through weather.

Returns are expressed as the reflectivity of an equally strong Lambertian target, normal to and filling the beam, after
the two-way loss (extinction a):

    ground   reflectivity * cos(incidence) * exp(-2 a r)
    volume   pi b L exp(-2 a r),  b the backscatter, L = (1 - exp(-2 a l)) / (2 a) the length illuminated by a pulse,
             l = c t / 2 its length
    drop     pi s / A(r) * exp(-2 a r),  s its backscatter, A the beam's cross-section

A return must exceed the threshold max(minimum, 10 % (r / clear range)^2): the receiver noise, equal to a
10 % target at its clear range, and the weakest reported target. Its range is that of its near edge, without error.
The first return is the volume at the near range if it exceeds the threshold there; otherwise the nearest drop that
does before the ground; otherwise the ground. The last return is the ground if detected, otherwise the return before it.

Drops are random in the beam (Poisson, Marshall-Palmer) and detected singly. Neglected: the sum of several drops within
a pulse, the mean echo of the many small ones, which at 50 mm/h equals a target of 0.004 %, multiple scattering, which
returns some of a fog's light to the field of view, speckle, and range errors by detector noise.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.randomness import Stream, pulse_uniforms
from sionna_radar.tracing.paths import VOLUME, Paths
from sionna_radar.weather.optical import OpticalAir, drop_backscatter_m2_per_sr

# Reflectivity of the target for which `clear_range_m` is given.
CLEAR_REFLECTIVITY = 0.1
# Drop diameters, and number of range steps, both logarithmically spaced.
DROPS_M = np.geomspace(0.1e-3, 8e-3, 200)
STEPS = 200


@dataclass(frozen=True, kw_only=True)
class LidarReceiver:
    """A lidar receiver in a given atmosphere.

    returns: which of several returns is reported.
    ground_reflectivity, least_reflectivity: of the ground, and of the weakest target that is reported.
    clear_range_m, near_range_m: range of a 10 % target in clear air, and the nearest range.
    pulse_ns, aperture_mm, divergence_mrad: length of the pulse, width of the beam at the lidar, and its divergence.
    reflectivity: of each surface of the scene; None for the ground's reflectivity everywhere.
    """

    returns: Literal["first", "last"]
    ground_reflectivity: float
    least_reflectivity: float
    clear_range_m: float
    near_range_m: float
    pulse_ns: float
    aperture_mm: float
    divergence_mrad: float
    air: OpticalAir
    seed: int
    reflectivity: Float[np.ndarray, " surface"] | None = None

    def received(self, paths: Paths, pulses: Pulses) -> Paths:
        """Return the paths along the beam axes as measured by the lidar; a pulse without a return has none.

        A pulse without a path, which meets no ground, may still have a return from the air.
        """
        ground_m = np.full(len(pulses), np.inf)
        cosine = np.zeros(len(pulses))
        row = pulses.row_of(paths.pulse)
        ground_m[row] = paths.delay_s * (speed_of_light / 2)
        cosine[row] = np.cos(paths.incidence_rad)
        reflectivity = np.full(len(pulses), self.ground_reflectivity)
        if self.reflectivity is not None:
            reflectivity[row] = self.reflectivity[paths.surface]
        ground_seen = self.detects_ground(ground_m, cosine, reflectivity)
        air_m = self.nearest_in_air_m(pulses)
        # Ground occludes particles behind it.
        in_air = air_m < ground_m
        air_return = in_air if self.returns == "first" else in_air & ~ground_seen
        range_m = np.where(air_return, air_m, ground_m)
        detected = air_return | ground_seen
        surface = np.full(len(pulses), VOLUME)
        surface[row] = paths.surface
        incidence = np.full(len(pulses), np.nan)
        incidence[row] = paths.incidence_rad
        return Paths.along_boresight(
            pulses,
            np.flatnonzero(detected),
            range_m[detected],
            gain=np.ones(int(detected.sum()), dtype=np.complex128),
            incidence_rad=np.where(air_return, np.nan, incidence)[detected],
            surface=np.where(air_return, VOLUME, surface)[detected],
        )

    def threshold(self, range_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the reflectivity that a return must exceed at given ranges."""
        return np.maximum(self.least_reflectivity, CLEAR_REFLECTIVITY * (range_m / self.clear_range_m) ** 2)

    def left(self, range_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the two-way transmittance of the air."""
        return np.exp(-2 * self.air.extinction_per_m * range_m)

    def detects_ground(
        self,
        range_m: Float[np.ndarray, " n"],
        cosine: Float[np.ndarray, " n"],
        reflectivity: Float[np.ndarray, " n"] | float | None = None,
    ) -> Bool[np.ndarray, " n"]:
        """Return the mask of ranges with detected ground, by default of `ground_reflectivity`; False at infinity."""
        reflectivity = self.ground_reflectivity if reflectivity is None else reflectivity
        echo = reflectivity * cosine * self.left(range_m)
        far_enough = np.isfinite(range_m) & (range_m >= self.near_range_m)
        return far_enough & (echo >= self.threshold(np.where(far_enough, range_m, 0.0)))

    @cached_property
    def volume_reflectivity(self) -> float:
        """Equivalent reflectivity of the volume, before propagation loss."""
        lit_m = speed_of_light * self.pulse_ns * 1e-9 / 2
        loss = 2 * self.air.extinction_per_m * lit_m
        return float(np.pi * self.air.backscatter_per_m_sr * lit_m * (-np.expm1(-loss) / loss if loss > 0 else 1.0))

    def nearest_in_air_m(self, pulses: Pulses) -> Float[np.ndarray, " pulse"]:
        """Return the range of each pulse's first return from the air, infinite without one."""
        near_m = np.array([self.near_range_m])
        if (self.volume_reflectivity * self.left(near_m) >= self.threshold(near_m))[0]:
            return np.full(len(pulses), near_m[0])
        if self.air.drops is None:
            return np.full(len(pulses), np.inf)
        uniform = pulse_uniforms(self.seed, Stream.LIDAR_DROPS, pulses.index, 1)[:, 0]
        range_m, expected = self.detectable_drops
        # The nearest point of a Poisson process: the range up to which the expected number is an exponential draw.
        exponential = -np.log1p(-uniform)
        return np.where(exponential < expected[-1], np.interp(exponential, expected, range_m), np.inf)

    @cached_property
    def detectable_drops(self) -> tuple[Float[np.ndarray, " range"], Float[np.ndarray, " range"]]:
        """Ranges, and the expected number of drops above the threshold in the beam up to each."""
        assert self.air.drops is not None
        near_m = self.near_range_m
        range_m = np.geomspace(near_m, max(self.clear_range_m, 2 * near_m), STEPS)
        width_m = 1e-3 * (self.aperture_mm + self.divergence_mrad * range_m)
        area_m2 = np.pi / 4 * width_m**2
        backscatter = drop_backscatter_m2_per_sr(DROPS_M, self.air.wavelength_nm)
        echo = np.pi * backscatter / area_m2[:, None] * self.left(range_m)[:, None]
        detectable = echo >= self.threshold(range_m)[:, None]
        per_m = area_m2 * np.trapezoid(detectable * self.air.drops.density_per_m4(DROPS_M), DROPS_M, axis=1)
        steps = (per_m[1:] + per_m[:-1]) / 2 * np.diff(range_m)
        return range_m, np.concatenate([[0.0], np.cumsum(steps)])
