"""Geolocation of echoes: points in the world frame from ranges, directions and measured poses."""

from dataclasses import dataclass, fields
from hashlib import sha256
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.detection.echoes import Echoes
from sionna_radar.flight.frames import MIN_GRAZING_SINE
from sionna_radar.flight.pulses import Pose, rows_of
from sionna_radar.foundation.columns import Columns
from sionna_radar.inference.terrain.heights import supported_directions

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, kw_only=True)
class Points(Columns):
    """Located echoes, one row each, in the order of the echoes.

    pulse, number: index of the pulse, and of the echo in it.
    position_m: world frame (local ENU), shape (point, 3).
    origin_m: where the radar was, as measured, shape (point, 3).
    range_m, range_sigma_m: slant range and its standard deviation.
    power, echo_snr_db: of the echo's strongest cell; see `Echoes`.
    across_sigma_m: standard deviation of the position across the ray, in its vertical plane; None for echoes placed on
        the beam's axis.
    reach: over how many pulses errors of the range repeat; see `Echoes`.
    shared_sigma_m: standard deviation of a range error that all points behind a volume share; None in clear air.
    ground_probability: that it is of the ground and not of plants on it; None where no map tells.

    Examples
    --------
    >>> points = run(load_scenario("hills", {"platform.length_m": 10.0})).points
    >>> points.position_m.shape == (len(points), 3)
    True
    """

    pulse: Int[np.ndarray, " point"]
    number: Int[np.ndarray, " point"]
    position_m: Float[np.ndarray, "point 3"]
    origin_m: Float[np.ndarray, "point 3"]
    range_m: Float[np.ndarray, " point"]
    range_sigma_m: Float[np.ndarray, " point"]
    power: Float[np.ndarray, " point"]
    echo_snr_db: Float[np.ndarray, " point"]
    across_sigma_m: Float[np.ndarray, " point"] | None = None
    reach: Float[np.ndarray, " point"] | None = None
    shared_sigma_m: Float[np.ndarray, " point"] | None = None
    ground_probability: Float[np.ndarray, " point"] | None = None

    @property
    def shared_height_sigma_m(self) -> float:
        """Standard deviation of an error that all heights share: of ranges behind a volume such as rain, median."""
        if self.shared_sigma_m is None or len(self) == 0:
            return 0.0
        return float(np.median(self.shared_sigma_m * self.steepness))

    @property
    def steepness(self) -> Float[np.ndarray, " point"]:
        """Change of each point's height with its range, as a positive number."""
        return np.abs(self.position_m - self.origin_m)[:, 2] / np.maximum(self.range_m, 1e-9)

    def to_dataframe(self) -> "DataFrame":
        """Return the points as a `pandas.DataFrame`, one row each; needs the extra `arrays`.

        Columns are those of the table, without those that it lacks; positions become `x_m`, `y_m`, `z_m`, and
        `origin_x_m` and so on, east, north and up of the local origin.
        """
        from pandas import DataFrame

        columns = {f.name: getattr(self, f.name) for f in fields(self)}
        for name, prefix in (("position_m", ""), ("origin_m", "origin_")):
            columns |= dict(zip((f"{prefix}{axis}_m" for axis in "xyz"), columns.pop(name).T, strict=True))
        return DataFrame({name: column for name, column in columns.items() if column is not None})

    @property
    def spread_by_noise(self) -> bool:
        """Whether noise of their ranges, and not where the beams pointed, spreads them beside a line.

        Such echoes of a beam that looks aside and does not scan are a profile: a surface between them follows the beam.
        """
        if len(self) < 3:
            return False
        along = self.position_m - self.origin_m
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
        # Where each direction meets level ground.
        down = np.maximum(-along[:, 2], MIN_GRAZING_SINE)
        clearance_m = np.median(self.origin_m[:, 2] - self.position_m[:, 2])
        place_m = self.origin_m[:, :2] + (clearance_m / down)[:, None] * along[:, :2]
        width_m = np.linalg.svd(place_m - place_m.mean(axis=0), compute_uv=False)[1]
        noise_m = np.linalg.norm(self.range_sigma_m * np.hypot(*along[:, :2].T))
        on_a_line = supported_directions(self.position_m[:, :2]).shape[1] < 2
        return bool(width_m <= noise_m) and not on_a_line

    def sha256(self) -> str:
        """Return a digest of the float64 positions, ranges, powers and SNRs."""
        digest = sha256()
        for column in (self.position_m, self.range_m, self.power, self.echo_snr_db):
            digest.update(np.ascontiguousarray(column, dtype="<f8").tobytes())
        return digest.hexdigest()


def locate(echoes: Echoes, pulse: Int[np.ndarray, " pulse"], measured: Pose) -> Points:
    """Place echoes on the beam axis, or in the directions that were measured.

    Parameters
    ----------
    echoes:
        Echoes of a block of pulses.
    pulse:
        Sorted indices of the block's pulses.
    measured:
        Their poses as the navigation system reports them.

    Returns
    -------
    Points in the world frame, in the order of the echoes.
    """
    row = rows_of(pulse, echoes.pulse)
    origin = measured.position_m[row]
    toward = measured.boresight[row]
    if echoes.direction is not None:
        toward = np.einsum("eij,ej->ei", measured.R_world_antenna[row], echoes.direction)
    return Points(
        pulse=echoes.pulse,
        number=echoes.number,
        position_m=origin + echoes.range_m[:, None] * toward,
        origin_m=origin,
        range_m=echoes.range_m,
        range_sigma_m=echoes.range_sigma_m,
        power=echoes.power,
        echo_snr_db=echoes.echo_snr_db,
        across_sigma_m=None if echoes.across_sigma_rad is None else echoes.range_m * echoes.across_sigma_rad,
        reach=echoes.reach,
        shared_sigma_m=echoes.shared_sigma_m,
    )
