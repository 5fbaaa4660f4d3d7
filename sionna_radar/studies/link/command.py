"""Command `link`: link budgets."""

from collections.abc import Sequence
from typing import Annotated

import typer

from sionna_radar.cli.session import SCENARIO, Listed, Session, command
from sionna_radar.foundation.errors import ScenarioError


@command(*SCENARIO)
def link(
    session: Session,
    incidence: Annotated[str | None, typer.Option(metavar="A1,A2,...", help="Incidence angles, degrees.")] = None,
    rain: Annotated[str | None, typer.Option(metavar="R1,R2,...", help="Rain rates in mm/h.")] = None,
    pulses: Annotated[int, typer.Option(min=100, max=1_000_000, help="Pulses simulated at each range.")] = 3000,
) -> None:
    """Compute the link budget over each material, in closed form and simulated; exit code 1 if they differ."""
    from sionna_radar.studies.link.document import DOCUMENT
    from sionna_radar.studies.link.study import INCIDENCES_DEG, RAINS_MM_PER_H
    from sionna_radar.studies.link.study import link_budget as run_link_budget

    angles, rates = _numbers("--incidence", incidence, INCIDENCES_DEG), _numbers("--rain", rain, RAINS_MM_PER_H)
    checked = session.load()
    session.produce(
        lambda _: run_link_budget(checked, incidences_deg=angles, rains_mm_per_h=rates, pulses=pulses),
        DOCUMENT,
        exit_code=lambda result: 0 if result.agrees else 1,
    )


def _numbers(option: str, text: str | None, default: Sequence[float]) -> list[float]:
    if text is None:
        return list(default)
    try:
        return [float(part) for part in text.split(",")]
    except ValueError as error:
        raise ScenarioError.of_option(option, f"{text!r} are not numbers; give some, separated by commas") from error


COMMANDS = (Listed("Simulate", "link", link),)
