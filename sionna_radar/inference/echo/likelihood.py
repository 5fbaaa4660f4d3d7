"""Forward model of echoes: predicted range profiles over a surface, their derivatives by heights, and mean ranges.

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

Mapping begins with the mean range of each whole echo (`MeanRanges`).
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt16
from scipy.linalg import solve_banded

from sionna_radar.detection.echoes import MIN_SIGMA_CELLS, Profiles
from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import over_rows
from sionna_radar.inference.echo.beam import BeamNodes
from sionna_radar.inference.echo.speckle import STILL, SpeckleMemory, speckle_reach
from sionna_radar.radar.chirp import Chirp

# Smallest spline coefficient kept of a window's response, relative to the largest.
MIN_TAP = 1e-3
# Length of rays relative to the unambiguous range.
FOLLOWED = 1.15


@dataclass(frozen=True, kw_only=True)
class LandCover:
    """Land cover known beforehand: what of the ground is brighter, and by how much.

    grid: cells of the cover, continued beyond its borders.
    cover: number of the cover of each cell.
    gamma: of each cover at incidences of 0 deg, 1 deg and so on, sigma0 / cos(incidence); of any unit.
    """

    grid: Grid
    cover: UInt16[np.ndarray, "row column"]
    gamma: Float[np.ndarray, "cover degree"]

    def levels(self, axis: Float[np.ndarray, "pulse 3"]) -> Float[np.ndarray, "pulse cover"]:
        """Return the power per solid angle from each cover over that of the brightest, for axes that meet level ground.

        One incidence for all of a footprint: within one cover gamma stays constant.
        """
        degree = np.rint(np.rad2deg(np.arccos(np.clip(-axis[:, 2], 0.0, 1.0)))).astype(np.int64)
        gamma = self.gamma[:, np.minimum(degree, self.gamma.shape[1] - 1)].T
        return np.ascontiguousarray(gamma / gamma.max(axis=1, keepdims=True))

    def brightness(
        self, place_m: Float[np.ndarray, "pulse node 2"], axis: Float[np.ndarray, "pulse 3"]
    ) -> Float[np.ndarray, "pulse node"]:
        """Return the level of the cover at places, those of each pulse for its axis."""
        grid = self.grid
        cell = np.rint((place_m - [grid.west_m, grid.south_m]) / grid.spacing_m).astype(np.int64)
        column, row = np.clip(cell[..., 0], 0, grid.columns - 1), np.clip(cell[..., 1], 0, grid.rows - 1)
        return np.take_along_axis(self.levels(axis), self.cover[row, column].astype(np.int64), axis=1)


@dataclass(frozen=True, kw_only=True)
class Sightings:
    """Input of the mapping: the profiles of some pulses and the measured pose of each.

    chirp, beam: the sweep and the antenna.
    response: power response of the spectrum to a point target, on an odd number of cells centred on it.
    looks_per_cell: independent looks per range cell.
    doppler: whether ranges shift with the range rate, 1, or not, 0.
    reach_m: unambiguous range of the sampling.
    memory: temporal decorrelation of speckle.
    microrelief_m: what is usual on such ground; see `Covariance`.
    range_bias_m, range_scale: what the radar reads beyond the true range, and of each metre of it.
    cover: of the ground, by which parts of a footprint are brighter than others; None for one backscatter in each.
    """

    profiles: Profiles
    pose: Pose
    chirp: Chirp
    beam: BeamNodes
    response: Float[np.ndarray, " cell"]
    looks_per_cell: float
    doppler: float
    reach_m: float
    memory: SpeckleMemory = STILL
    microrelief_m: float = 0.0
    range_bias_m: float = 0.0
    range_scale: float = 0.0
    cover: LandCover | None = None

    def __len__(self) -> int:
        return len(self.profiles)

    def rows(self, keep: Bool[np.ndarray, " pulse"]) -> "Sightings":
        """Return the sightings of some pulses."""
        return replace(self, profiles=self.profiles.rows(np.flatnonzero(keep)), pose=self.pose.rows(keep))

    @property
    def doppler_s(self) -> float:
        """Range shift per range rate, m per m/s; 0 where ranges do not shift."""
        return self.doppler * self.chirp.doppler_range_s

    @property
    def followed_m(self) -> float:
        """Length of cast rays: beyond the reach, so that the node next to the last one in reach meets ground too."""
        return FOLLOWED * self.reach_m

    def repeated(self, range_m: Float[np.ndarray, " pulse"], *, of_power: bool = False) -> Float[np.ndarray, " pulse"]:
        """Return the number of pulses over which the speckle of each repeats, given the ranges on the axis.

        of_power: in the powers of whole echoes, instead of their mean ranges.
        """
        geometry = self.pose.rows, range_m, self.beam, self.chirp, self.memory
        return speckle_reach(self.profiles.pulse, *geometry, of_power=of_power)

    def direction(self) -> Float[np.ndarray, "pulse node 3"]:
        """Return the beam's nodes in the world frame."""
        return in_world(self.pose, self.beam.direction)

    def corner_directions(self) -> Float[np.ndarray, "pulse 4 3"]:
        """Return the corners of the main lobe in the world frame."""
        return in_world(self.pose, self.beam.direction[self.beam.corners])

    def echo_direction(self) -> Float[np.ndarray, "pulse 3"]:
        """Return the directions of the mean ranges: the axis, or behind rain those beside it; see `VolumeInFront`."""
        volume = self.profiles.volume
        if volume is None:
            return self.pose.boresight
        return np.einsum("pij,pj->pi", self.pose.R_world_antenna, volume.direction)

    def true_m(self, read_m: Float[np.ndarray, " pulse"]) -> Float[np.ndarray, " pulse"]:
        """Return mean ranges without the Doppler shift in their directions, and without errors of the radar."""
        shift_m = self.shift_m(self.echo_direction()[:, None])[:, 0]
        return (read_m - shift_m - self.range_bias_m) / (1 + self.range_scale)

    def places(self, range_m: Float[np.ndarray, " pulse"]) -> Float[np.ndarray, "pulse 3"]:
        """Return the places at mean ranges in their directions."""
        return self.pose.position_m + range_m[:, None] * self.echo_direction()

    def shift_m(self, direction: Float[np.ndarray, "pulse n 3"]) -> Float[np.ndarray, "pulse n"]:
        """Return the Doppler range shift along directions, m."""
        rate = -np.einsum("pi,pni->pn", self.pose.velocity_mps, direction)
        return self.doppler * self.chirp.doppler_range_m(rate.ravel()).reshape(rate.shape)


def in_world(pose: Pose, direction: Float[np.ndarray, "node 3"]) -> Float[np.ndarray, "pulse node 3"]:
    """Return directions in the antenna's frame in the world frame, for each pose."""
    result = np.empty((len(pose), len(direction), 3))

    def some(low: int, high: int) -> None:
        np.einsum("pij,kj->pki", pose.R_world_antenna[low:high], direction, out=result[low:high])

    over_rows(some, len(pose))
    return result


@dataclass(frozen=True)
class BeamFootprints:
    """Intersections of the beam's nodes with a surface.

    range_m: NaN where a ray meets nothing; range_per_height: its derivative with respect to the surface height
    there. shift_m: what is read beyond the range: by Doppler, and by errors of the radar.
    """

    range_m: Float[np.ndarray, "pulse node"]
    place_m: Float[np.ndarray, "pulse node 2"]
    range_per_height: Float[np.ndarray, "pulse node"]
    shift_m: Float[np.ndarray, "pulse node"]


@dataclass(frozen=True)
class Linearised:
    """The log-likelihood linearised about a surface, in the heights under the nodes.

    score: its gradient.
    factor: rows of F of all pulses, with F^T F the expected curvature of each.
    first, last: where the rows of each pulse begin and end; those between belong to none, and are zero.
    residual: whitened residuals of the data in these rows; the score is F^T residual.
    weight: of the range cell of each row, from 0 to 1: the variance of a residual in independent looks.
    """

    place_m: Float[np.ndarray, "pulse node 2"]
    score: Float[np.ndarray, "pulse node"]
    factor: Float32[np.ndarray, "kept node"]
    first: Int[np.ndarray, " pulse"]
    last: Int[np.ndarray, " pulse"]
    residual: Float[np.ndarray, " row"]
    weight: Float[np.ndarray, " row"]

    def rows_of(self, pulse: int) -> slice:
        """Return the rows of a pulse."""
        return slice(int(self.first[pulse]), int(self.last[pulse]))


def spline_taps(response: Float[np.ndarray, " cell"]) -> Float[np.ndarray, " tap"]:
    """Return the factors of cubic B-splines, a cell apart, whose sum is a response at the cells and smooth between.

    A Hann window's power response nearly is such a spline.
    """
    ends = 8
    padded = np.pad(response, ends)
    bands = np.outer([1 / 6, 2 / 3, 1 / 6], np.ones(len(padded)))
    factor = solve_banded((1, 1), bands, padded)
    counts = np.flatnonzero(np.abs(factor) > MIN_TAP * factor.max())
    half = max(len(padded) // 2 - int(counts[0]), int(counts[-1]) - len(padded) // 2)
    kept = factor[len(padded) // 2 - half : len(padded) // 2 + half + 1]
    return kept * (response.sum() / kept.sum())


def footprints(
    sightings: Sightings,
    surface: Heightfield,
    wanted: Bool[np.ndarray, " node"] | None = None,
    near: BeamFootprints | None = None,
) -> BeamFootprints:
    """Cast the beam's nodes of every pulse, or some of the nodes, on a surface.

    near: start values, from a surface that was the same within centimetres; new shadowing since then is not found.
    """
    from sionna_radar.inference.echo.power_kernels import meet

    pose, beam = sightings.pose, sightings.beam.direction
    shape = len(pose), len(beam)
    feet = BeamFootprints(np.empty(shape), np.empty((*shape, 2)), np.empty(shape), np.empty(shape))
    height, grid = np.ascontiguousarray(surface.height_m), surface.grid
    on = height, grid.west_m, grid.south_m, grid.spacing_m, surface.steepest, float(height.max())
    guess = np.empty((0, 0)) if near is None else near.range_m
    doppler = sightings.doppler_s
    of = (
        *(np.ascontiguousarray(each) for each in (pose.position_m, pose.velocity_mps, pose.R_world_antenna, beam)),
        np.ones(shape[1], dtype=bool) if wanted is None else wanted,
    )

    def some(low: int, high: int) -> None:
        to = feet.range_m, feet.place_m, feet.range_per_height, feet.shift_m
        meet(*on, *of, doppler, sightings.followed_m, guess, *to, low, high)

    over_rows(some, shape[0])
    if sightings.range_bias_m or sightings.range_scale:
        feet.shift_m[...] += sightings.range_bias_m + sightings.range_scale * np.nan_to_num(feet.range_m)
    return feet


class EchoLikelihood:
    """Predicted echoes of all pulses over one surface."""

    def __init__(self, sightings: Sightings, surface: Heightfield, near: BeamFootprints | None = None) -> None:
        self._sightings = sightings
        self._feet = footprints(sightings, surface, near=near)

    @property
    def footprints(self) -> BeamFootprints:
        """Where the beam's nodes meet the surface."""
        return self._feet

    def centroid_m(self) -> Float[np.ndarray, " pulse"]:
        """Return the power-weighted mean range of every predicted echo; NaN without an echo."""
        from sionna_radar.inference.echo.power_kernels import centroids

        beam, mean = self._sightings.beam, np.empty(len(self._sightings))
        cell_m = float(self._sightings.profiles.cell_m)
        # A profile's last cell ends in the middle between it and the next, which is at the unambiguous range.
        reach = self._sightings.reach_m / cell_m - 0.5
        seen = self._feet.range_m, self._feet.shift_m, self._ground()
        on = *seen, beam.power, beam.lattice, cell_m, reach, mean
        over_rows(lambda low, high: centroids(low, high, *on), len(mean))
        return mean

    def linearise(self, looks: Float[np.ndarray, " pulse"], fewest_rows: int | None = None) -> Linearised:
        """Return score and curvature of the likelihood of the profiles.

        looks: independent looks in each range cell of each pulse.
        fewest_rows: of so many rows of neighbouring cells one is kept in place of all, that the median pulse keeps
            about these: where a surface is as smooth as a few cells are long, others say nearly the same. Each pulse
            keeps other ones. Residuals and weights are those of all rows.
        """
        from sionna_radar.inference.echo.kernels import linearise, volume_in_front

        profiles, beam, volume = self._sightings.profiles, self._sightings.beam, self._sightings.profiles.volume
        data, geometry, antenna = self._inputs(looks)
        pulses, nodes, begin = len(profiles), len(beam.direction), self._rooms()
        values, room = int(begin[-1]), np.diff(begin)
        together = 1 if fewest_rows is None else max(1, int(np.median(room) / fewest_rows))
        begin_factor = np.concatenate([[0], np.cumsum(-(-room // together))])
        score, count = np.empty((pulses, nodes)), np.empty(pulses, dtype=np.int64)
        factor, residual = np.zeros((int(begin_factor[-1]), nodes), dtype=np.float32), np.zeros(values)
        weight = np.zeros(values)
        results = score, factor, together, residual, weight, count, begin, begin_factor

        def some(low: int, high: int) -> None:
            """Linearise the echoes of some pulses."""
            in_front = np.empty((0, 0))
            if volume is not None:
                in_front = np.empty((int(profiles.start[high] - profiles.start[low]), nodes + 1))
                clutter = volume.power, volume.drift_m, volume.spread_m / profiles.cell_m
                volume_in_front(low, high, data, clutter, geometry, antenna, in_front)
            linearise(low, high, data, in_front, geometry, antenna, results)

        over_rows(some, pulses)
        first = begin_factor[:-1]
        return Linearised(self._feet.place_m, score, factor, first, first - (-count // together), residual, weight)

    def score(self, looks: Float[np.ndarray, " pulse"]) -> Float[np.ndarray, "pulse node"]:
        """Return the score alone; see `linearise`."""
        if self._sightings.profiles.volume is not None:
            return self.linearise(looks).score
        from sionna_radar.inference.echo.kernels import scores

        score = np.empty(self._feet.range_m.shape)
        inputs = self._inputs(looks)
        over_rows(lambda low, high: scores(low, high, *inputs, score), len(score))
        return score

    def _inputs(self, looks: Float[np.ndarray, " pulse"]) -> tuple[tuple[object, ...], ...]:
        """Return profiles, geometry and antenna as the kernels take them."""
        profiles, beam = self._sightings.profiles, self._sightings.beam
        data = profiles.first, profiles.start, profiles.power, profiles.noise, looks.astype(float), profiles.cell_m
        geometry = self._feet.range_m, self._feet.shift_m, self._feet.range_per_height, self._ground()
        return data, geometry, (beam.power, beam.lattice, spline_taps(self._sightings.response))

    def _ground(self) -> tuple[object, ...]:
        """Return the known cover and its levels as the kernels take them."""
        cover, boresight = self._sightings.cover, self._sightings.pose.boresight
        position_m = np.ascontiguousarray(self._sightings.pose.position_m)
        if cover is None:
            nothing = np.empty((0, 0), dtype=np.uint16), 0.0, 0.0, 1.0, np.empty((len(boresight), 0))
            return self._feet.place_m, *nothing, position_m
        cells = cover.cover, cover.grid.west_m, cover.grid.south_m, cover.grid.spacing_m
        return self._feet.place_m, *cells, cover.levels(boresight), position_m

    def _rooms(self) -> Int[np.ndarray, " edge"]:
        """Return the first cell of each pulse, with room for all that the beam can illuminate, and the total."""
        profiles = self._sightings.profiles
        cells = np.diff(profiles.start)
        if profiles.volume is None:
            # Between the nodes lie all samples, and the window spreads each by half of its length.
            reached = (self._feet.range_m + self._feet.shift_m) / profiles.cell_m
            met = np.isfinite(reached)
            nearest = np.where(met, reached, np.inf).min(axis=1)
            farthest = np.where(met, reached, -np.inf).max(axis=1)
            margin = len(self._sightings.response) // 2 + 3
            spread = np.where(met.any(axis=1), farthest - nearest, 0.0)
            cells = np.minimum(cells, np.ceil(spread).astype(np.int64) + 2 * margin)
        return np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(cells)])


MIN_POWER_OF_PEAK = 1e-2


@dataclass(frozen=True, kw_only=True)
class MeanRanges(Columns):
    """Power-weighted mean range of each whole echo, without Doppler shift and known errors, and its speckle error."""

    range_m: Float[np.ndarray, " pulse"]
    sigma_m: Float[np.ndarray, " pulse"]


def mean_ranges(sightings: Sightings) -> MeanRanges:
    """Return the mean range of every profile, from the cells within 20 dB of its strongest.

    Behind a volume of rain, where the strongest cell may be rain, it is the detected range in its direction.
    """
    from sionna_radar.inference.echo.power_kernels import mean_cells

    profiles = sightings.profiles
    if profiles.volume is not None:
        return MeanRanges(range_m=sightings.true_m(profiles.volume.echo_m), sigma_m=profiles.volume.echo_sigma_m)
    mean, sigma = np.empty(len(profiles)), np.empty(len(profiles))
    looks = float(sightings.looks_per_cell)
    mean_cells(profiles.start, profiles.power, profiles.noise, looks, MIN_POWER_OF_PEAK, mean, sigma)
    sigma = np.maximum(sigma, MIN_SIGMA_CELLS) * profiles.cell_m
    return MeanRanges(range_m=sightings.true_m((profiles.first + mean) * profiles.cell_m), sigma_m=sigma)


def predicted_means(
    sightings: Sightings, surface: Heightfield
) -> tuple[Float[np.ndarray, " pulse"], BeamFootprints | None]:
    """Return the mean ranges over a surface as read, with Doppler and errors of the radar; NaN without an echo.

    Also where the beams meet it, unless a volume is in front, behind which the axes alone are cast.
    """
    if sightings.profiles.volume is None:
        model = EchoLikelihood(sightings, surface)
        return model.centroid_m(), model.footprints
    direction = sightings.echo_direction()
    range_m = surface.first_hit(sightings.pose.position_m, direction, sightings.reach_m)
    shift_m = sightings.shift_m(direction[:, None])[:, 0]
    return np.asarray(range_m * (1 + sightings.range_scale) + sightings.range_bias_m + shift_m), None
