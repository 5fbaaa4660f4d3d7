"""The echoes predicted for a surface, and their derivatives with respect to its heights.

A forward model for mapping, from measured poses and the known antenna only. Rays along the nodes of the beam
meet the surface; between the nodes 1/range is linear in the direction cosines, exactly so on a plane. Each sample of
the beam adds power to the two range cells around its range, Doppler included, and the window's response spreads it.
Power per solid angle falls with the square of the range (constant gamma: sigma0 dA = gamma r^2 dOmega, over r^4).

Powers are exponential about their means mu. A change of the surface changes log mu; the part explained by a change of
the echo's level is projected out, so that reflectivity need not be known. Cells far below the echo's level hold side
lobes and a handful of scatterers: each cell has a weight w(mu) that decreases there, which leaves the
score w (P / mu - 1) unbiased, as it does not depend on P.

Behind a volume such as rain, mu includes the volume's power, as far as the beam is in the air: a sample ends it at its
own range, shifted by the motion of the volume. So the end of the rain informs the surface as the ground's echo does.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from scipy.ndimage import convolve1d, gaussian_filter1d
from scipy.sparse import csr_matrix

from sionna_radar.detection.profiles import Profiles
from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.flight.pulses import Pose
from sionna_radar.mapping.beam import BeamNodes
from sionna_radar.radar.chirp import Chirp

# Level, relative to the echo's, at which the weight of a cell is a quarter.
FADING_LEVEL = 0.02
PEDESTAL = 1e-4
# One in 3000 exponential powers exceeds 8 means: anything stronger is not terrain, and is clipped there.
HIGHEST_RATIO = 8.0
# One cell of pure noise in 10^13 exceeds this many means.
OUT_OF_NOISE = 30.0
STEEPEST = 0.05
LEVEL_ITERATIONS = 12
# A spread of the volume's drift below this has no effect.
LEAST_SPREAD_CELLS = 0.05
FEWEST_CELLS = 2


@dataclass(frozen=True, kw_only=True)
class Sightings:
    """Input of the mapping: the profiles of some pulses and the measured pose of each.

    chirp, beam: the sweep and the antenna.
    response: power response of the spectrum to a point target, on an odd number of cells centred on it.
    looks_per_cell: independent looks per range cell.
    doppler: whether ranges shift with the range rate, 1, or not, 0.
    reach_m: unambiguous range of the sampling.
    """

    profiles: Profiles
    pose: Pose
    chirp: Chirp
    beam: BeamNodes
    response: Float[np.ndarray, " cell"]
    looks_per_cell: float
    doppler: float
    reach_m: float

    def __len__(self) -> int:
        return len(self.profiles)

    def rows(self, keep: Bool[np.ndarray, " pulse"]) -> "Sightings":
        """Return the sightings of some pulses."""
        return replace(self, profiles=self.profiles.rows(np.flatnonzero(keep)), pose=self.pose.rows(keep))

    def direction(self) -> Float[np.ndarray, "pulse node 3"]:
        """Return the beam's nodes in the world frame."""
        return np.einsum("pij,kj->pki", self.pose.R_world_antenna, self.beam.direction)

    def shift_m(self, direction: Float[np.ndarray, "pulse n 3"]) -> Float[np.ndarray, "pulse n"]:
        """Return by how much motion shifts ranges along directions."""
        rate = -np.einsum("pi,pni->pn", self.pose.velocity_mps, direction)
        return self.doppler * self.chirp.doppler_range_m(rate.ravel()).reshape(rate.shape)


@dataclass(frozen=True)
class Footprints:
    """Where the beam's nodes meet a surface.

    range_m: NaN where a ray meets nothing; range_per_height: its derivative with respect to the surface height there.
    """

    range_m: Float[np.ndarray, "pulse node"]
    place_m: Float[np.ndarray, "pulse node 2"]
    range_per_height: Float[np.ndarray, "pulse node"]


@dataclass(frozen=True)
class Linearised:
    """The log-likelihood linearised about a surface, in the heights under the nodes.

    score: its gradient; factor: for each pulse F, with F^T F the expected curvature.
    """

    place_m: Float[np.ndarray, "pulse node 2"]
    score: Float[np.ndarray, "pulse node"]
    factor: list[Float32[np.ndarray, "_ node"]]


def footprints(sightings: Sightings, surface: Heightfield) -> Footprints:
    """Cast the beam's nodes of every pulse on a surface."""
    direction = sightings.direction()
    pulses, nodes, _ = direction.shape
    rays = direction.reshape(-1, 3)
    origin = np.repeat(sightings.pose.position_m, nodes, axis=0)
    range_m = surface.first_hit(origin, rays, sightings.reach_m)
    place = origin[:, :2] + np.nan_to_num(range_m)[:, None] * rays[:, :2]
    east, north = surface.slope(*place.T)
    # On the ray z + r d_z = h(x + r d_x, y + r d_y): raising h shortens r by 1 / (d_z - slope . d_xy) < 0.
    closing = np.minimum(rays[:, 2] - east * rays[:, 0] - north * rays[:, 1], -STEEPEST)
    per_height = np.where(np.isfinite(range_m), 1 / closing, 0.0)
    shape = (pulses, nodes)
    return Footprints(range_m.reshape(shape), place.reshape(*shape, 2), per_height.reshape(shape))


@dataclass(frozen=True)
class _Spread:
    """The samples of one pulse that fall inside its range cells, with cell, share of the cell, and power.

    share_before: share of the beam that meets the surface before the first cell.
    """

    sample: Int[np.ndarray, " inside"]
    below: Int[np.ndarray, " inside"]
    above_share: Float[np.ndarray, " inside"]
    power: Float[np.ndarray, " inside"]
    stretch: Float[np.ndarray, " inside"]
    share_before: float


class EchoModel:
    """Predicted echoes of all pulses over one surface."""

    def __init__(self, sightings: Sightings, surface: Heightfield) -> None:
        self._sightings = sightings
        self._feet = footprints(sightings, surface)
        self._shift = sightings.shift_m(sightings.direction())
        self._half = len(sightings.response) // 2

    def centroid_m(self) -> Float[np.ndarray, " pulse"]:
        """Return the power-weighted mean range of every predicted echo; NaN without an echo."""
        mean = np.full(len(self._sightings), np.nan)
        for pulse in range(len(mean)):
            spread = self._spread(pulse, -np.inf, np.inf)
            total = spread.power.sum()
            if total > 0:
                cell = spread.below + spread.above_share
                mean[pulse] = spread.power @ cell / total * self._sightings.profiles.cell_m
        return mean

    def linearise(self, noise_factor: float) -> Linearised:
        """Return score and curvature of the likelihood of the profiles.

        noise_factor: factor by which errors outside the model raise the variance of the data.
        """
        nodes = self._sightings.beam.direction.shape[0]
        score = np.zeros((len(self._sightings), nodes))
        factor = []
        for pulse in range(len(score)):
            one, root = self._pulse(pulse, self._sightings.looks_per_cell / noise_factor)
            score[pulse] = one
            factor.append(root)
        return Linearised(self._feet.place_m, score, factor)

    def _pulse(self, pulse: int, looks: float) -> tuple[Float[np.ndarray, " node"], Float32[np.ndarray, "_ node"]]:
        profiles = self._sightings.profiles
        power, first = profiles.values(pulse), int(profiles.first[pulse])
        spread = self._spread(pulse, float(first), float(first + len(power) - 1))
        shape = self._mean(spread, len(power))
        nodes = self._sightings.beam.direction.shape[0]
        volume, by_height = self._volume(pulse) if profiles.volume is not None else (np.zeros(len(power)), None)
        noise = float(profiles.noise[pulse])
        top = echo_level(power, noise, noise + volume)
        if not shape.any() or top == 0:
            return np.zeros(nodes), np.zeros((0, nodes), dtype=np.float32)
        level, mean, weight = _fit_level(power, shape, volume, noise + PEDESTAL * top, top)
        used = np.flatnonzero(weight > 1e-4)
        power, mean, weight = power[used], mean[used], weight[used]
        moved = self._responded(self._moved(pulse, spread, spread.power, len(shape)), len(shape))
        if by_height is not None:
            moved += by_height / level
        jacobian = moved[used] * (level / mean)[:, None]
        of_level = level * shape[used] / mean
        if len(used) < FEWEST_CELLS:
            return np.zeros(nodes), np.zeros((0, nodes), dtype=np.float32)
        jacobian -= np.outer(of_level, (weight * of_level) @ jacobian / (weight @ of_level**2))
        residual = np.minimum(power / mean, HIGHEST_RATIO) - 1
        root = np.sqrt(looks * weight)[:, None] * jacobian
        return looks * (weight * residual) @ jacobian, root.astype(np.float32)

    def _volume(self, pulse: int) -> tuple[Float[np.ndarray, " cell"], Float[np.ndarray, "cell node"]]:
        """Return the mean power of a volume in front of the ground, and its derivative by the nodes' heights."""
        profiles = self._sightings.profiles
        inside = slice(profiles.start[pulse], profiles.start[pulse + 1])
        cells, first = inside.stop - inside.start, float(profiles.first[pulse])
        assert profiles.volume is not None
        power = profiles.volume.power[inside].astype(np.float64)
        spread = self._spread(pulse, first, first + cells - 1, float(profiles.volume.drift_m[pulse]))
        share, pad = self._sightings.beam.share[spread.sample], 2 * self._half + 1
        hit = self._hits(spread, share, cells)
        air = 1 - spread.share_before - _up_to_middle(hit[:, None])
        moved = -_up_to_middle(self._moved(pulse, spread, share, cells))
        sigma = profiles.volume.spread_m / profiles.cell_m
        response = self._sightings.response / self._sightings.response.sum()
        both = np.concatenate([air, moved], axis=1)
        if sigma > LEAST_SPREAD_CELLS:
            both = gaussian_filter1d(both, sigma, axis=0, mode="nearest")
        both = convolve1d(both, response, axis=0, mode="nearest")[pad : pad + cells]
        return power * both[:, 0], power[:, None] * both[:, 1:]

    def _spread(self, pulse: int, first: float, last: float, drift_m: float = 0.0) -> _Spread:
        """Return the samples of a pulse between two range cells, numbered from the first.

        drift_m: by how much they appear farther than the ground's echoes.
        """
        beam = self._sightings.beam
        range_m = self._feet.range_m[pulse]
        met = np.isfinite(range_m)
        inverse = np.where(met, 1 / np.maximum(range_m, 1.0), 0.0)
        whole = beam.between @ (~met).astype(float) == 0
        sample_range = 1 / np.maximum(beam.between @ inverse, 1e-6)
        cell = (sample_range + beam.between @ self._shift[pulse] + drift_m) / self._sightings.profiles.cell_m
        origin = first if np.isfinite(first) else 0.0
        inside: Bool[np.ndarray, " sample"] = whole & (cell > first - self._half) & (cell < last + self._half)
        before = float(beam.share[whole & (cell <= first - self._half)].sum())
        cell = cell[inside] - origin
        below = np.floor(cell).astype(np.int64)
        power = beam.share[inside] * (np.nanmean(range_m[met]) / sample_range[inside]) ** 2 if met.any() else cell
        return _Spread(np.flatnonzero(inside), below, cell - below, power, sample_range[inside] ** 2, before)

    def _mean(self, spread: _Spread, cells: int) -> Float[np.ndarray, " cell"]:
        """Return the profile of the samples at unit level."""
        pad = 2 * self._half + 1
        hit = self._hits(spread, spread.power, cells)
        profile: Float[np.ndarray, " cell"] = np.convolve(hit, self._sightings.response, "same")[pad : pad + cells]
        return profile

    def _hits(self, spread: _Spread, power: Float[np.ndarray, " inside"], cells: int) -> Float[np.ndarray, " padded"]:
        """Return the power of the samples on cells, with a margin for the window's response."""
        pad = 2 * self._half + 1
        size = cells + 2 * pad
        hit = np.bincount(spread.below + pad, power * (1 - spread.above_share), size)
        return np.asarray(hit + np.bincount(spread.below + pad + 1, power * spread.above_share, size))

    def _moved(
        self, pulse: int, spread: _Spread, power: Float[np.ndarray, " inside"], cells: int
    ) -> Float[np.ndarray, "padded node"]:
        """Return the derivative of the hits with respect to the heights under the nodes."""
        sightings = self._sightings
        pad = 2 * self._half + 1
        moved = power * spread.stretch / sightings.profiles.cell_m
        number = np.arange(len(moved))
        onto = csr_matrix(
            (
                np.concatenate([-moved, moved]),
                (np.concatenate([spread.below, spread.below + 1]) + pad, np.concatenate([number, number])),
            ),
            shape=(cells + 2 * pad, len(moved)),
        )
        inverse = 1 / np.maximum(np.nan_to_num(self._feet.range_m[pulse], nan=np.inf), 1.0)
        raw = (onto @ sightings.beam.between[spread.sample]).toarray()
        return np.asarray(raw * (inverse**2 * self._feet.range_per_height[pulse]))

    def _responded(self, raw: Float[np.ndarray, "padded node"], cells: int) -> Float[np.ndarray, "cell node"]:
        """Return values on cells, convolved with the window's response."""
        pad = 2 * self._half + 1
        spread = np.zeros((cells, raw.shape[1]))
        for offset, response in enumerate(self._sightings.response):
            start = pad + self._half - offset
            spread += response * raw[start : start + cells]
        return spread


def _up_to_middle(values: Float[np.ndarray, "cell n"]) -> Float[np.ndarray, "cell n"]:
    """Return the cumulative sums of values up to the middle of each cell."""
    total = np.cumsum(values, axis=0)
    return np.asarray(total - values / 2)


def echo_level(
    power: Float[np.ndarray, " cell"], noise: float, background: float | Float[np.ndarray, " cell"]
) -> float:
    """Return the level of a box with the echo's power, from E[P^2] = 2 E[P]^2; 0 if nothing exceeds the noise.

    noise: receiver noise power; background: that plus the mean of a volume in front of the ground.
    """
    above = np.maximum(power - (background - noise) - OUT_OF_NOISE * noise, 0.0)
    return float(above @ above / above.sum() / 2) if above.any() else 0.0


def _fit_level(
    power: Float[np.ndarray, " cell"],
    shape: Float[np.ndarray, " cell"],
    volume: Float[np.ndarray, " cell"],
    noise: float,
    top: float,
) -> tuple[float, Float[np.ndarray, " cell"], Float[np.ndarray, " cell"]]:
    """Return the most likely level of an echo, with the mean powers and weights of the cells at that level."""
    level = float(power.sum() / shape.sum())
    for _ in range(LEVEL_ITERATIONS):
        mean, weight = _at_level(level, shape, volume, noise, top)
        share = weight * level * shape / mean
        excess = np.minimum(power / mean, HIGHEST_RATIO) - 1
        step = float(share @ excess / max(share.sum(), np.finfo(float).tiny))
        level *= float(np.exp(np.clip(step, -1.0, 1.0)))
        if abs(step) < 1e-4:
            break
    return level, *_at_level(level, shape, volume, noise, top)


def _at_level(
    level: float, shape: Float[np.ndarray, " cell"], volume: Float[np.ndarray, " cell"], noise: float, top: float
) -> tuple[Float[np.ndarray, " cell"], Float[np.ndarray, " cell"]]:
    signal = level * shape + volume
    return signal + noise, (signal / (signal + FADING_LEVEL * top)) ** 2
