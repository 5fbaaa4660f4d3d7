"""What a turn shows of the surroundings: peaks of its rows, and the small surfaces that they make up.

A chirp leaves the turning antenna at the time s after the middle of its turn, at the angle b clockwise from the nose.
On a vehicle with the velocity (f, r) ahead and to the right, and the yaw rate w, all constant over the turn, an echo
that is read at the range d came, in the axes of the vehicle in the middle of the turn, from

    p = J(w s) (f, r) s + (d + D (f cos b + r sin b)) (cos(b + w s), sin(b + w s)),

with J(a) = [[sin a, cos a - 1], [1 - cos a, sin a]] / a the integral of the turning axes, and D = f0 / (B f_m) the
shift of ranges per range rate of an up-sweep (Vivet, Checchin, Chapuis 2013, Sensors 13, 4527, take velocities from
both terms; Adolfsson et al. 2023, IEEE Transactions on Robotics 39, the small surfaces).

Peaks of a square of ground are a Gaussian: their weighted mean and covariance. An edge of a house is a long one, a
post a small one.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from sionna_radar.foundation.columns import Columns
from sionna_radar.studies.panorama.polar_images import PolarImages


@dataclass(frozen=True, kw_only=True)
class Peaks:
    """Peaks of the rows of one turn.

    range_m: as read. angle_rad: of the antenna, clockwise from the nose. since_s: from the middle of the turn.
    weight: power over the threshold, dB. doppler_s: shift of ranges per range rate.
    """

    range_m: Float[np.ndarray, " peak"]
    angle_rad: Float[np.ndarray, " peak"]
    since_s: Float[np.ndarray, " peak"]
    weight: Float[np.ndarray, " peak"]
    doppler_s: float

    def places(self, twist: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "peak 2"]:
        """Return their places, ahead and to the right of the vehicle in the middle of the turn.

        twist: velocity ahead and to the right, m/s, and yaw rate clockwise, rad/s.
        """
        ahead, right, yaw = twist
        turned = yaw * self.since_s
        driven = np.column_stack(
            [
                ahead * np.sinc(turned / np.pi) - right * _versine(turned),
                ahead * _versine(turned) + right * np.sinc(turned / np.pi),
            ]
        )
        read = self.range_m + self.doppler_s * (ahead * np.cos(self.angle_rad) + right * np.sin(self.angle_rad))
        toward = self.angle_rad + turned
        return driven * self.since_s[:, None] + read[:, None] * np.column_stack([np.cos(toward), np.sin(toward)])

    def slopes(self, twist: Float[np.ndarray, " 3"]) -> Float[np.ndarray, "peak 2 3"]:
        """Return the derivatives of the places by the twist, from differences."""
        steps = np.array([1e-3, 1e-3, 1e-5])
        return np.stack(
            [(self.places(twist + e) - self.places(twist - e)) / (2 * e.sum()) for e in np.diag(steps)], axis=2
        )


def _versine(angle: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return (1 - cos a) / a."""
    half = angle / 2
    return np.sinc(half / np.pi) * np.sin(half)


def peaks_of(images: PolarImages, turn: int, *, threshold_db: float, near_m: float, far_m: float) -> Peaks:
    """Return the peaks of a turn's rows that exceed the mean on both sides of them.

    Powers count times the fourth power of the range, so that the fall of the ground's echo makes no peaks near by.
    threshold_db: over the larger of the two means. near_m, far_m: ranges between which they are looked for.
    """
    cell_m = float(images.range_m[1] - images.range_m[0])
    power = images.power_w[turn] * images.range_m**4
    wide, guard = round(MEAN_M / cell_m), round(GUARD_M / cell_m)
    mean = uniform_filter1d(power, 2 * (wide // 2) + 1, axis=1, mode="nearest")
    away = guard + wide // 2
    padded = np.pad(mean, ((0, 0), (away, away)), mode="edge")
    level = np.maximum(np.maximum(padded[:, 2 * away :], padded[:, : -2 * away]), np.finfo(float).tiny)
    found = (power >= level * 10 ** (threshold_db / 10)) & (power >= maximum_filter1d(power, 3, axis=1))
    found &= (images.range_m >= near_m) & (images.range_m <= far_m)
    found[:, [0, -1]] = False
    row, cell = np.nonzero(found)
    below, at, above = (np.log(np.maximum(power[row, cell + k], np.finfo(float).tiny)) for k in (-1, 0, 1))
    bend = below - 2 * at + above
    offset = np.where(bend < 0, 0.5 * (below - above) / np.where(bend < 0, bend, 1.0), 0.0)
    middle_s = images.time_s[turn].mean()
    return Peaks(
        range_m=images.range_m[cell] + np.clip(offset, -0.5, 0.5) * cell_m,
        angle_rad=images.scan_rad[turn, row],
        since_s=images.time_s[turn, row] - middle_s,
        weight=10 * np.log10(power[row, cell] / level[row, cell]) - threshold_db + 1.0,
        doppler_s=images.chirp.doppler_range_s,
    )


# Length of the mean on each side of a peak, and of what lies between.
MEAN_M, GUARD_M = 12.0, 3.0


@dataclass(frozen=True, kw_only=True)
class Surfaces(Columns):
    """Small surfaces: Gaussians of places in a plane.

    mean_m, covariance_m2: in the axes of a vehicle or of the map. cut_m2: the covariance of the place of a partner on
        it, which along a wall that its square cuts is anywhere. slope: derivatives of the means by the twist.
    """

    mean_m: Float[np.ndarray, "surface 2"]
    covariance_m2: Float[np.ndarray, "surface 2 2"]
    cut_m2: Float[np.ndarray, "surface 2 2"]
    slope: Float[np.ndarray, "surface 2 3"]

    def moved(self, pose: Float[np.ndarray, " 3"]) -> "Surfaces":
        """Return them seen from where a vehicle is at a pose: two places in m, and a heading in rad."""
        R = rotation(pose[2])
        return Surfaces(
            mean_m=self.mean_m @ R.T + pose[:2],
            covariance_m2=R @ self.covariance_m2 @ R.T,
            cut_m2=R @ self.cut_m2 @ R.T,
            slope=R @ self.slope,
        )


def rotation(heading_rad: float) -> Float[np.ndarray, "2 2"]:
    """Return the matrix from ahead and right to the axes that the heading, clockwise, counts from."""
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    return np.array([[c, -s], [s, c]])


def surfaces_of(peaks: Peaks, twist: Float[np.ndarray, " 3"], *, size_m: float, sigma_m: float) -> Surfaces:
    """Return the small surfaces of a turn's peaks: those of squares of ground, which overlap by half.

    size_m: side of the squares. sigma_m: least standard deviation in any direction, that of one peak's range.
    """
    place, slope, weight = peaks.places(twist), peaks.slopes(twist), peaks.weight
    means, covariances, slopes = [], [], []
    for shift in ((0.0, 0.0), (0.5, 0.5)):
        square = np.floor(place / size_m + shift).astype(np.int64)
        _, number, count = np.unique(square, axis=0, return_inverse=True, return_counts=True)
        number = number.ravel()
        total = np.bincount(number, weight)
        mean = np.column_stack([np.bincount(number, weight * place[:, i]) for i in range(2)]) / total[:, None]
        away = place - mean[number]
        spread = np.empty((len(total), 2, 2))
        for i in range(2):
            for j in range(2):
                spread[:, i, j] = np.bincount(number, weight * away[:, i] * away[:, j]) / total
        bent = np.empty((len(total), 2, 3))
        for i in range(2):
            for j in range(3):
                bent[:, i, j] = np.bincount(number, weight * slope[:, i, j]) / total
        some = count >= MIN_PEAKS
        means.append(mean[some])
        covariances.append(spread[some] + sigma_m**2 * np.eye(2))
        slopes.append(bent[some])
    covariance = np.concatenate(covariances)
    return Surfaces(
        mean_m=np.concatenate(means),
        covariance_m2=covariance,
        cut_m2=_cut(covariance, size_m),
        slope=np.concatenate(slopes),
    )


def _cut(covariance_m2: Float[np.ndarray, "n 2 2"], size_m: float) -> Float[np.ndarray, "n 2 2"]:
    """Return covariances of surfaces of which the long ones say nothing along themselves.

    A wall that runs through a square is cut by its sides: where its middle lies is of the square, not of the wall.
    """
    variance, axis = np.linalg.eigh(covariance_m2)
    variance[:, 1] = np.where(variance[:, 1] > (CUT * size_m) ** 2, UNKNOWN * size_m**2, variance[:, 1])
    return np.einsum("nij,nj,nkj->nik", axis, variance, axis)


# Least standard deviation of a cut surface over the size of the square: that of a whole side is 0.29.
CUT, UNKNOWN = 0.2, 1e4
# Fewest peaks of a surface: a plane through less says nothing of its direction.
MIN_PEAKS = 4
