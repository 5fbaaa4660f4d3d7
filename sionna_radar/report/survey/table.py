"""The table of a survey, for the terminal."""

from rich.table import Table

from sionna_radar.report.survey.summary import crs_name
from sionna_radar.report.terminal import console
from sionna_radar.survey.result import Survey

# Errors of `refined` over those of `linear`, RMS: least and most over ten lidar DEMs (docs/theory/maps.md).
REFINED_OVER_LINEAR = 0.47, 0.85
# The ranges of a chirp are printed if it has no more echoes than this.
FEW_ECHOES = 4


def print_survey(survey: Survey) -> None:
    """Print what was flown, how accurate the DEM is, and how long it took; the errors are those of lit cells."""
    console().print(survey_table(survey))


def survey_table(survey: Survey) -> Table:
    """Return what was flown, how well the DEM fits, and how long it took."""
    table = Table(title=survey.scenario.description or None, show_header=False, title_justify="left")
    for name, value in (_flown(survey) | _errors(survey) | _notes(survey)).items():
        table.add_row(name, value)
    return table


def _flown(survey: Survey) -> dict[str, str]:
    rows = {"pulses / paths / echoes": f"{survey.pulses:,} / {survey.paths:,} / {len(survey.points):,}"}
    if survey.chirp is not None and survey.scenario.processing.echoes == "all":
        found = survey.points.range_m[survey.points.pulse == survey.chirp.pulse]
        if len(found) <= FEW_ECHOES:
            ranges = ", ".join(f"{range_m:.2f} m" for range_m in found) or "none"
            rows[f"ranges in pulse {survey.chirp.pulse}"] = ranges
    return rows


def _could_be_refined(survey: Survey) -> bool:
    """Return whether whole echoes of ground without walls, in clear air, were mapped by their points alone."""
    local = survey.prepared.local
    whole = local.sensor == "radar" and local.processing.angle == "off" and local.radar.sweep != "triangular"
    return (
        whole
        and local.processing.average.chirps == 1
        and survey.prepared.mapper.name == "linear"
        and survey.off_wall_error is None
        and not local.weather.falling
        and survey.lit_error.count > 0
    )


def _errors(survey: Survey) -> dict[str, str]:
    lit, off_wall = survey.lit_error, survey.off_wall_error
    rows = {"lit cells filled": f"{lit.count:,}, coverage {lit.coverage:.1%}"}
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
    rows = {f"{key} replaced by": what for key, what in survey.replaced.items()}
    if _could_be_refined(survey):
        least, most = REFINED_OVER_LINEAR
        rows["a better map"] = f"dem.method = 'refined': {least:.2f} to {most:.2f} of this error over ten lidar DEMs"
    if survey.overhang is not None and survey.overhang.cells:
        over = survey.overhang
        west, south, east, north = over.places[0].extent_m
        where = f"most at {west:.0f} to {east:.0f} m east, {south:.0f} to {north:.0f} m north"
        rows["cells under an overhang"] = (
            f"{over.cells:,} ({over.share:.1%}), {where}; the truth is the highest surface"
        )
    reading = survey.canopy_reading
    if reading is not None and reading.count:
        rows["among plants"] = (
            f"{reading.above_ground_m:+.2f} m over the ground in {reading.count:,} cells, "
            f"{reading.share:.0%} of the plants' height"
        )
    record = survey.prepared.flown.record
    if record is not None:
        rows["flight"] = f"{record['start_s']:.1f} to {record['stop_s']:.1f} s of a log ({record['format']})"
    rows["coordinates"] = crs_name(survey.georeference)
    start, end = survey.schedule.trajectory.cruise_s()
    rows["time"] = f"{survey.timing_s['total']:.1f} s for {end - start:.1f} s of flight"
    return rows
