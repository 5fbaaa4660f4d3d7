"""The numbers of a survey: one JSON document, the reference paper's values, and a table for the terminal.

Flights like those of the reference paper are compared with its results: Rouveure et al. 2017, Table 3 and Fig. 14.
"""

from dataclasses import asdict
from typing import Any

import numpy as np
from pyproj import CRS
from rich.table import Table

from sionna_radar.accuracy.compare import MEANING as ERROR_MEANING
from sionna_radar.accuracy.compare import DemError
from sionna_radar.execution.workers import versions
from sionna_radar.foundation.raster import Georeference
from sionna_radar.report.files.contents import jsonable
from sionna_radar.report.survey.navigation import MEANING as NAVIGATION_MEANING
from sionna_radar.report.survey.navigation import navigation_document, navigation_rows
from sionna_radar.report.survey.obstacles import MEANING as OBSTACLES_MEANING
from sionna_radar.report.survey.obstacles import obstacle_rows, obstacles_document
from sionna_radar.report.terminal import reference_rows, table_of_values
from sionna_radar.scenario import Scenario
from sionna_radar.survey.preparation import Prepared
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
    "canopy_check": "the two surfaces of dem.method = 'canopy' over lit cells: ground under plants, by the share of a "
    "cell that they cover; bare: farther than a footprint from them; height: of plants, against their mean in a cell; "
    "missed, invented: shares of the cells with plants, and of bare ones, that are mapped as the other; precision, "
    "recall and F1 of the points taken for ground; null for other methods",
    "overhang": "DEM cells with air between two surfaces, as under a bridge, where the truth is the highest, and "
    "the largest places of them by their extents (west, south, east, north) in local metres; null "
    "without objects and without a mesh as terrain",
    "coverage": "share of the lit cells that the DEM fills",
    "mapped": "mapped_m2: area of the lit cells that the DEM fills; mapped_swath_m: that area over the way flown; "
    "coverage_of_swath: share of the cells of the planned swath that are lit and filled, of all ground that the beam "
    "would meet if it looked at every angle of its sector from every place of its track",
    **ERROR_MEANING,
    "no_echo": "lit cells that the DEM leaves empty and pulses without any echo looked at, as over calm water, and "
    "their share of the lit cells",
    "readings": "of a beam that does not scan and makes no map: readings minus the height above ground (along: "
    "vertical), or minus the distance along the beam's axis (axis): bias, standard deviation and 95th percentile of "
    "|error|, by cover; drop_outs: pulses without a reading; latency_s: the lag of least squares behind the true "
    "heights; lowest_clearance_m: over what stands straight below; by_readings_m: that of the same flight steered by "
    "these readings (platform.height = 'sensed'); null for other surveys",
    "obstacles": OBSTACLES_MEANING,
    "navigation": NAVIGATION_MEANING,
    "receiver": "pulses, and samples of all pulses, that exceed the full scale of the converter; null without one",
    "breakdown": "where lit cells err: checkpoints (vertical test of ASPRS 2023), classes of the true slope, of the "
    "incidence angle on the true surface and of the distance from the nearest wall (low to high, null: without end), "
    "covers by name, and the variogram (semivariance_m2 by Matheron, robust_m2 by Dowd)",
    "reference": "the DEM against the measured heights of --reference: the shift of the DEM against them with standard "
    "deviations (sigma), whether it was applied, statistics, breakdown, and errors over the standard deviations of "
    "both; null without",
    "dem_uncertainty": "lit cells' errors over their stated standard deviations (dem_sigma.tif): the share of cells in "
    "the intervals of 50, 68, 90 and 95 %, NMAD, RMS and mean of z = error / sigma, by classes of the true slope and "
    "of the distance from the nearest echo; means: mean errors over windows against the standard deviations stated for "
    "them; null for a method that states none",
}


def summary(survey: Survey) -> dict[str, Any]:
    """Return the settings, counts and DEM errors of a survey, reproducible and as strict JSON: None for no number."""
    unheard = None if survey.no_echo is None else int(survey.no_echo.sum())
    document = {
        "scenario": survey.scenario.model_dump(mode="json"),
        "replaced": survey.replaced,
        "warnings": survey.warnings,
        "seed": survey.scenario.seed,
        "crs": crs_name(survey.georeference),
        "georeference": georeference(survey.georeference),
        "flight_log": survey.prepared.plan.flown.record,
        "engine": survey.scenario.tracing.engine,
        "pulses": survey.pulses,
        "paths": survey.paths,
        "echoes": len(survey.points),
        "readings": survey.readings.document() if survey.readings else None,
        "receiver": asdict(survey.saturation) if survey.saturation else None,
        "dem_error": asdict(survey.dem_error),
        "lit_error": asdict(survey.lit_error),
        "off_wall_error": asdict(survey.off_wall_error) if survey.off_wall_error else None,
        "mapped": asdict(survey.mapped),
        "breakdown": asdict(survey.breakdown),
        "dem_uncertainty": asdict(survey.dem_uncertainty) if survey.dem_uncertainty else None,
        "reference": survey.reference.document() if survey.reference else None,
        "overhang": asdict(survey.overhang) if survey.overhang else None,
        "canopy": asdict(survey.canopy_reading) if survey.canopy_reading else None,
        "canopy_check": asdict(survey.canopy_check) if survey.canopy_check else None,
        "obstacles": None if survey.obstacles is None else obstacles_document(survey.obstacles),
        "navigation": None if survey.navigation is None else navigation_document(survey.navigation, survey.way_error),
        "no_echo": unheard if unheard is None else {"cells": unheard, "share": unheard / max(int(survey.lit.sum()), 1)},
        "meaning": MEANING,
        "points_sha256": survey.points.sha256(),
        "versions": versions(),
    }
    return dict(jsonable(document))


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
    """Return a short name of the map coordinates' CRS; "local" without a georeference."""
    if place is None:
        return "local"
    crs = CRS.from_wkt(place.crs_wkt)
    return " + ".join(_named(part) for part in crs.sub_crs_list) if crs.is_compound else _named(crs)


def _named(crs: CRS) -> str:
    return ":".join(crs.to_authority() or (crs.name,))


def _datum(crs: CRS) -> str:
    described = crs.geodetic_crs or crs
    return str(described.datum.name) if described.datum else str(described.name)


CITATION = (
    'Rouveure, Tourrette, Jaud, Faure, Monod, "Design of lightweight airborne MMW radar for DEM generation. Simulation '
    'results", Robotics and Autonomous Systems 96 (2017) 26-40'
)
# Beamwidth (deg): minimum, maximum, standard deviation, mean, RMS (m).
TABLE_3 = {
    1.0: (-1.24, 1.04, 0.18, -0.12, 0.22),
    2.0: (-2.65, 2.24, 0.25, -0.15, 0.29),
    4.0: (-6.52, 5.19, 0.64, -0.24, 0.69),
    8.0: (-16.28, 10.73, 1.93, -0.66, 2.04),
}
BUILDINGS_RMS_M, OFF_EDGES_RMS_M, BUILDINGS_BEAM_DEG = 1.51, 0.19, 2.0
# Relative tolerance of height, speed, tilt and radar parameters for a comparison with the paper.
ALIKE = 0.1


def reference_for(prepared: Prepared) -> tuple[dict[str, dict[str, float]], str]:
    """Return the paper's errors (m) by subject and by field of `DemError`, and their conditions; empty if unlike."""
    if not _flown_alike(prepared):
        return {}, ""
    scenario = prepared.scenario
    beam = float(np.rad2deg(np.mean(prepared.instrument.antenna.beamwidths_rad)))
    over_buildings = scenario.buildings and scenario.terrain.kind == "flat"
    if over_buildings and abs(beam - BUILDINGS_BEAM_DEG) < 0.05 * BUILDINGS_BEAM_DEG:
        rows = {
            "Paper, Fig. 14: buildings on flat ground": {"rms_m": BUILDINGS_RMS_M},
            "Paper, Fig. 14, points near edges left out": {"rms_m": OFF_EDGES_RMS_M},
        }
        return rows, _conditions("boxes on flat ground, a beam of 2 deg")
    width = next((w for w in TABLE_3 if abs(beam - w) < 0.05 * w), None)
    if scenario.terrain.kind == "hills" and width is not None:
        errors = dict(zip(("min_m", "max_m", "std_m", "mean_m", "rms_m"), TABLE_3[width], strict=True))
        return {f"Paper, Table 3: {width:g} deg": errors}, _conditions(f"rolling hills, a beam of {width:g} deg")
    return {}, ""


def _flown_alike(prepared: Prepared) -> bool:
    """Return True if radar, height, speed and tilt are like the paper's, in clear air and with the exact pose."""
    scenario, radar, scan = prepared.scenario, prepared.scenario.radar, prepared.scenario.radar.scan
    tilt_deg = float(np.rad2deg(prepared.flight.scan.incidence_rad))
    flown = {
        (prepared.plan.flown.altitude_m, 50.0),
        (prepared.plan.flown.speed_mps, 10.0),
        (tilt_deg, 45.0),
        (radar.carrier_hz, 77e9),
        (radar.bandwidth_hz, 500e6),
        (radar.chirp_rate_hz, 360.0),
        (getattr(scan, "rotation_rpm", 0.0), 120.0),
        (radar.snr_db or 0.0, 30.0),
    }
    similar = all(abs(value - nominal) <= ALIKE * nominal for value, nominal in flown)
    replaced = prepared.custom.described()
    return (
        similar
        and scenario.sensor == "radar"
        and scan.mode == "whisk_broom"
        and not scenario.weather.falling
        and scenario.radar.sweep != "triangular"
        and prepared.flight.navigation is None
        and not replaced
    )


def _conditions(setup: str) -> str:
    return (
        f"The paper ({CITATION}) flew {setup}: 77 GHz, 500 MHz of sweep, 360 chirps/s, 120 rpm, from 50 m at 10 m/s, "
        "tilted by 45 deg, 30 dB SNR, pose known exactly, each echo at the strongest bin of the spectrum and on the "
        "beam axis, linear interpolation. Its ground is not published: sizes and trends compare, single numbers do not."
    )


# Ratio of RMS errors of `refined` and `linear`: minimum and maximum over ten lidar DEMs (docs/theory/maps.md).
REFINED_OVER_LINEAR = 0.47, 0.85
# Largest number of echoes of a chirp whose ranges are printed.
FEW_ECHOES = 4


def survey_table(survey: Survey) -> Table:
    """Return the table of a survey: flight, DEM errors and run time."""
    accuracy = _errors(survey) if survey.readings is None else survey.readings.described()
    return table_of_values(survey.scenario.description or None, _flown(survey) | accuracy | _notes(survey))


def _flown(survey: Survey) -> dict[str, str]:
    rows = {"pulses / paths / echoes": f"{survey.pulses:,} / {survey.paths:,} / {len(survey.points):,}"}
    if survey.chirp is not None and survey.scenario.processing.echoes == "all":
        detected_m = survey.points.range_m[survey.points.pulse == survey.chirp.pulse]
        if len(detected_m) <= FEW_ECHOES:
            ranges = ", ".join(f"{range_m:.2f} m" for range_m in detected_m) or "none"
            rows[f"ranges in pulse {survey.chirp.pulse}"] = ranges
    return rows


def better_map(scenario: Scenario, lit: DemError, off_wall: DemError | None) -> str:
    """Return the words for the smaller error of "refined" over ground without walls in clear air; "" elsewhere."""
    whole_echoes = scenario.sensor == "radar" and scenario.processing.angle == "off"
    applies = (
        whole_echoes
        and scenario.radar.sweep != "triangular"
        and scenario.processing.average.chirps == 1
        and scenario.dem.map_method == "linear"
        and off_wall is None
        and not scenario.weather.falling
        and lit.count > 0
    )
    low, high = REFINED_OVER_LINEAR
    cut = f"{100 * (1 - high):.0f} to {100 * (1 - low):.0f} %"
    return f"dem.method = 'refined' typically cuts this error by {cut}" if applies else ""


def _errors(survey: Survey) -> dict[str, str]:
    lit, off_wall = survey.lit_error, survey.off_wall_error
    rows = {"lit cells filled": f"{lit.count:,}, coverage {lit.coverage:.1%} of lit cells"}
    mapped = survey.mapped
    if np.isfinite(mapped.coverage_of_swath):
        rows["planned swath filled"] = f"{mapped.coverage_of_swath:.1%}; {mapped.mapped_m2:,.0f} m2 mapped"
    if lit.count and off_wall is not None:
        # Some dozen cells on the wrong side of a wall decide the RMSE; they say more by their number.
        rows["NMAD, LE90, cells over 1 m"] = f"{lit.nmad_m:.3f} m, {lit.le90_m:.3f} m, {lit.over_1m:.2%}"
    if lit.count:
        rows |= {
            "RMSE of lit cells": f"{lit.rms_m:.3f} m",
            "bias, STD, NMAD": f"{lit.mean_m:+.3f} m, {lit.std_m:.3f} m, {lit.nmad_m:.3f} m",
            "LE68, 90, 95: percentiles of |error|": f"{lit.le68_m:.3f} m, {lit.le90_m:.3f} m, {lit.le95_m:.3f} m",
            "least, greatest": f"{lit.min_m:+.2f} m, {lit.max_m:+.2f} m",
        }
    if off_wall is not None and off_wall.count:
        rows["RMSE of lit cells off walls"] = f"{off_wall.rms_m:.3f} m"
    if survey.dem_uncertainty is not None:
        shares = survey.dem_uncertainty.cells.coverage
        rows["in stated 68, 90, 95 % intervals"] = ", ".join(f"{shares[p]:.0%}" for p in ("68", "90", "95"))
    test = survey.breakdown.checkpoints
    if test.class_cm is not None:
        rows["ASPRS 2023"] = f"{test.class_cm}-cm class at {test.count} checkpoints on {test.where}"
    return rows


def _notes(survey: Survey) -> dict[str, str]:
    rows = {f"{key} replaced by": part for key, part in survey.replaced.items()}
    rows |= navigation_rows(survey.navigation, survey.way_error)
    better = better_map(survey.prepared.local, survey.lit_error, survey.off_wall_error)
    if better and "dem.method" not in survey.replaced:
        rows["hint"] = better
    if survey.overhang is not None and survey.overhang.cells:
        over = survey.overhang
        west, south, east, north = over.places[0].extent_m
        location = f"most at {west:.0f} to {east:.0f} m east, {south:.0f} to {north:.0f} m north"
        rows["cells under an overhang"] = (
            f"{over.cells:,} ({over.share:.1%}), {location}; the truth is the highest surface"
        )
    reading, check = survey.canopy_reading, survey.canopy_check
    if check is not None:
        covers = (f"{each.rms_m:.2f} m {cover} of it" for cover, each in check.ground.items() if each.count)
        if text := ", ".join(covers):
            rows["ground under plants"] = f"RMSE {text}"
        if check.height.count:
            rows["plants"] = f"height to {check.height.rms_m:.2f} m RMS in {check.height.count:,} cells"
        if check.bare.count:
            rows["plants on bare ground"] = f"in {check.invented:.2%} of {check.bare.count:,} cells"
        told = f"F1 {check.f1:.3f} (precision {check.precision:.3f}, recall {check.recall:.3f})"
        # Without points taken for ground, or of it, one of these has no value.
        rows["points of the ground"] = told.replace("nan", "-") if check.f1 >= 0 else "none, and none are taken for it"
    elif reading is not None and reading.count:
        rows["among plants"] = (
            f"{reading.above_ground_m:+.2f} m over the ground in {reading.count:,} cells, "
            f"{reading.share:.0%} of the plants' height"
        )
    rows |= obstacle_rows(survey.obstacles)
    if survey.reference is not None:
        rows |= reference_rows(survey.reference)
    record = survey.prepared.plan.flown.record
    if record is not None:
        rows["flight"] = f"{record['start_s']:.1f} to {record['stop_s']:.1f} s of a log ({record['format']})"
    rows["coordinates"] = crs_name(survey.georeference)
    start, end = survey.schedule.trajectory.cruise_s()
    rows["time"] = f"{survey.timing_s['total']:.1f} s for {end - start:.1f} s of flight"
    return rows
