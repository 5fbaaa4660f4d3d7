"""The navigation that a survey is mapped with: refined by its own echoes, if its processing says so."""

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sionna_radar.accuracy.reference import KEY, Checkpoints, read_reference
from sionna_radar.detection.echoes import Profiles
from sionna_radar.flight.build import build_stated_errors
from sionna_radar.flight.instrument import BelievedMotion, believed_motion
from sionna_radar.flight.navigation import StatedError
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.progress import stage
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.stopwatch import timed
from sionna_radar.inference.echo.likelihood import mean_ranges
from sionna_radar.mapping.echo_heights import reaching
from sionna_radar.mapping.mapper import Mapper
from sionna_radar.mapping.navigation.echo_errors import RangeProfiles
from sionna_radar.mapping.navigation.joint import MeasuredPlaces, ground_grid
from sionna_radar.mapping.navigation.refinement import STEPS, RefinedNavigation, refine_navigation
from sionna_radar.scenario.processing import RefinedNavigationTable
from sionna_radar.survey.observation import Observed
from sionna_radar.survey.preparation import Prepared

logger = logging.getLogger("sionna_radar")

# Echoes without which nothing is estimated.
FEWEST = 200


def refined_navigation(
    table: RefinedNavigationTable,
    profiles: Profiles | None,
    flown: BelievedMotion,
    mapper: Mapper,
    stated: Sequence[StatedError],
) -> RefinedNavigation | None:
    """Return the navigation of a flight as its echoes refine it; None if nothing errs, or there are too few echoes.

    profiles: whole echoes. flown: the reported motion of all pulses. stated: the errors' priors.

    Raises
    ------
    ScenarioError
        The reference has no standard deviation.
    InputFileError
        The reference is no file of heights, or lies elsewhere.
    """
    if not any(e.correlation_s > 0 for e in stated) or profiles is None or len(profiles) < FEWEST:
        return None
    motion = flown.rows(profiles.pulse)
    sightings = mapper.sightings(profiles, motion.pose)
    ranges = mean_ranges(sightings)
    echoes = RangeProfiles(sightings=sightings, motion=motion, reach=sightings.repeated(ranges.range_m))
    grid = ground_grid(reaching(mapper.grid, sightings, ranges), echoes, mapper.grid.spacing_m)
    places = None if table.reference is None else _places(table.reference, table.reference_sigma_m, mapper.grid)
    return refine_navigation(echoes, flown, grid, stated, places)


def refined(prepared: Prepared, observed: Observed) -> RefinedNavigation | None:
    """Return the navigation of a simulated flight as its echoes refine it; None if its processing does not."""
    if not prepared.refines_navigation:
        return None
    local, flight = prepared.local, prepared.flight
    stated = build_stated_errors(local.processing.refined_navigation, local.platform.navigation, flight.navigation)
    flown = believed_motion(flight.pulses(np.arange(len(flight))), flight.scan)
    with stage("refining the navigation", STEPS), timed("navigation"):
        return refined_navigation(
            local.processing.refined_navigation, observed.profiles, flown, prepared.mapper, stated
        )


def with_refined(prepared: Prepared, navigation: RefinedNavigation | None) -> Prepared:
    """Return a survey that is mapped with its refined navigation, where there is one that holds."""
    return prepared.with_navigation(navigation.poses) if navigation is not None and navigation.holds else prepared


def _places(path: Path, sigma_m: float | None, grid: Grid) -> MeasuredPlaces:
    """Return the heights of a reference: of its own places, or of cells as large as its own."""
    try:
        known = read_reference(path, grid, sigma_m or 0.0)
    except InputFileError as error:
        raise InputFileError(str(error).replace(f"{KEY} =", "processing.refined_navigation.reference =", 1)) from error
    if isinstance(known, Checkpoints):
        place_m, height_m, sigma = known.place_m, known.height_m, known.sigma_m
    else:
        surface = known.on(known.own_cells(grid))
        place_m, height_m = surface.grid.centres_m[surface.filled.ravel()], surface.height_m[surface.filled]
        sigma = np.full(len(height_m), known.sigma_m)
    if not (sigma > 0).all():
        message = "missing; the reference does not state how well its heights are known"
        raise ScenarioError.of("processing.refined_navigation.reference_sigma_m", message)
    return MeasuredPlaces(place_m=place_m, height_m=height_m, sigma_m=sigma)


def in_words(name: str) -> str:
    """Return the name of an error as sentences have it."""
    return name.replace("datum_", "position ").replace("_", " ")


def navigation_warnings(navigation: RefinedNavigation | None) -> tuple[str, ...]:
    """Return, and log, what a refinement of the navigation does not tell."""
    if navigation is None:
        return ()
    warnings = []
    if not navigation.holds:
        warnings.append(
            f"the navigation is not refined: the echoes are not those of bare ground, with squared residuals of "
            f"{navigation.reduced_chi2:.2f} times those of speckle; plants, walls or another antenna may be the reason"
        )
    elif hidden := [
        in_words(name) for name, seen in zip(navigation.names, navigation.observable, strict=True) if not seen
    ]:
        warnings.append(
            f"the echoes tell little of the errors of {', '.join(hidden)}: their standard deviations stay above a "
            "third of those stated; lines that cross or overlap more, or a reference, may tell"
        )
    for warning in warnings:
        logger.warning("%s", warning)
    return tuple(warnings)
