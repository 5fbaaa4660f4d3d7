"""Contents of pattern files, two cuts or a grid over the sphere, and their patterns.

Rows of theta, phi and power, in any order, are arranged in a grid.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import PchipInterpolator, RegularGridInterpolator

from sionna_radar.radar.pattern import ProductPattern, SphericalPattern, directions_of

# Below every measurable side lobe; replaces nulls of minus infinity.
FLOOR_DB = -150.0
HIGHEST_DB = 300.0
# Refinement factor of a file's samples, by a shape-preserving cubic in decibels.
FINER = 4
COARSEST_RAD, FINEST_RAD, FINEST_CUT_RAD = np.deg2rad([0.5, 0.05, 0.005])


def check_unique_angles(power_db: Float[np.ndarray, " n"]) -> None:
    """Raise ValueError for implausible levels."""
    highest = float(power_db.max())
    if not -HIGHEST_DB <= highest <= HIGHEST_DB:
        raise ValueError(f"its highest level is {highest:g} dB, beyond {HIGHEST_DB:g}; give dBi or relative decibels")


@dataclass(frozen=True)
class PatternCuts:
    """Two principal cuts: power against the angle from boresight, toward the left and up.

    Angles in degrees, increasing, from at least -180 to at most 180; powers in decibels of any reference.
    turnable: whether elevations may have been counted from the zenith instead.
    """

    azimuth_deg: Float[np.ndarray, " n"]
    azimuth_db: Float[np.ndarray, " n"]
    elevation_deg: Float[np.ndarray, " m"]
    elevation_db: Float[np.ndarray, " m"]
    turnable: bool = False

    def __post_init__(self) -> None:
        check_unique_angles(np.concatenate([self.azimuth_db, self.elevation_db]))

    def reach_deg(self, boresight: str) -> float:
        """Return the angle from boresight covered on every side; see `pattern`."""
        elevation, _ = self._elevation(boresight)
        return float(min(-self.azimuth_deg[0], self.azimuth_deg[-1], -elevation[0], elevation[-1]))

    def pattern(self, boresight: str = "z") -> ProductPattern:
        """Return the product of the cuts, zero where a cut was not measured.

        boresight: "z" for cuts about boresight; "x" for a vertical cut whose angles count from the zenith.
        """
        elevation, power = self._elevation(boresight)
        return ProductPattern(
            _resampled(self.azimuth_deg, self.azimuth_db, np.pi, turns=True),
            _resampled(elevation, power, np.pi / 2, turns=False),
        )

    def _elevation(self, boresight: str) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        """Return the elevations, increasing, and the powers there."""
        if not self.turnable or boresight != "x":
            return self.elevation_deg, self.elevation_db
        turned = (self.elevation_deg + 90 + 180) % 360 - 180
        order = np.argsort(turned)
        return turned[order], self.elevation_db[order]


@dataclass(frozen=True)
class PatternGrid:
    """Power on a grid over the sphere or a part of it.

    theta_deg: from the z axis of the file, increasing within 0 to 180. phi_deg: from its x axis toward its y axis,
    increasing over one turn at most, at whose end the first one repeats. Powers in decibels of any reference.
    """

    theta_deg: Float[np.ndarray, " theta"]
    phi_deg: Float[np.ndarray, " phi"]
    power_db: Float[np.ndarray, "theta phi"]

    def reach_deg(self, boresight: str) -> float:
        """Return the angle from boresight covered on every side."""
        if boresight == "z":
            return float(self.theta_deg[-1])
        ahead = self.phi_deg[0] + -self.phi_deg[0] % 360
        right, left = ahead - self.phi_deg[0], self.phi_deg[-1] - ahead
        around = 180.0 if right + left > 360 - SAME_DEG else max(min(right, left), 0.0)
        return float(min(around, 90 - self.theta_deg[0], self.theta_deg[-1] - 90))

    def pattern(self, boresight: str) -> SphericalPattern:
        """Return the pattern, zero where it was not measured.

        boresight: the axis of the file along which the antenna looks. For "z" its x axis is left and its y axis up; for
        "x" its y axis is left and its z axis up.
        """
        theta, phi, power_db = self._finer()
        amplitude = 10 ** (power_db / 20)
        interpolate = RegularGridInterpolator((theta, phi), amplitude, bounds_error=False, fill_value=0.0)
        step = np.clip(min(np.diff(theta).min(), np.diff(phi).min()), FINEST_RAD, COARSEST_RAD)

        def amplitude_at(direction: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, " k"]:
            ahead, left, up = direction.T
            x, y, z = (left, up, ahead) if boresight == "z" else (ahead, left, up)
            around = phi[0] + (np.arctan2(y, x) - phi[0]) % (2 * np.pi)
            return interpolate(np.column_stack([np.arccos(np.clip(z, -1, 1)), around]))

        return SphericalPattern.of(amplitude_at, float(step))

    def _finer(self) -> tuple[Float[np.ndarray, " t"], Float[np.ndarray, " p"], Float[np.ndarray, "t p"]]:
        """Return the grid in radians with more samples between those of the file."""
        theta, phi, power = np.deg2rad(self.theta_deg), np.deg2rad(self.phi_deg), np.maximum(self.power_db, FLOOR_DB)
        finer = []
        for angle in (theta, phi):
            step = float(np.diff(angle).min())
            factor = int(np.clip(np.ceil(step / FINEST_RAD), 1, FINER))
            finer.append(np.interp(np.arange((len(angle) - 1) * factor + 1) / factor, np.arange(len(angle)), angle))
        power = PchipInterpolator(theta, power, axis=0)(finer[0])
        return finer[0], finer[1], PchipInterpolator(phi, power, axis=1)(finer[1])


def _resampled(
    angle_deg: Float[np.ndarray, " n"], power_db: Float[np.ndarray, " n"], half_span: float, *, turns: bool
) -> Float[np.ndarray, " m"]:
    """Return amplitudes over the peak's, equally spaced within +-`half_span`, zero where not measured."""
    angle, power = np.deg2rad(angle_deg), np.maximum(power_db - power_db.max(), FLOOR_DB)
    if turns and angle[-1] - angle[0] < 2 * np.pi - 1e-9:
        order, angle = _around(angle, 2 * np.pi)
        power = power[order]
    step = np.clip(np.diff(angle).min() / FINER, FINEST_CUT_RAD, COARSEST_RAD)
    samples = np.linspace(-half_span, half_span, 2 * int(np.ceil(half_span / step)) + 1)
    if turns:
        samples = np.where(samples < angle[0], samples + 2 * np.pi, samples)
    measured = (samples >= angle[0] - 1e-9) & (samples <= angle[-1] + 1e-9)
    amplitude = 10 ** (PchipInterpolator(angle, power)(np.clip(samples, angle[0], angle[-1])) / 20)
    return np.where(measured, amplitude, 0.0)


def axis_gain_db(pattern: ProductPattern | SphericalPattern) -> float:
    """Return the power toward boresight over the peak's, in decibels."""
    ahead = pattern.amplitude(directions_of(np.zeros(1), np.zeros(1)))[0]
    return float(20 * np.log10(max(ahead, 1e-9)))


# Tolerance for equal angles: files round them.
SAME_DEG = 1e-4


def grid_of(
    theta_deg: Float[np.ndarray, " n"], phi_deg: Float[np.ndarray, " n"], power_db: Float[np.ndarray, " n"]
) -> PatternGrid:
    """Return the grid of rows of angles and power; ValueError if they do not fill one.

    Negative thetas lie on the other side of the axis; phis repeat every 360 degrees.
    """
    if np.any(np.abs(theta_deg) > 180 + SAME_DEG) or np.any(np.abs(phi_deg) > 720):
        raise ValueError("theta beyond 180 deg or phi beyond 720 deg; give angles in degrees")
    check_unique_angles(power_db)
    theta, phi = np.abs(theta_deg), np.where(theta_deg < 0, phi_deg + 180, phi_deg) % 360
    phi[360 - phi < SAME_DEG] = 0.0
    thetas, row = _unique_angles(theta)
    phis, column = _unique_angles(phi)
    power = np.full((len(thetas), len(phis)), -np.inf)
    filled = np.zeros(power.shape, dtype=bool)
    power[row, column] = np.maximum(power_db, FLOOR_DB + power_db.max())
    filled[row, column] = True
    for pole in (0.0, 180.0):  # one direction for all phis: one value is enough
        pole_row = np.flatnonzero(np.abs(thetas - pole) < SAME_DEG)
        if len(pole_row) and filled[pole_row[0]].any():
            power[pole_row[0], ~filled[pole_row[0]]] = power[pole_row[0], filled[pole_row[0]]].max()
            filled[pole_row[0]] = True
    if len(thetas) < 2 or len(phis) < 2 or not filled.all():
        raise ValueError(
            f"{np.count_nonzero(~filled):,} of the {filled.size:,} directions of its {len(thetas):,} thetas and "
            f"{len(phis):,} phis are missing; give every pair of at least two of each"
        )
    order, phis = _around(phis, 360.0)
    return PatternGrid(thetas, phis, power[:, order] - power.max())


def _around(angle: Float[np.ndarray, " n"], turn: float) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """Return the order of angles of a circle, increasing within one turn, in which none of its gaps lies inside.

    All around, the first one again ends them, a turn later; of a sector the first one follows the gap.
    """
    gap = np.diff(angle, append=angle[0] + turn)
    widest, second = np.argmax(gap), np.partition(gap, -2)[-2]
    if gap[widest] <= 1.5 * second:
        return np.append(np.arange(len(angle)), 0), np.append(angle, angle[0] + turn)
    order = np.roll(np.arange(len(angle)), -(int(widest) + 1))
    return order, angle[order] + turn * (order < order[0])


def _unique_angles(angle_deg: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " level"], np.ndarray]:
    """Return the unique angles, and the index of each angle among them."""
    order = np.sort(angle_deg)
    levels = order[np.concatenate([[True], np.diff(order) > SAME_DEG])]
    index = np.clip(np.searchsorted(levels, angle_deg - SAME_DEG), 0, len(levels) - 1)
    return levels, index
