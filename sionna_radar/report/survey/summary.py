"""The numbers of a survey, as one JSON document."""

from dataclasses import asdict
from typing import Any

from pyproj import CRS

from sionna_radar.accuracy.compare import MEANING as ERROR_MEANING
from sionna_radar.foundation.georeference import Georeference
from sionna_radar.foundation.versions import versions
from sionna_radar.report.folder import strict_json, without_nan
from sionna_radar.survey.result import Survey

MEANING = {
    "replaced": "parts of the scenario that were replaced from Python, and what replaced them",
    "crs": "that of the map coordinates; local where the ground is on no map",
    "flight_log": "the recorded flight: its sources and rates, and what was done to fly it; null for a planned one",
    "georeference": "map coordinates are local ones plus the origin; null if the scene is not georeferenced",
    "convergence_deg": "true azimuth of grid north at the origin: add it to a heading to refer it to true north",
    "dem_error": "all cells that the DEM fills",
    "lit_error": "those of them that the main beam reached",
    "off_wall_error": "lit cells farther than half a footprint from any wall; null where there are no walls",
    "canopy": "the DEM in filled cells under [[vegetation]]: share is its mean height over the ground over that of the "
    "plants, 0 where it reads the ground and 1 where it reads their tops",
    "overhang": "DEM cells with air between two surfaces, as under a bridge, where the truth is the highest, and "
    "the largest places of them by their extents (west, south, east, north) in local metres; null "
    "without objects and without a mesh as terrain",
    "coverage": "share of the lit cells that the DEM fills",
    **ERROR_MEANING,
    "no_echo": "lit cells that the DEM leaves empty and pulses without any echo looked at, as over calm water, and "
    "their share of the lit cells",
    "receiver": "pulses, and samples of all pulses, that exceed the full scale of the converter; null without one",
    "breakdown": "where lit cells err: checkpoints (vertical test of ASPRS 2023), classes of the true slope, of the "
    "incidence angle on the true surface and of the distance from the nearest wall (low to high, null: without end), "
    "and the variogram (semivariance_m2 by Matheron, robust_m2 by Dowd)",
    "dem_uncertainty": "lit cells' errors over their stated standard deviations (dem_sigma.tif): the share of cells in "
    "the intervals of 50, 68, 90 and 95 %, NMAD, RMS and mean of z = error / sigma, by classes of the true slope and "
    "of the distance from the nearest echo; means: mean errors over windows against the standard deviations stated for "
    "them; null for a method that states none",
}


def summary(survey: Survey) -> dict[str, Any]:
    """Return what was simulated, and how accurate the DEM is: the same for the same scenario and seed.

    Every value has a strict JSON form: a number that does not exist (the RMS of no cells) is None.
    """
    document = {
        "scenario": survey.scenario.model_dump(mode="json"),
        "replaced": survey.replaced,
        "warnings": survey.warnings,
        "seed": survey.scenario.seed,
        "crs": crs_name(survey.georeference),
        "georeference": georeference(survey.georeference),
        "flight_log": survey.prepared.flown.record,
        "engine": survey.scenario.tracing.engine,
        "pulses": survey.pulses,
        "paths": survey.paths,
        "echoes": len(survey.points),
        "receiver": asdict(survey.saturation) if survey.saturation else None,
        "dem_error": asdict(survey.dem_error),
        "lit_error": asdict(survey.lit_error),
        "off_wall_error": asdict(survey.off_wall_error) if survey.off_wall_error else None,
        "breakdown": asdict(survey.breakdown),
        "dem_uncertainty": asdict(survey.dem_uncertainty) if survey.dem_uncertainty else None,
        "overhang": asdict(survey.overhang) if survey.overhang else None,
        "canopy": asdict(survey.canopy_reading) if survey.canopy_reading else None,
        "no_echo": _no_echo(survey),
        "meaning": MEANING,
        "points_sha256": survey.points.sha256(),
        "versions": versions(),
    }
    return without_nan(document)


def _no_echo(survey: Survey) -> dict[str, Any] | None:
    if survey.no_echo is None:
        return None
    cells = int(survey.no_echo.sum())
    return {"cells": cells, "share": cells / max(int(survey.lit.sum()), 1)}


def georeference(place: Georeference | None) -> dict[str, Any] | None:
    """Return the georeference of the local frame: map coordinates are local ones plus the origin."""
    if place is None:
        return None
    crs = CRS.from_wkt(place.crs_wkt)
    horizontal, vertical = crs.sub_crs_list if crs.is_compound else (crs.to_2d(), None)
    east_m, north_m, height_m = place.origin_m
    return {
        "horizontal_crs": _named(horizontal),
        "vertical_crs": _named(vertical) if vertical else None,
        "crs_wkt": place.crs_wkt,
        "origin": {"easting_m": east_m, "northing_m": north_m, "height_m": height_m},
        "horizontal_datum": _datum(horizontal),
        "vertical_datum": _datum(vertical) if vertical else "ellipsoid" if len(crs.axis_info) == 3 else None,
        "units": "m",
        "headings": "clockwise from grid north",
        "convergence_deg": place.convergence_deg,
    }


def crs_name(place: Georeference | None) -> str:
    """Return the CRS of the map coordinates in a few letters, "local" for ground that is on no map."""
    if place is None:
        return "local"
    crs = CRS.from_wkt(place.crs_wkt)
    return " + ".join(_named(part) for part in crs.sub_crs_list) if crs.is_compound else _named(crs)


def _named(crs: CRS) -> str:
    return ":".join(crs.to_authority() or (crs.name,))


def _datum(crs: CRS) -> str:
    described = crs.geodetic_crs or crs
    return str(described.datum.name) if described.datum else str(described.name)


def summary_json(survey: Survey) -> str:
    """Return the summary as strict JSON text."""
    return strict_json(summary(survey))
