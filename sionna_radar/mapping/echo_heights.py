"""Heights from the mean ranges of whole echoes, corrected for the beam on a slope, and smoothing surfaces through them.

The mean range of an echo is not the range on the axis of the beam. The forward model predicts it over a surface; by how
much the measured one exceeds that is by how much the ground's mean height over the footprint falls short.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import uniform_filter1d

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.numerics import MAD_SIGMA
from sionna_radar.foundation.progress import advance
from sionna_radar.foundation.raster import Grid
from sionna_radar.inference.echo.likelihood import BeamFootprints, LandCover, MeanRanges, Sightings, predicted_means
from sionna_radar.inference.terrain.covariance_fit import GROUPS
from sionna_radar.inference.terrain.heights import Heights, footprint_axes
from sionna_radar.inference.terrain.smoothing import Smoothed, TerrainModel, smooth
from sionna_radar.mapping.options import SMOOTH, SmoothParameters

MIN_SIGMA_M = 0.02
# Residual, in standard deviations, beyond which speckle alone explains no echo.
MAX_SPECKLE_SIGMAS = 6.0
# A footprint reaches so many standard deviations from its middle.
FOOTPRINT_SPREADS = 2.0


@dataclass(frozen=True)
class EchoSurface:
    """A smoothing surface through the mean ranges of whole echoes.

    heights: what the mean ranges say, one for each pulse; fits: whether each fits the surface, and was used.
    """

    smoothed: Smoothed
    heights: Heights
    fits: Bool[np.ndarray, " pulse"]

    def outstanding(self) -> Float[np.ndarray, "echo 4"]:
        """Return the echoes of other surfaces: their places, radii of their footprints, and distances from it, m."""
        heights = self.heights.rows(~self.fits)
        residual_m = np.abs(heights.height_m - self.smoothed.surface.at(*heights.place_m.T))
        other = residual_m > MAX_SPECKLE_SIGMAS * heights.sigma_m
        heights, residual_m = heights.rows(other), residual_m[other]
        return np.column_stack([heights.place_m, FOOTPRINT_SPREADS * heights.spread_m, residual_m])


def echo_surface(
    sightings: Sightings,
    echoes: MeanRanges,
    grid: Grid,
    options: SmoothParameters = SMOOTH,
) -> EchoSurface:
    """Return the most probable surface through the mean ranges of whole echoes, over a grid that reaches footprints.

    sightings, echoes: whole echoes, their measured poses, and their mean ranges.
    grid: cells of the DEM.
    options: of the method.
    """
    grid = reaching(grid, sightings, echoes)
    reach = sightings.repeated(echoes.range_m)
    if sightings.profiles.volume is not None:
        reach = np.maximum(reach, sightings.profiles.volume.echo_reach)
    surface = TerrainModel.flat(
        grid, _heights(sightings, echoes, sightings.places(echoes.range_m), reach, options).trend()
    )
    for number in range(options.rounds):
        heights, fits = heights_over(surface, sightings, echoes, reach, options)
        smoothed = smooth(
            heights.rows(fits),
            grid,
            groups=GROUPS if number == options.rounds - 1 else 1,
            window_heights=options.window_heights,
            microrelief_m=sightings.microrelief_m,
        )
        surface = smoothed.surface
        advance()
    return EchoSurface(smoothed, heights, fits)


def heights_over(
    surface: Heightfield,
    sightings: Sightings,
    echoes: MeanRanges,
    reach: Float[np.ndarray, " pulse"],
    options: SmoothParameters = SMOOTH,
) -> tuple[Heights, Bool[np.ndarray, " pulse"]]:
    """Return the mean heights over the footprints that the echoes measure, and a mask of those that fit a surface.

    surface: one near the ground, over a grid that reaches all footprints.
    sightings, echoes: whole echoes, their measured poses, and their mean ranges.
    reach: over how many pulses the speckle of each repeats.
    options: of the method.
    """
    pose = sightings.pose
    axis = pose.boresight
    read_m, feet = predicted_means(sightings, surface)
    predicted = sightings.true_m(read_m)
    on_axis = surface.first_hit(pose.position_m, axis, sightings.reach_m)
    valid = np.isfinite(predicted) & np.isfinite(on_axis)
    on_axis_m = echoes.range_m - np.where(valid, predicted - on_axis, 0.0)
    heights = _heights(sightings, echoes, pose.position_m + on_axis_m[:, None] * axis, reach, options)
    on_place_m = surface.at(*heights.place_m.T)
    if sightings.cover is not None and feet is not None:
        place_m, footprint_m = _bright_centres(sightings, sightings.cover, feet)
        place_m[~valid], footprint_m[~valid] = heights.place_m[~valid], heights.footprint_m[~valid]
        heights = replace(heights, place_m=place_m, footprint_m=footprint_m)
    mean = heights.weights(surface.grid) @ surface.height_m.ravel()
    # An echo of two surfaces has a spread as wide as they are apart: its neighbours tell what is usual.
    residual = (echoes.range_m - predicted) * np.abs(axis[:, 2]) / heights.sigma_m
    scale = max(1.0, MAD_SIGMA * float(np.median(np.abs(residual[valid])))) if valid.any() else 1.0
    fits = valid & (np.abs(np.nan_to_num(residual)) <= options.outlier_sigmas * scale)
    if fits.mean() < 0.5:
        fits = valid
    return replace(heights, height_m=heights.height_m + mean - on_place_m), fits


def _bright_centres(
    sightings: Sightings, cover: LandCover, feet: BeamFootprints
) -> tuple[Float[np.ndarray, "pulse 2"], Float[np.ndarray, "pulse 2 2"]]:
    """Return the centre of the power of each footprint over a known cover, and its axes; see `Heights`."""
    beam = sightings.beam
    power = (beam.between.T @ beam.power) * np.isfinite(feet.range_m)
    power *= cover.brightness(feet.place_m, sightings.pose.boresight)
    power /= np.maximum(power.sum(axis=1, keepdims=True), np.finfo(float).tiny)
    centre_m = np.einsum("pn,pnk->pk", power, feet.place_m)
    off_m = feet.place_m - centre_m[:, None]
    square, axis = np.linalg.eigh(np.einsum("pn,pnk,pnl->pkl", power, off_m, off_m))
    return centre_m, np.sqrt(np.maximum(square, 0.0))[..., None] * axis.transpose(0, 2, 1)


def _heights(
    sightings: Sightings,
    echoes: MeanRanges,
    point: Float[np.ndarray, "pulse 3"],
    reach: Float[np.ndarray, " pulse"],
    options: SmoothParameters,
) -> Heights:
    # Speckle makes the uncertainty that is read from one echo as uncertain, and small where the error is not.
    sigma = np.sqrt(uniform_filter1d(echoes.sigma_m**2, options.similar_pulses, mode="nearest"))
    sigma *= np.abs(sightings.pose.boresight[:, 2])
    return Heights(
        place_m=point[:, :2],
        height_m=point[:, 2],
        sigma_m=np.maximum(sigma, MIN_SIGMA_M),
        footprint_m=footprint_axes(sightings.pose, echoes.range_m, sightings.beam),
        order=sightings.profiles.pulse.astype(float),
        reach=reach,
    )


def reaching(grid: Grid, sightings: Sightings, echoes: MeanRanges) -> Grid:
    """Return the grid that covers another and all of the footprints."""
    direction = sightings.corner_directions()
    down = np.minimum(direction[..., 2], -0.1)
    drop = echoes.range_m * -sightings.pose.boresight[:, 2]
    reach = np.minimum(drop[:, None] / -down, sightings.followed_m)
    place = (sightings.pose.position_m[:, None, :2] + reach[..., None] * direction[..., :2]).reshape(-1, 2)
    (west, south), (east, north) = place.min(axis=0), place.max(axis=0)
    return Grid.covering(
        min(west, float(grid.x_m[0])),
        min(south, float(grid.y_m[0])),
        max(east, float(grid.x_m[-1])),
        max(north, float(grid.y_m[-1])),
        grid.spacing_m,
        (grid.west_m, grid.south_m),
    )
