"""Command `calibrate`: errors of an instrument from its echoes."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sionna_radar.cli.session import MAX_REFERENCE_BYTES, RECORDING, Listed, ReportOption, Session, command

if TYPE_CHECKING:
    from sionna_radar.studies.calibration.study import Calibration


@command(*RECORDING)
def calibrate_command(
    session: Session,
    recordings: Annotated[
        list[Path],
        typer.Argument(
            metavar="RECORDING...", help="As for `process`, with poses; or folders of `run --record signals`."
        ),
    ],
    reference: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Heights of the ground: a GeoTIFF, a LAS or LAZ cloud, or CSV of x, y, z[, sigma]. Without it the "
            "ground is estimated from overlapping lines.",
        ),
    ] = None,
    estimate: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="An error to estimate (repeat): roll, pitch, heading, squint, lever_nose, lever_right, lever_down, "
            "range_bias, range_scale, time_offset, velocity_east, velocity_north or velocity_up. Default: mounting, "
            "range bias and time offset.",
        ),
    ] = None,
    prior: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=SIGMA",
            help="Its prior sigma (repeat), e.g. time_offset=5 (ms); where Doppler is used also that "
            "of velocity_east, velocity_north, velocity_up (m/s) and backscatter_slope (dB/deg).",
        ),
    ] = None,
    drift: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=SIGMA",
            help="An error that differs from line to line (repeat), also datum_east, datum_north or datum_up, and its "
            "standard deviation between lines, e.g. heading=0.1 (deg).",
        ),
    ] = None,
    reference_sigma: Annotated[
        float, typer.Option(metavar="M", min=0.0, help="Standard deviation of the place and height of all of it, m.")
    ] = 0.0,
    report: ReportOption = True,
) -> None:
    """Estimate mounting, lever arm, range and clock errors of an instrument from its echoes."""
    from sionna_radar.foundation.input_file import regular_file
    from sionna_radar.studies.calibration.document import DOCUMENT
    from sionna_radar.studies.calibration.study import DRIFTS, PRIORS, parse_deviations, parse_errors
    from sionna_radar.studies.calibration.study import calibrate as run_calibration

    names = parse_errors(estimate or [])
    priors = parse_deviations("--prior", prior or [], PRIORS)
    between = parse_deviations("--drift", drift or [], DRIFTS)
    if reference is not None:
        regular_file(reference, "--reference", "give a GeoTIFF, LAS, LAZ or CSV file", MAX_REFERENCE_BYTES)
    session.produce(
        lambda _: run_calibration(
            recordings,
            reference,
            names=names,
            prior=priors,
            drift=between,
            reference_sigma_m=reference_sigma,
            overrides=session.overrides,
        ),
        DOCUMENT,
        report=report,
        exit_code=_tell_refusal,
    )


def _tell_refusal(result: "Calibration") -> int:
    """Print why no estimate is stated, and return the exit code: 1 then."""
    if result.refused is None:
        return 0
    typer.echo(f"no estimate: {result.refused}", err=True)
    return 1


COMMANDS = (Listed("Real data", "calibrate", calibrate_command),)
