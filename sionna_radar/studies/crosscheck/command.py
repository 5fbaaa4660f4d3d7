"""Commands `crosscheck` and `fit`: both engines, and the constant gamma of the simple one."""

from typing import TYPE_CHECKING, Annotated

import typer

from sionna_radar.cli.session import SCENARIO, TEAM, Listed, Session, command

if TYPE_CHECKING:
    from sionna_radar.cli.session import OpenCheckpoints
    from sionna_radar.studies.crosscheck.study import CrossCheck


@command(*SCENARIO, *TEAM)
def crosscheck(session: Session) -> None:
    """Simulate the same pulses with both engines and test whether they agree; exit code 1 if not."""
    from sionna_radar.execution.execution import BLOCK_SIZE
    from sionna_radar.scenario.loading import identity
    from sionna_radar.studies.crosscheck.document import DOCUMENT
    from sionna_radar.studies.crosscheck.study import crosscheck as run_crosscheck

    checked = session.load()

    def fly(keep: "OpenCheckpoints") -> "CrossCheck":
        with session.execution(keep, identity(checked, BLOCK_SIZE)) as execution:
            return run_crosscheck(checked, execution=execution)

    session.produce(fly, DOCUMENT, exit_code=lambda result: 0 if result.agrees else 1)


@command("scenario", "set_", "set_file")
def fit(
    session: Session,
    material: Annotated[str, typer.Option(metavar="NAME", help="A material of the scenario.")],
    from_deg: Annotated[float, typer.Option(help="Least incidence angle of the fit.")] = 20.0,
    to_deg: Annotated[float, typer.Option(help="Greatest incidence angle of the fit.")] = 70.0,
) -> None:
    """Fit a constant gamma to a material; print its residual and where the fit fails."""
    from sionna_radar.studies.crosscheck.gamma_fit import TOLERANCE_DB, fit_material

    result = fit_material(session.load(), material, from_deg, to_deg)
    typer.echo(f"{material}: gamma = {result.gamma_db:.2f} dB over {from_deg:g} to {to_deg:g} deg")
    typer.echo(f"residual {result.rms_db:.2f} dB RMS over the span\n")
    typer.echo("incidence (deg)  sigma0 (dB)  residual (dB)")
    columns = (result.incidence_deg, result.sigma0_db, result.residual_db)
    for angle, level, residual in list(zip(*columns, strict=True))[::5]:
        typer.echo(f"{angle:15.0f}  {level:11.2f}  {residual:+13.2f}")
    typer.echo(f"\nwhere it misses by more than {TOLERANCE_DB:g} dB:")
    for failure in result.failures or ["nowhere"]:
        typer.echo(f"  {failure}")


COMMANDS = (Listed("Simulate", "crosscheck", crosscheck), Listed("Reference", "fit", fit))
