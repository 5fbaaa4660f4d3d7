"""Warnings about ground unlike what a map is made for: plants on it, and surfaces beyond the expected ground."""

from collections.abc import Iterator

import numpy as np

from sionna_radar.accuracy.truth import Comparison
from sionna_radar.mapping.mapper import Estimate
from sionna_radar.survey.preparation import Prepared

# Beams spread over a survey, and share of them, or of the lit cells, above which a warning is given.
BEAMS, FRACTION_WARNED = 1000, 0.01
# Errors over what is stated, both RMS, above which a warning is given.
TIMES_STATED_WARNED = 2.0


def expected_ground_warnings(prepared: Prepared) -> Iterator[str]:
    """Yield the warning about surfaces, such as roofs, whose echoes `processing.expected_ground` leaves out."""
    expected = prepared.plan.expected_ground
    if expected is None:
        return
    sampled = prepared.flight.sample(BEAMS)
    position_m, ahead = sampled.true.position_m, sampled.true.boresight
    distance_m = prepared.world.caster.cast(position_m, ahead).distance_m
    met = np.flatnonzero(np.isfinite(distance_m))
    place_m = position_m[met] + distance_m[met, None] * ahead[met]
    off_m = expected.above_m(place_m, sampled.measured.position_m[met])
    beyond = np.abs(off_m) > expected.tolerance_m
    if beyond.sum() > FRACTION_WARNED * len(met):
        high, low = (float(np.nanmax(sign * off_m[beyond])) for sign in (1, -1))
        most = f"up to {high:.3g} m above" if high >= low else f"up to {low:.3g} m below"
        yield (
            f"in {beyond.sum() / len(met):.0%} of the beams the surface lies beyond processing.expected_ground, {most} "
            f"it: its echoes are left out, and the DEM there is empty or that of what lies around; check the expected "
            "heights, or raise tolerance_m"
        )


def plant_warnings(prepared: Prepared, comparison: Comparison, estimate: Estimate) -> Iterator[str]:
    """Yield the warning about plants that a map of one surface takes for ground."""
    plants, sigma = prepared.world.scene.vegetation, estimate.sigma
    if plants is None or sigma is None or estimate.canopy is not None or prepared.local.sensor != "radar":
        return
    compared = comparison.lit & comparison.error.filled & sigma.filled
    among = compared & (plants.fraction_over(sigma.grid) > 0)
    if among.sum() <= FRACTION_WARNED * compared.sum():
        return
    error_m, stated_m = (np.sqrt(np.mean(each.height_m[among] ** 2)) for each in (comparison.error, sigma))
    if error_m > TIMES_STATED_WARNED * stated_m:
        yield (
            f"over [[vegetation]] the DEM is {error_m:.2g} m RMS off the ground, and `dem_sigma.tif` states "
            f"{stated_m:.2g} m: dem.method = {prepared.mapper.name!r} maps one surface, anywhere between the ground "
            "and the tops; 'canopy' maps both, where range cells are short beside the plants"
        )
