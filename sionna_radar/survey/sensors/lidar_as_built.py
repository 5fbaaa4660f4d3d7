"""The lidar as built: rays over the diverging beam, plants, air and sunlight in its way, and the returns it detects.

Each ray carries an equal share of a Gaussian beam. One that passes plants meets a leaf by the law of Beer and Lambert,
at the optical depth of an exponential draw, or else the ground; light returns by the way it came, so that the way back
costs no more. Leaves are Lambertian and face all directions alike (`surfaces.foliage`): the cosine c of one that a ray
meets is distributed as 2 c. Leaves are small against the beam; those of neighbouring rays are independent.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.special import xlog1py

from sionna_radar.detection.echoes import Echoes
from sionna_radar.flight.frames import MIN_GRAZING_SINE
from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.randomness import Stream, pulse_generators, pulse_uniforms
from sionna_radar.foundation.stopwatch import timed
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.scene.vegetation import PlantCover
from sionna_radar.signal.build import surface_reflectivities, waveform_receiver
from sionna_radar.signal.lidar_waveform import MOST_RETURNS, WaveformReceiver
from sionna_radar.survey.sensors.sensor import Observation, SensorInputs
from sionna_radar.survey.sensors.sweeps import ChirpRecord
from sionna_radar.tracing.effects.canopy import follow_rays
from sionna_radar.tracing.paths import TARGET, VEGETATION, VOLUME, Paths, trace_boresights

# Kinds of scatterers of a waveform, by their order in it.
GROUND, LEAVES, AIR = 0, 1, 2
SURFACES = np.array([TARGET, VEGETATION, VOLUME])
# Samples of waveforms, and rays, held at once.
MOST_AT_ONCE = 2_000_000
GOLDEN_RAD = float(np.pi * (3 - np.sqrt(5)))


def beam_offsets(
    divergence_rad: tuple[float, float], rays: int, turn_rad: Float[np.ndarray, " pulse"]
) -> Float[np.ndarray, "pulse ray 2"]:
    """Return the angles of rays of equal power from the axis of a Gaussian beam, to the left and up.

    The intensity falls to 1 / e^2 at half of the divergence w: u = 8 (angle / w)^2 is an exponential variate. Ray k has
    the mean of its k-th quantile, at k golden angles and a turn of each pulse: a spiral of equal density in the power.
    """
    edge = np.linspace(0.0, 1.0, rays + 1)
    radius = np.sqrt(rays * np.diff(edge + xlog1py(1 - edge, -edge)) / 8)
    angle = turn_rad[:, None] + GOLDEN_RAD * np.arange(rays)
    return np.stack([np.cos(angle), np.sin(angle)], axis=2) * radius[:, None] * np.array(divergence_rad)


@dataclass(frozen=True, kw_only=True)
class BeamHits(Columns):
    """Rays that strike a surface or a leaf.

    row: pulse within its block; kind: `GROUND` or `LEAVES`.
    reflectivity: Lambertian; cosine: of the incidence.
    """

    row: Int[np.ndarray, " ray"]
    range_m: Float[np.ndarray, " ray"]
    reflectivity: Float[np.ndarray, " ray"]
    cosine: Float[np.ndarray, " ray"]
    kind: Int[np.ndarray, " ray"]


class LaserRanger:
    """What lidars have in common."""

    def correct(self, echoes: Echoes, pulse: Int[np.ndarray, " pulse"], measured: Pose) -> Echoes:
        """Return the echoes unchanged: the Doppler shift of a laser range is negligible."""
        return echoes

    def record_chirp(self, pulses: Pulses) -> ChirpRecord | None:
        """Return None: a lidar has no chirps."""
        return None


class LidarAsBuilt(LaserRanger):
    """A waveform lidar.

    rays: number over the beam. reflectivity: of each surface. range_noise_m: beside that of the signal.
    leaf_reflectivity: of the leaves of `plants`.
    """

    def __init__(
        self,
        caster: RayCaster,
        receiver: WaveformReceiver,
        reflectivity: Float[np.ndarray, " surface"],
        *,
        rays: int,
        seed: int,
        range_noise_m: float = 0.0,
        plants: PlantCover | None = None,
        leaf_reflectivity: float = 0.0,
    ) -> None:
        self._caster, self.receiver, self._reflectivity, self._rays = caster, receiver, reflectivity, rays
        self._seed, self._range_noise_m = seed, range_noise_m
        self._plants, self._leaf_reflectivity = plants, leaf_reflectivity

    def observe(self, pulses: Pulses) -> Observation:
        """Return the returns of a block of pulses: power at the peak in W, SNR of amplitudes."""
        at_once = max(1, MOST_AT_ONCE // max(self.receiver.samples, self._rays))
        starts = range(0, len(pulses), at_once)
        pieces = [self._observe(pulses.rows(slice(start, start + at_once))) for start in starts]
        return Observation(
            paths=Paths.concatenate([piece.paths for piece in pieces]),
            echoes=Echoes.concatenate([piece.echoes for piece in pieces]),
        )

    def _observe(self, pulses: Pulses) -> Observation:
        receiver, count = self.receiver, len(pulses)
        with timed("trace"):
            axis = trace_boresights(pulses, self._caster)
            hits = self.trace(pulses)
        share = hits.reflectivity / self._rays
        echo = share * hits.cosine * receiver.white_echo(hits.range_m)
        solid = (np.where(hits.kind == kind, echo, 0.0) for kind in (GROUND, LEAVES))
        light = [receiver.waveforms(hits.row, hits.range_m, each, count) for each in solid]
        light.append(self._air(pulses, hits))
        noise, jitter = np.empty((count, receiver.samples)), np.empty((count, MOST_RETURNS))
        for row, generator in enumerate(pulse_generators(self._seed, Stream.LIDAR_NOISE, pulses.index)):
            generator.standard_normal(out=jitter[row])
            generator.standard_normal(out=noise[row])
        background = receiver.sunlight(np.bincount(hits.row, share, minlength=count))
        found = receiver.detect(np.stack(light), background, noise)
        number = np.arange(len(found)) - np.searchsorted(found.row, found.row)
        echoes = Echoes(
            pulse=pulses.index[found.row],
            number=number,
            range_m=found.range_m + self._range_noise_m * jitter[found.row, number],
            range_sigma_m=np.hypot(found.sigma_m, self._range_noise_m),
            power=found.photoelectrons * receiver.photon_j / (np.sqrt(2 * np.pi) * receiver.sample_s),
            echo_snr_db=20 * np.log10(found.snr),
        )
        # What the axis meets, and what else returns were of.
        other = found.rows(found.kind != GROUND)
        return Observation(
            paths=Paths.concatenate(
                [
                    axis,
                    Paths.along_boresight(
                        pulses,
                        other.row,
                        other.range_m,
                        gain=np.ones(len(other), dtype=np.complex128),
                        incidence_rad=np.full(len(other), np.nan),
                        surface=SURFACES[other.kind],
                    ),
                ]
            ),
            echoes=echoes,
        )

    def trace(self, pulses: Pulses) -> BeamHits:
        """Return the rays of a block of pulses that strike a surface or a leaf, sorted by pulse."""
        turn_rad = 2 * np.pi * pulse_uniforms(self._seed, Stream.LIDAR_RAYS, pulses.index, 1)[:, 0]
        offset = beam_offsets(self.receiver.divergence_rad, self._rays, turn_rad)
        ahead = np.concatenate([np.ones((*offset.shape[:2], 1)), np.tan(offset)], axis=2)
        direction = np.einsum("pij,prj->pri", pulses.true.R_world_antenna, ahead)
        direction = (direction / np.linalg.norm(direction, axis=2)[:, :, None]).reshape(-1, 3)
        origin = np.repeat(pulses.true.position_m, self._rays, axis=0)
        first = self._caster.cast(origin, direction)
        ray = np.flatnonzero(first.hit)
        hits = BeamHits(
            row=ray // self._rays,
            range_m=first.distance_m[ray],
            reflectivity=self._reflectivity[first.surface[ray]],
            cosine=first.cosine[ray],
            kind=np.full(len(ray), GROUND),
        )
        if self._plants is None:
            return hits
        drawn = pulse_uniforms(self._seed, Stream.LIDAR_LEAVES, pulses.index, 4 * self._rays).reshape(-1, 4)[ray]
        hit_m = origin[ray] + hits.range_m[:, None] * direction[ray]
        passed, away_m = self._through(self._plants, hit_m, -direction[ray], hits, drawn[:, :2])
        leaf = drawn[:, 2] >= passed
        return BeamHits(
            row=hits.row,
            range_m=hits.range_m - np.where(leaf, away_m, 0.0),
            reflectivity=np.where(leaf, self._leaf_reflectivity, hits.reflectivity),
            cosine=np.where(leaf, np.sqrt(drawn[:, 3]), hits.cosine),
            kind=np.where(leaf, LEAVES, GROUND),
        )

    def _through(
        self,
        plants: PlantCover,
        hit_m: Float[np.ndarray, "ray 3"],
        back: Float[np.ndarray, "ray 3"],
        hits: BeamHits,
        drawn: Float[np.ndarray, "ray 2"],
    ) -> Float[np.ndarray, "2 ray"]:
        """Return the probability that each ray meets no leaf, and how far from the ground one is that it meets."""
        shallow = np.maximum(np.minimum(hits.cosine, np.abs(back[:, 2])), MIN_GRAZING_SINE)
        least_m = np.minimum(plants.highest_m / shallow, hits.range_m * (1 - 1e-6))
        extinction = plants.light_extinction_per_m
        # `follow` counts both ways, and weights places by what they return: here, by what they intercept.
        return follow_rays(plants, hit_m, back, least_m, extinction / 2, extinction, drawn)[[0, 2]]

    def _air(self, pulses: Pulses, hits: BeamHits) -> Float[np.ndarray, "row sample"]:
        """Return the light of fog and drops, of that part of the beam that nothing has stopped before."""
        receiver, count, samples = self.receiver, len(pulses), self.receiver.samples
        place = np.ceil((hits.range_m - receiver.range_m[0]) / receiver.step_m).astype(np.int64)
        stopped = np.bincount(hits.row * samples + np.clip(place, 0, samples - 1), minlength=count * samples).reshape(
            count, samples
        )
        open_fraction = 1 - np.cumsum(stopped, axis=1) / self._rays
        light = receiver.spread(open_fraction * receiver.volume)
        if receiver.air.drops is None:
            return light
        met = [receiver.draw_drops(each) for each in pulse_generators(self._seed, Stream.LIDAR_DROPS, pulses.index)]
        row = np.repeat(np.arange(count), [len(range_m) for range_m, _ in met])
        range_m, echo = (np.concatenate(each) for each in zip(*met, strict=True))
        place = np.clip(np.rint((range_m - receiver.range_m[0]) / receiver.step_m).astype(np.int64), 0, samples - 1)
        return light + receiver.waveforms(row, range_m, echo * open_fraction[row, place], count)


def lidar_as_built(inputs: SensorInputs) -> LidarAsBuilt:
    """Return the waveform lidar of a scenario."""
    scene, table = inputs.engine.scene, inputs.lidar
    return LidarAsBuilt(
        inputs.engine.caster,
        waveform_receiver(table, inputs.weather),
        surface_reflectivities(table, [surface.material for surface in scene.surfaces]),
        rays=table.rays,
        seed=inputs.engine.seed,
        range_noise_m=table.range_noise_m,
        plants=scene.vegetation,
        leaf_reflectivity=table.leaf_reflectivity,
    )
