"""Command `budget`: the navigation errors that a survey tolerates."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sionna_radar.cli.session import SCENARIO, TEAM, Listed, Session, command
from sionna_radar.foundation.errors import ScenarioError

if TYPE_CHECKING:
    from sionna_radar.cli.session import OpenCheckpoints
    from sionna_radar.studies.budget.study import Budget


@command(*SCENARIO, *TEAM)
def budget(
    session: Session,
    repeat: Annotated[int, typer.Option(min=1, help="Draws of the random errors.")] = 5,
    grades: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Custom grades of GPS/IMU: TOML tables of platform.navigation keys."),
    ] = None,
    limit: Annotated[
        str | None,
        typer.Option(metavar="rms=M", help="Largest RMS of the DEM, m, in place of the growth by 10 %: rms=0.15."),
    ] = None,
) -> None:
    """Find the GPS/IMU accuracy a survey needs: the size of each error that alone raises the RMS of the DEM by 10 %."""
    from sionna_radar.studies.budget.document import DOCUMENT
    from sionna_radar.studies.budget.study import GRADES, GROWTH, identity_of, load_grades
    from sionna_radar.studies.budget.study import navigation_budget as run_budget

    limit_m = None if limit is None else _rms_limit(limit)
    checked = session.load()
    known = GRADES | load_grades(grades) if grades else GRADES

    asked = identity_of(checked, GROWTH, repeat, known) | ({} if limit_m is None else {"limit": limit_m})

    def fly(keep: "OpenCheckpoints") -> "Budget":
        with session.execution(keep, asked) as execution:
            return run_budget(checked, limit_m=limit_m, repeat=repeat, grades=known, execution=execution)

    session.produce(fly, DOCUMENT)


def _rms_limit(text: str) -> float:
    """Return the limit of `rms=M`; raises ScenarioError for anything else."""
    name, _, value = text.partition("=")
    try:
        limit_m = float(value)
    except ValueError:
        limit_m = 0.0
    if name.strip() != "rms" or not 0 < limit_m < float("inf"):
        message = f"{text!r} is no limit; give rms=M with the largest RMS error in m, e.g. rms=0.15"
        raise ScenarioError.of_option("--limit", message)
    return limit_m


COMMANDS = (Listed("Study", "budget", budget),)
