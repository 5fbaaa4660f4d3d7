"""The result of a survey on the terminal."""

from rich.console import Console
from rich.table import Table

from sionna_radar.survey import Survey


def print_survey(survey: Survey) -> None:
    """Print what was flown, how well the DEM fits, and how long it took."""
    error, timing = survey.dem_error, survey.timing_s
    flown = survey.schedule.trajectory.cruise_s()
    table = Table(title=survey.scenario.description or None, show_header=False, title_justify="left")
    rows = {
        "pulses / paths / echoes": f"{survey.pulses:,} / {survey.paths:,} / {len(survey.points):,}",
        "DEM cells, coverage": f"{error.count:,}, {error.coverage:.1%} of the lit ground",
    }
    if error.count:
        rows |= {
            "elevation error RMS": f"{error.rms_m:.3f} m",
            "mean, standard deviation": f"{error.mean_m:+.3f} m, {error.std_m:.3f} m",
            "NMAD, 90 % within": f"{error.nmad_m:.3f} m, {error.le90_m:.3f} m",
            "least, greatest": f"{error.min_m:+.2f} m, {error.max_m:+.2f} m",
        }
    if survey.off_wall_error is not None and survey.off_wall_error.count:
        rows["RMS of lit cells"] = f"{survey.lit_error.rms_m:.3f} m"
        rows["RMS off the walls"] = f"{survey.off_wall_error.rms_m:.3f} m"
    rows["time"] = f"{timing['total']:.1f} s for {flown[1] - flown[0]:.1f} s of flight"
    for name, value in rows.items():
        table.add_row(name, value)
    Console(highlight=False).print(table)
