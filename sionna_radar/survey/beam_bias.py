"""Beam bias of a survey: mean range of the echo minus the range on the beam's axis, over the ground that it sees.

An echo placed on the beam's axis by its mean range is too near or too far where the ground slopes within the footprint:
level ground at a slant is met by the nearer half of the beam first, and with more power. A map that places its echoes
so inherits the bias; one that models the whole echo (`smooth`, `refined`, `stepped`) has to take it out.
"""

import logging
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sionna_radar.accuracy.illumination import Walls
from sionna_radar.flight.pulses import PulseSchedule
from sionna_radar.flight.scan import RotatingScan, SideLookingScan
from sionna_radar.foundation.raster import Raster
from sionna_radar.inference.echo.beam import BeamNodes, beam_samples
from sionna_radar.scene.build import World

logger = logging.getLogger("sionna_radar")

# Beams spread over a survey, and rays across the main lobe of each.
BEAMS, RAYS = 200, 200


@dataclass(frozen=True)
class BeamBias:
    """Biases of beams, by which echoes of mean range on the axis lie too high.

    place_m: where axes meet the scene. reach_m: how far from there the main lobe meets it, in plan view.
    """

    place_m: Float[np.ndarray, "beam 2"]
    height_m: Float[np.ndarray, " beam"]
    reach_m: Float[np.ndarray, " beam"]

    def off_walls(self, walls: Walls) -> "BeamBias":
        """Return those of beams that meet no wall."""
        if not walls or not len(self.height_m):
            return self
        off = ~walls.near(self.place_m, self.reach_m)
        return BeamBias(place_m=self.place_m[off], height_m=self.height_m[off], reach_m=self.reach_m[off])

    @property
    def typical_m(self) -> float:
        """Median size; 0 of no beam."""
        return float(np.median(np.abs(self.height_m))) if len(self.height_m) else 0.0


def beam_bias(schedule: PulseSchedule, world: World, beam: BeamNodes) -> BeamBias:
    """Return the biases of beams spread over a survey, over ground of one gamma = sigma0 / cos(incidence).

    Rays weigh by the two-way gain over the square of the range: a ray of the solid angle dw meets r^2 dw / cos(theta)
    of ground, which returns sigma0 over r^4.
    """
    pose = schedule.sample(BEAMS).true
    inner, weight = beam_samples(beam, RAYS)
    direction = np.einsum("pij,kj->pki", pose.R_world_antenna, inner).reshape(-1, 3)
    hits = world.caster.cast(np.repeat(pose.position_m, len(inner), axis=0), direction)
    met = np.isfinite(hits.distance_m).reshape(len(pose), -1)
    range_m = np.where(met, hits.distance_m.reshape(met.shape), 1.0)
    power = np.where(met, weight / range_m**2, 0.0)
    total = power.sum(axis=1)
    axis_m = world.caster.cast(pose.position_m, pose.boresight).distance_m
    lit = np.isfinite(axis_m) & (total > 0)
    mean_m = (power * range_m).sum(axis=1)[lit] / total[lit]
    ahead = pose.boresight[lit]
    place_m = (pose.position_m[lit] + axis_m[lit, None] * ahead)[:, :2]
    direction = direction.reshape(len(pose), -1, 3)[lit]
    met_m = pose.position_m[lit, None, :2] + range_m[lit, :, None] * direction[..., :2]
    distance_m = np.linalg.norm(met_m - place_m[:, None], axis=2)
    return BeamBias(
        place_m=place_m,
        height_m=(axis_m[lit] - mean_m) * -ahead[:, 2],
        reach_m=np.where(met[lit], distance_m, 0.0).max(axis=1),
    )


def maps_by_turning(schedule: PulseSchedule) -> bool:
    """Whether the beam turns, so that its echoes make a map and not a line, or an image."""
    scan = schedule.scan
    return not isinstance(scan, SideLookingScan) and not (isinstance(scan, RotatingScan) and scan.rotation_rad_s == 0)


def warn_of_wide_beam(bias: BeamBias, spacing_m: float, beamwidths_rad: tuple[float, float]) -> None:
    """Warn of a beam whose bias exceeds a cell of the DEM."""
    if bias.typical_m > spacing_m:
        wide, high = np.rad2deg(beamwidths_rad)
        logger.warning(
            "radar.antenna: the beam of %.3g by %.3g deg is too wide for this flight: the mean range of an echo is "
            "that of ground %.2g m off the height on the beam's axis (median; %+.2g m in the mean), more than a cell "
            "of the DEM (%.3g m); narrow the beam, fly lower, or lower radar.scan.incidence_deg",
            wide,
            high,
            bias.typical_m,
            float(bias.height_m.mean()),
            spacing_m,
        )


def unmodelled_bias_warnings(
    bias: BeamBias, sigma: Raster | None, remedy: str = "dem.method = 'refined'"
) -> Iterator[str]:
    """Yield the warning about a map that places echoes on the beam's axis, and states less than the bias of that.

    remedy: settings that model the beam.
    """
    if sigma is None or not len(bias.height_m):
        return
    row, column, inside = sigma.grid.cell_of(bias.place_m)
    stated_m = np.where(inside, sigma.height_m[row, column], np.nan)
    has_sigma = np.isfinite(stated_m)
    if not has_sigma.any():
        return
    bias_m, sigma_m = (float(np.sqrt(np.mean(values_m[has_sigma] ** 2))) for values_m in (bias.height_m, stated_m))
    if bias_m > sigma_m:
        yield (
            f"the beam biases heights by {bias_m:.2g} m RMS on the slopes that it sees, and `dem_sigma.tif` states "
            f"{sigma_m:.2g} m: this method places echoes on the beam's axis; set {remedy}, or narrow the beam"
        )
