"""What a time-of-flight lidar makes of the air and the ground along one beam: which range a pulse of light reads.

All is told as the reflectivity of a Lambertian target at right angles that fills the beam and returns as much, after
the loss on the way (extinction a, both ways):

    ground   reflectivity * cos(incidence) * exp(-2 a r)
    volume   pi b L exp(-2 a r),  b the backscatter, L = (1 - exp(-2 a l)) / (2 a) what a pulse lights of it at a time,
             l = c t / 2 its length
    drop     pi s / A(r) * exp(-2 a r),  s its backscatter, A the beam's cross-section

A return is what exceeds the threshold max(least, 10 % (r / clear range)^2): the receiver's noise, which is that of a
10 % target at its clear range, and the least target that is reported. It is read at its near edge, exactly.
The first return is the volume at the near range where it exceeds the threshold there; else the nearest drop that does
before the ground; else the ground. The last return is the ground where it is heard, else what is heard before it.

Drops lie in the beam by chance (Poisson, Marshall-Palmer), each alone; that several share a pulse and add up is left
out, as is the mean echo of the many small ones, which at 50 mm/h is that of a target of 0.004 %. So are multiple
scattering, which brings some of a fog's light back into the field of view, speckle, and the detector's noise itself.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.randomness import Stream, pulse_uniforms
from sionna_radar.scenario.lidar import LidarTable
from sionna_radar.scenario.weather import WeatherTable
from sionna_radar.tracing.paths import VOLUME, Paths
from sionna_radar.weather.kinds import Precipitation
from sionna_radar.weather.optical import OpticalAir, drop_backscatter_m2_per_sr, optical_air

# Of the target that `clear_range_m` is told of.
CLEAR_REFLECTIVITY = 0.1
# Diameters at which drops are counted, and steps of range, both even in the logarithm.
DROPS_M = np.geomspace(0.1e-3, 8e-3, 200)
STEPS = 200


@dataclass(frozen=True, kw_only=True)
class LidarReceiver:
    """A lidar in its air."""

    table: LidarTable
    air: OpticalAir
    seed: int

    def received(self, paths: Paths, pulses: Pulses) -> Paths:
        """Return the paths along the beam axes as the lidar reads them; a pulse that hears nothing has none.

        A pulse without a path, which meets no ground, may yet hear the air.
        """
        ground_m = np.full(len(pulses), np.inf)
        cosine = np.zeros(len(pulses))
        row = pulses.row_of(paths.pulse)
        ground_m[row] = paths.delay_s * (speed_of_light / 2)
        cosine[row] = np.cos(paths.incidence_rad)
        heard = self.hears_ground(ground_m, cosine)
        before_m = self.nearest_in_air_m(pulses)
        # What hangs or falls behind the ground is not seen.
        in_air = before_m < ground_m
        read_air = in_air if self.table.returns == "first" else in_air & ~heard
        range_m = np.where(read_air, before_m, ground_m)
        read = read_air | heard
        surface = np.full(len(pulses), VOLUME)
        surface[row] = paths.surface
        incidence = np.full(len(pulses), np.nan)
        incidence[row] = paths.incidence_rad
        return Paths.along_boresight(
            pulses,
            np.flatnonzero(read),
            range_m[read],
            gain=np.ones(int(read.sum()), dtype=np.complex128),
            incidence_rad=np.where(read_air, np.nan, incidence)[read],
            surface=np.where(read_air, VOLUME, surface)[read],
        )

    def threshold(self, range_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the reflectivity that a return must exceed at ranges."""
        return np.maximum(self.table.least_reflectivity, CLEAR_REFLECTIVITY * (range_m / self.table.clear_range_m) ** 2)

    def left(self, range_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return what the air leaves of an echo."""
        return np.exp(-2 * self.air.extinction_per_m * range_m)

    def hears_ground(self, range_m: Float[np.ndarray, " n"], cosine: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """Tell at which ranges ground is heard; at infinity there is none."""
        echo = self.table.ground_reflectivity * cosine * self.left(range_m)
        far_enough = np.isfinite(range_m) & (range_m >= self.table.near_range_m)
        return far_enough & (echo >= self.threshold(np.where(far_enough, range_m, 0.0)))

    @cached_property
    def volume_reflectivity(self) -> float:
        """Reflectivity that the volume returns as, before the loss on the way to it."""
        lit_m = speed_of_light * self.table.pulse_ns * 1e-9 / 2
        loss = 2 * self.air.extinction_per_m * lit_m
        return float(np.pi * self.air.backscatter_per_m_sr * lit_m * (-np.expm1(-loss) / loss if loss > 0 else 1.0))

    def nearest_in_air_m(self, pulses: Pulses) -> Float[np.ndarray, " pulse"]:
        """Return where each pulse first hears the air, infinite where it does not."""
        near = np.array([self.table.near_range_m])
        if (self.volume_reflectivity * self.left(near) >= self.threshold(near))[0]:
            return np.full(len(pulses), near[0])
        if self.air.drops is None:
            return np.full(len(pulses), np.inf)
        drawn = pulse_uniforms(self.seed, Stream.LIDAR_DROPS, pulses.index, 1)[:, 0]
        range_m, expected = self.drops_heard
        # The nearest of Poisson places: the range up to which the expected number is an exponential draw.
        wanted = -np.log1p(-drawn)
        return np.where(wanted < expected[-1], np.interp(wanted, expected, range_m), np.inf)

    @cached_property
    def drops_heard(self) -> tuple[Float[np.ndarray, " range"], Float[np.ndarray, " range"]]:
        """Ranges, and the expected number of drops in the beam up to each that exceed the threshold."""
        assert self.air.drops is not None
        near_m = self.table.near_range_m
        range_m = np.geomspace(near_m, max(self.table.clear_range_m, 2 * near_m), STEPS)
        width_m = 1e-3 * (self.table.aperture_mm + self.table.divergence_mrad * range_m)
        area_m2 = np.pi / 4 * width_m**2
        back = drop_backscatter_m2_per_sr(DROPS_M, self.air.wavelength_nm)
        echo = np.pi * back / area_m2[:, None] * self.left(range_m)[:, None]
        heard = echo >= self.threshold(range_m)[:, None]
        per_m = area_m2 * np.trapezoid(heard * self.air.drops.density_per_m4(DROPS_M), DROPS_M, axis=1)
        steps = (per_m[1:] + per_m[:-1]) / 2 * np.diff(range_m)
        return range_m, np.concatenate([[0.0], np.cumsum(steps)])


def lidar_receiver(table: LidarTable, weather: WeatherTable, seed: int) -> LidarReceiver | None:
    """Return the receiver of a scenario; None for a lidar that sees through everything."""
    if table.wavelength_nm is None:
        return None
    air = optical_air(
        float(table.wavelength_nm),
        rain_rate_mm_per_h=weather.rain_rate_mm_per_h,
        snowfall_mm_per_h={k: r for k, r in weather.precipitation_mm_per_h.items() if k is not Precipitation.RAIN},
        visibility_m=weather.visibility_m,
    )
    return LidarReceiver(table=table, air=air, seed=seed)
