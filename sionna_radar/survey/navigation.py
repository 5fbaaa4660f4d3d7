"""The navigation that a survey is mapped with: refined by its own echoes, if its processing says so."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation
from scipy.special import ndtri

from sionna_radar.accuracy.reference import KEY, Checkpoints, read_reference
from sionna_radar.detection.echoes import Profiles
from sionna_radar.flight.build import build_stated_errors
from sionna_radar.flight.instrument import BelievedMotion, believed_motion
from sionna_radar.flight.navigation import NAMES, StatedError
from sionna_radar.flight.pulses import Pose
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
    places = None if table.reference is None else _places(table.reference, table.reference_sigma_m, mapper.grid)
    if not any(e.correlation_s > 0 for e in stated) or profiles is None or len(profiles) < FEWEST:
        return None
    motion = flown.rows(profiles.pulse)
    sightings = mapper.sightings(profiles, motion.pose)
    ranges = mean_ranges(sightings)
    echoes = RangeProfiles(sightings=sightings, motion=motion, reach=sightings.repeated(ranges.range_m))
    grid = ground_grid(reaching(mapper.grid, sightings, ranges), echoes, mapper.grid.spacing_m)
    return refine_navigation(echoes, flown, grid, stated, places)


def check_refinement(prepared: Prepared) -> None:
    """Raise ScenarioError or InputFileError, as `refined_navigation`, before a flight whose reference is of no use."""
    if prepared.refines_navigation:
        check_navigation_reference(prepared.local.processing.refined_navigation, prepared.mapper.grid)


def check_navigation_reference(table: RefinedNavigationTable, grid: Grid) -> None:
    """Raise ScenarioError or InputFileError, as `refined_navigation`, for a reference of no use on a grid."""
    if table.reference is not None:
        _places(table.reference, table.reference_sigma_m, grid)


def refined(prepared: Prepared, observed: Observed) -> RefinedNavigation | None:
    """Return the navigation of a simulated flight as its echoes refine it; None if it is reported without errors."""
    local, flight = prepared.local, prepared.flight
    if not prepared.refines_navigation or flight.navigation is None:
        return None
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


@dataclass(frozen=True, kw_only=True)
class WayError:
    """Errors of the flight's reported and refined poses, where the truth is known.

    place_m: RMS errors of the antenna's place, east, north, up, of reported and of refined poses. pointing_deg: RMS
    angles of its axes. in_68, in_95: share of the pulses' places, by axis, within the stated intervals of the refined
    poses. true: errors of the navigation by name, SI, as far as poses tell: of place (`datum_east` and so on), and of
    attitude about nose, right and down.
    """

    place_m: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]
    pointing_deg: tuple[float, float]
    in_68: Float[np.ndarray, "3"]
    in_95: Float[np.ndarray, "3"]
    true: dict[str, Float[np.ndarray, " pulse"]]

    def document(self) -> dict[str, Any]:
        """Return it as JSON holds it."""
        names = ("reported", "refined")
        return {
            **{
                name: {**dict(zip(("east_m", "north_m", "up_m"), place, strict=True)), "axes_deg": angle}
                for name, place, angle in zip(names, self.place_m, self.pointing_deg, strict=True)
            },
            "in_68": self.in_68,
            "in_95": self.in_95,
        }


def way_error(navigation: RefinedNavigation, reported: BelievedMotion, true: Pose) -> WayError:
    """Compare reported and refined poses of all pulses with the true ones."""
    poses = navigation.poses
    off, left = reported.pose.position_m - true.position_m, poses.pose.position_m - true.position_m
    turned, remaining = (
        Rotation.from_matrix(each.R_world_antenna @ true.R_world_antenna.transpose(0, 2, 1)).as_rotvec()
        for each in (reported.pose, poses.pose)
    )
    body = np.einsum("pji,pj->pi", reported.R_world_mount, turned)
    within = np.abs(left) / np.maximum(poses.sigma[:, 0], np.finfo(float).tiny)
    places, angles = NAMES[0], NAMES[2]
    return WayError(
        place_m=(np.sqrt(np.mean(off**2, axis=0)), np.sqrt(np.mean(left**2, axis=0))),
        pointing_deg=(_rms_deg(turned), _rms_deg(remaining)),
        in_68=np.mean(within < ndtri(0.84), axis=0),
        in_95=np.mean(within < ndtri(0.975), axis=0),
        true=dict(zip((*places, *angles), np.concatenate([off, body], axis=1).T, strict=True)),
    )


def _rms_deg(turned: Float[np.ndarray, "pulse 3"]) -> float:
    return float(np.rad2deg(np.sqrt(np.mean(np.sum(turned**2, axis=1)))))


def in_words(name: str) -> str:
    """Return the name of an error as sentences have it."""
    return name.replace("datum_", "position ").replace("_", " ")


def navigation_warnings(navigation: RefinedNavigation | None, asked: bool) -> tuple[str, ...]:
    """Return, and log, what a refinement of the navigation does not tell; `asked`: whether it was to be refined."""
    warnings = []
    if navigation is None:
        if asked:
            warnings.append(
                f"the navigation is not refined: that needs errors that [platform.navigation] or "
                f"[processing.refined_navigation] states, and {FEWEST} echoes"
            )
    elif not navigation.holds:
        warnings.append(
            f"the navigation is not refined: the echoes are not those of smooth bare ground, with squared residuals of "
            f"{navigation.reduced_chi2:.2f} times those of speckle; plants, walls, rough ground or another antenna may "
            "be the reason"
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
