"""Command `fit-materials`: materials from levels of backscatter."""

from pathlib import Path
from typing import Annotated

import typer

from sionna_radar.cli.session import RECORDING, Listed, Session, command
from sionna_radar.foundation.errors import ScenarioError


@command("scenario", *RECORDING)
def fit_materials_command(
    session: Session,
    levels: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="CSV of cover,incidence_deg,polarization,sigma0_db[,looks]; polarization VV, HH, HV or an "
            "angle in deg. Default: measured from traced echoes of the scenario.",
        ),
    ] = None,
    free: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COVER.KEY",
            help="A parameter to estimate (repeat). Default: gamma, or height, length, permittivity and loss.",
        ),
    ] = None,
    prior: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            help="Prior sigma (repeat): a factor for heights, lengths and permittivities, else in its unit.",
        ),
    ] = None,
    calibration_sigma_db: Annotated[
        float, typer.Option(metavar="DB", min=0.0, help="Unknown level of the radar, dB.")
    ] = 0.0,
    level_sigma_db: Annotated[
        float, typer.Option(metavar="DB", min=0.0, help="Error of each level beside speckle, dB.")
    ] = 0.0,
    pulses: Annotated[int, typer.Option(metavar="N", min=1, help="Pulses taken, without --levels.")] = 2000,
    recording: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Levels of the recorded echoes of this flight, or of its folder of `run --record signals`.",
        ),
    ] = None,
) -> None:
    """Estimate gamma, roughness and permittivity of covers from levels of backscatter."""
    from sionna_radar.studies.calibration.study import parse_deviations
    from sionna_radar.studies.material_fit.document import DOCUMENT
    from sionna_radar.studies.material_fit.levels import measure_levels
    from sionna_radar.studies.material_fit.study import fit_materials
    from sionna_radar.surfaces.backscatter import Levels
    from sionna_radar.survey.preparation import prepare

    if levels is not None and recording is not None:
        raise ScenarioError.of_option("--recording", "gives levels, as --levels does; give one of them")
    priors, given = parse_deviations("--prior", prior or []), None if levels is None else Levels.from_csv(levels)
    loaded = session.load()
    session.produce(
        lambda _: fit_materials(
            measure_levels(prepare(loaded), pulses, recording) if given is None else given,
            loaded.all_materials,
            loaded.radar.carrier_hz,
            free=free or (),
            prior=priors,
            calibration_sigma_db=calibration_sigma_db,
            level_sigma_db=level_sigma_db,
        ),
        DOCUMENT,
    )


COMMANDS = (Listed("Real data", "fit-materials", fit_materials_command),)
