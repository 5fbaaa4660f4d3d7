"""Volume echo of rain, snow, fog and dust: in each pulse one random tone for each range cell of the beat spectrum.

Particles move independently, so the echo in a cell is complex Gaussian (power exponential about its mean, phase
uniform), and new in each pulse: between two chirps drops move by many wavelengths. In a mixture of kinds, a tone has
the power of all and moves as one of them, drawn with their echo power as weight. Its range rate is that of the
platform along the boresight, plus the fall of a particle drawn with the echo of each size as weight, plus the wind,
which carries particles of all sizes alike. The propagation loss is applied with that of all other paths
(`atmosphere`).

The beats of a pulse's tones are a comb with a tooth for every range cell, from a random first one, and a tone's range
is what the Doppler shift of its fall leaves of its beat. So the mean power through any window is that of a continuous
volume, whatever the first tooth: by Poisson's summation formula the sum of |W(f - k / T)|^2 over all k is constant, as
the autocorrelation of a window of length T is zero from T on. Tones uniform in range with shifts of their own
crowd in some cells and miss others, whose power is then not exponential: with shifts of many cells (1 m/s in
a chirp of 10 ms: five), thresholds for 1e-6 would be exceeded 100 times as often. The comb is that of one sweep; on
the second sweep of a triangle shifts have the other sign, and tones crowd.

The volume fills the beam up to the ground. A pencil beam meets the ground over a span of ranges, wide at grazing
incidence, split at the edge of a roof; the part of the beam that is still in the air at a range is the share of
|gain|^2 r^2 returned by the surfaces beyond it. That is the share of the two-way beam where sigma0 / cos t is
constant over the footprint (constant gamma, one material), and close to it elsewhere. A pulse that meets no
surface sees the volume up to the last sampled range.

Close to the antenna the beam is as wide as the aperture, and the echo falls as (r^2 + r_n^2)^-1 (`near_field_m`).

The polarization of the echo of rain and snow determines the share of it that the antenna's receive port accepts.
"""

import dataclasses
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.foundation.randomness import Stream, pulse_generator, pulse_uniforms
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.radar.equation import near_field_m, two_way_beam_sr
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.paths import VOLUME, Paths
from sionna_radar.weather.conditions import Volume, Weather
from sionna_radar.weather.drops import DropPolarization, drop_polarization, marshall_palmer, snow_polarization, spheres
from sionna_radar.weather.path import rain_clutter_power

# Ranges where less of the beam than this (side lobes) is in the air get no tone.
MIN_BEAM_FRACTION = 1e-3


# Tones that each one of a wide beam becomes.
TONES_IN_BEAM = 24


def spread_over_beam(paths: Paths, pulses: Pulses, antenna: Antenna, caster: RayCaster, seed: int) -> Paths:
    """Return paths with the tones of the volume spread over the beam, for receivers that resolve directions.

    Each becomes some of random phases, in directions drawn from the two-way power, as far as the ground leaves the air
    there; together they have its power.
    """
    rain = np.flatnonzero(paths.surface == VOLUME)
    if not len(rain):
        return paths
    grid = antenna.two_way
    below = np.cumsum(grid.power_sr.ravel())
    row, pose = pulses.row_of(paths.pulse[rain]), pulses.true
    parts, numbers = [paths.rows(np.flatnonzero(paths.surface != VOLUME))], np.arange(TONES_IN_BEAM)
    for pulse_row in np.unique(row):
        tones = paths.rows(rain[row == pulse_row])
        generator = pulse_generator(seed, Stream.VOLUME_DIRECTIONS, int(pulses.index[pulse_row]))
        drawn = np.searchsorted(below, generator.random((len(tones), TONES_IN_BEAM)) * below[-1])
        toward = grid.direction[np.minimum(drawn, len(below) - 1)] @ pose.R_world_antenna[pulse_row].T
        range_m = tones.delay_s * (speed_of_light / 2)
        place = pose.position_m[pulse_row] + range_m[:, None, None] * toward
        seen = caster.visible(np.broadcast_to(pose.position_m[pulse_row], (place.size // 3, 3)), place.reshape(-1, 3))
        seen = seen.reshape(len(tones), TONES_IN_BEAM)
        tone, number = np.nonzero(seen)
        phase = np.exp(2j * np.pi * generator.random((len(tones), len(numbers)))[tone, number])
        away = toward[tone, number]
        # Drops fall: their own range rate grows with the cosine of the ray from the vertical.
        drift = (tones.range_rate_mps - pose.boresight_range_rate_mps[pulse_row])[tone]
        drift = drift * away[:, 2] / min(float(pose.boresight[pulse_row, 2]), -0.1)
        parts.append(
            replace(
                tones.rows(tone),
                gain=tones.gain[tone] * phase / np.sqrt(seen.sum(axis=1)[tone]),
                hit_m=place[tone, number],
                range_rate_mps=drift - away @ pose.velocity_mps[pulse_row],
            )
        )
    return Paths.concatenate(parts)


class VolumeEcho:
    """The volume in the beam of one antenna.

    wind_mps: toward east, north and up. Non-uniform rain drifts with it, unchanged.
    cell_m: width of a range cell.
    cell_power: mean received over transmitted power of each cell, filled at the volume's reference
        reflectivity, without propagation loss.
    """

    def __init__(
        self,
        volume: Volume,
        antenna: Antenna,
        chirp: Chirp,
        seed: int,
        wind_mps: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        self.cell_m = chirp.range_resolution_m
        cells = int(np.ceil(chirp.max_range_m / self.cell_m))
        self.cell_power = _cell_power(volume.reflectivity_per_m, antenna, chirp, self.cell_m, cells)
        self._volume, self._chirp, self._wind_mps, self._seed = volume, chirp, np.array(wind_mps), seed

    def trace(self, pulses: Pulses, surfaces: Paths) -> Paths:
        """Return the tones of a block of pulses, sorted by pulse.

        surfaces: the diffuse paths of the block, which end the volume; mirror paths would be weighted too strongly.

        A particle has the fall speed of those at the range of its beat: rain varies little over the shift.
        """
        pose, cells = pulses.true, len(self.cell_power)
        first, drawn = np.split(pulse_uniforms(self._seed, Stream.VOLUME, pulses.index, 1 + 3 * cells), [1], axis=1)
        level, turn, size = drawn.reshape(len(pulses), 3, cells).swapaxes(0, 1)
        boresight = np.repeat(pose.boresight, cells, axis=0)
        beat_m = (np.arange(cells) + first) * self.cell_m
        fall_mps = -boresight[:, 2] * self._volume.fall_mps(self._origin_m(pulses, beat_m), size.ravel())
        # Echoes from beyond the last cell take the teeth that fall leaves empty before the first.
        range_m = (beat_m - self._chirp.doppler_range_m(fall_mps).reshape(beat_m.shape)) % (cells * self.cell_m)
        cell = np.minimum((range_m / self.cell_m).astype(np.int64), cells - 1)
        in_air = np.take_along_axis(self._in_air(pulses, surfaces), cell, axis=1)
        relative = self._volume.relative(self._origin_m(pulses, range_m)).reshape(cell.shape)
        power = self.cell_power[cell] * in_air * -np.log1p(-level) * relative
        heard = in_air > MIN_BEAM_FRACTION
        row = np.nonzero(heard)[0]
        return Paths.along_boresight(
            pulses,
            row,
            range_m[heard],
            drift_mps=fall_mps[heard.ravel()] + pose.boresight[row] @ self._wind_mps,
            gain=np.sqrt(power[heard]) * np.exp(2j * np.pi * turn[heard]),
            incidence_rad=np.full(len(row), np.nan),
            surface=np.full(len(row), VOLUME),
        )

    def _origin_m(self, pulses: Pulses, range_m: Float[np.ndarray, "pulse tone"]) -> Float[np.ndarray, "pulse*tone 2"]:
        """Return the positions at time zero of the air at ranges along the boresights."""
        pose = pulses.true
        place_m = pose.position_m[:, None, :2] + range_m[:, :, None] * pose.boresight[:, None, :2]
        return (place_m - pulses.time_s[:, None, None] * self._wind_mps[:2]).reshape(-1, 2)

    def _in_air(self, pulses: Pulses, surfaces: Paths) -> Float[np.ndarray, "pulse cell"]:
        """Return the fraction of each pulse's two-way beam that has met no surface before each cell's centre."""
        cells = len(self.cell_power)
        ground = surfaces.surface >= 0
        range_m = surfaces.delay_s[ground] * (speed_of_light / 2)
        weight = np.abs(surfaces.gain[ground].astype(np.complex128)) ** 2 * range_m**2
        row = pulses.row_of(surfaces.pulse[ground])
        cell = np.minimum((range_m / self.cell_m).astype(np.int64), cells)  # the last one: beyond all cells
        inside = np.bincount(row * (cells + 1) + cell, weight, minlength=len(pulses) * (cells + 1))
        inside = inside.reshape(len(pulses), cells + 1)
        total = inside.sum(axis=1, keepdims=True)
        met = np.cumsum(inside, axis=1) - inside / 2
        return np.where(total > 0, 1 - met[:, :-1] / np.where(total > 0, total, 1.0), 1.0)


def _cell_power(
    reflectivity_per_m: float, antenna: Antenna, chirp: Chirp, cell_m: float, cells: int
) -> Float[np.ndarray, " {cells}"]:
    beam_sr = two_way_beam_sr(antenna)
    edge_m, near_m = cell_m * np.arange(cells + 1), near_field_m(antenna, chirp.wavelength_m)
    far = rain_clutter_power(
        edge_m[-2:],
        reflectivity_per_m=reflectivity_per_m,
        two_way_beam_sr=beam_sr,
        peak_gain=antenna.peak_gain,
        wavelength_m=chirp.wavelength_m,
        specific_attenuation_db_per_km=0.0,
    )
    # Of a cell the far field has the integral of r^-2, 1 / r1 - 1 / r2.
    return far / np.diff(-1 / edge_m[-2:]) * np.diff(np.arctan(edge_m / near_m)) / near_m


# Rain given by a map only: the rate hardly affects the received fraction.
TYPICAL_RATE_MM_PER_H = 10.0


class VolumePolarization:
    """The volume echo as received at the ports of an antenna; kinds of particles are combined."""

    def __init__(self, weather: Weather, antenna: Antenna) -> None:
        self._moments = _moments(weather)
        self._antenna = antenna

    def received(self, echo: Paths, pulses: Pulses) -> Paths:
        """Return the echo, given for a linear co-polar antenna, as received by this one."""
        fraction = self.received_fraction(pulses.true)[pulses.row_of(echo.pulse)]
        return dataclasses.replace(echo, gain=echo.gain * np.sqrt(fraction))

    def received_fraction(self, pose: Pose) -> Float[np.ndarray, " pulse"]:
        """Return the power received from boresight relative to that of a linear co-polar antenna."""
        ahead = pose.boresight
        across = np.stack([-ahead[:, 1], ahead[:, 0], np.zeros(len(ahead))], axis=1)
        size = np.linalg.norm(across, axis=1, keepdims=True)
        # Straight down any horizontal axis will do.
        across = np.where(size > 1e-9, across / np.maximum(size, 1e-9), np.array([1.0, 0.0, 0.0]))
        within = np.cross(ahead, across)
        antenna_axes = pose.R_world_antenna[:, :, [2, 1]]  # axes of V and H
        to_drops = np.stack([np.einsum("ni,nij->nj", axis, antenna_axes) for axis in (within, across)], axis=1)
        transmitted, received = (to_drops @ port for port in self._antenna.jones)
        return self._moments.power(np.arccos(np.clip(ahead[:, 2], -1.0, 1.0)), transmitted, received)


def _moments(weather: Weather) -> DropPolarization:
    """Return the moments of all kinds, weighted by their reflectivity; droplets and dust are spheres."""
    kinds = []
    if weather.rains:
        rate = weather.rain_rate_mm_per_h or TYPICAL_RATE_MM_PER_H
        drops = drop_polarization(weather.carrier_hz, marshall_palmer(rate), weather.temperature_k)
        kinds.append((weather.rain_echo(rate)[0], drops))
    hydrometeors = [snow_polarization(kind) for kind in weather.snowfall_mm_per_h]
    still = weather.static_echoes
    hydrometeors += [spheres()] * (len(still) - len(hydrometeors))
    kinds += [(level, moments) for (level, _), moments in zip(still, hydrometeors, strict=True)]
    weight = np.array([level for level, _ in kinds])
    weight /= weight.sum()
    return DropPolarization(
        angle_rad=kinds[0][1].angle_rad,
        mean=weight @ np.stack([moments.mean for _, moments in kinds]),
        upright=weight @ np.stack([moments.upright for _, moments in kinds]),
        slanted=weight @ np.stack([moments.slanted for _, moments in kinds]),
    )


def volume_polarization(weather: Weather, antenna: Antenna) -> VolumePolarization | None:
    """Return None for a linear co-polar antenna, for which the reflectivity is defined."""
    if not antenna.circular and antenna.receives == "co":
        return None
    return VolumePolarization(weather, antenna)
