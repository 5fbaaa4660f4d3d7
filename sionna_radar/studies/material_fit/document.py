"""A fit of materials: numbers, levels, tables to paste, figure, and trade-offs in words."""

from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from matplotlib.figure import Figure
from rich.table import Table

from sionna_radar.foundation.numerics import decibels
from sionna_radar.report.drawing import BLUE, ORANGE, ReportFigure
from sionna_radar.report.files.folder import write_study
from sionna_radar.report.terminal import console, print_whole
from sionna_radar.studies.calibration.estimation import TOLD
from sionna_radar.studies.material_fit.study import MaterialFit, Measure, Unknown

MARKER = "materials.json"
# Half-widths of intervals that hold 68 and 95 % of a Gaussian, in standard deviations.
SIGMAS = {"interval_68": 0.9945, "interval_95": 1.9600}
# Correlations that are named.
NAMED = 0.9
# Shares of a standard deviation below which it is said to be lowered.
LOWERED = 0.7


def write_materials(fit: MaterialFit, directory: Path) -> list[Path]:
    """Write numbers, levels, tables and figure, all or nothing; return the files. Raises OutputError."""
    return write_study(
        directory,
        MARKER,
        fit,
        materials_document(fit),
        {"levels": draw_levels},
        {"levels.csv": fit.levels.to_csv(), "materials.toml": materials_toml(fit)},
    )


def materials_document(fit: MaterialFit) -> dict[str, Any]:
    """Return the numbers: parameters in the units of their keys, covariances in nepers or those units."""
    intervals = {key: fit.intervals(sigmas) for key, sigmas in SIGMAS.items()}
    knowledge = fit.knowledge
    return {
        "told_below": TOLD,
        "parameters": [
            {
                "name": unknown.name,
                "before": unknown.value(unknown.start),
                "estimate": fit.estimates[unknown.name],
                "sigma": float(knowledge.sigma[k]),
                "sigma_unit": "Np" if unknown.floor is not None else "of the key",
                **{key: list(found[unknown.name]) for key, found in intervals.items()},
                "told": bool(knowledge.told[k]),
            }
            for k, unknown in enumerate(fit.unknowns)
        ],
        "covariance": knowledge.covariance.tolist(),
        "correlation": knowledge.correlation.tolist(),
        "trade_offs": trade_off_words(fit),
        "measures": [
            {"name": m.name, "sigma": m.knowledge.sigma.tolist(), "told": m.knowledge.told.tolist()}
            for m in fit.measures
        ],
        "misfit": fit.misfit,
        "degrees_of_freedom": fit.freedom,
        "probability_of_misfit": fit.surprise,
        "model_holds": fit.model_holds,
    }


def materials_toml(fit: MaterialFit) -> str:
    """Return the materials with their estimates as tables of a scenario."""
    tables = {
        name: {"model": table.model, **table.model_dump(mode="json", exclude_none=True, exclude_defaults=True)}
        for name, table in fit.tables.items()
    }
    told = zip(fit.unknowns, fit.knowledge.told, strict=True)
    held = [unknown.name for unknown, is_told in told if not is_told]
    head = "# Materials as fitted: they replace those of the same names in a scenario.\n"
    head += f"# Not told by the levels, and near what was believed beforehand: {', '.join(held)}.\n" if held else ""
    return head + tomli_w.dumps({"materials": tables})


def draw_levels(fit: MaterialFit) -> Figure:
    """Draw levels with their speckle and the fitted ones over incidence, one panel a cover."""
    levels, covers = fit.levels, list(dict.fromkeys(fit.levels.cover))
    figure = ReportFigure(figsize=(max(5.0, 3.6 * len(covers)), 3.8), layout="constrained")
    panels = figure.subplots(1, len(covers), squeeze=False, sharey=True)[0]
    for axes, cover in zip(panels, covers, strict=True):
        own = levels.of(cover)
        angle_deg = np.rad2deg(levels.incidence_rad[own])
        for nearer_v, colour, name in ((True, BLUE, "V"), (False, ORANGE, "H")):
            chosen = (levels.polarization_rad[own] < np.pi / 4) == nearer_v
            if chosen.any():
                axes.plot(angle_deg[chosen], decibels(levels.sigma0[own][chosen]), "o", ms=4, color=colour)
                order = np.argsort(angle_deg[chosen])
                fitted_db = decibels(fit.fitted[own][chosen])
                axes.plot(angle_deg[chosen][order], fitted_db[order], "_-", color=colour, label=f"Nearer to {name}")
        axes.set(xlabel="Incidence (deg)", title=cover)
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("sigma0 (dB)")
    panels[0].legend(frameon=False, fontsize="small")
    return figure


def print_materials(fit: MaterialFit) -> None:
    """Print estimates, trade-offs, what would tell more, and whether the models describe the levels."""
    table = Table(title=f"{len(fit.levels)} levels of {len(fit.tables)} covers", title_justify="left")
    for name in ("parameter", "before", "estimate", "68 %", "95 %", "told"):
        table.add_column(name, justify="left" if name in ("parameter", "told") else "right")
    for row in materials_document(fit)["parameters"]:
        values = (row["before"], row["estimate"])
        spans = (" to ".join(f"{end:.4g}" for end in row[key]) for key in SIGMAS)
        table.add_row(row["name"], *(f"{v:.4g}" for v in values), *spans, "yes" if row["told"] else "no")
    print_whole(table)
    out = console()
    for text in [*trade_off_words(fit), *measure_words(fit), _verdict(fit)]:
        out.print(text, soft_wrap=True, highlight=False)


def trade_off_words(fit: MaterialFit) -> list[str]:
    """Return in words what the levels leave open, alone or together, and which estimates trade off."""
    known = {unknown.name: unknown for unknown in fit.unknowns}
    words = []
    for direction in fit.knowledge.unseen:
        parts = [_change(known[name], change) for name, change in direction.items()]
        apart = "not told" if len(parts) == 1 else "not told apart"
        words.append(f"{apart}: {' with '.join(parts)} leaves the levels nearly as they are")
    names, correlation = fit.knowledge.names, fit.knowledge.correlation
    for i, j in zip(*np.triu_indices(len(names), 1), strict=True):
        if abs(correlation[i, j]) > NAMED:
            words.append(f"trade-off: {names[i]} and {names[j]}, correlation {correlation[i, j]:+.2f}")
    return words


def _change(unknown: Unknown, change: float) -> str:
    if unknown.floor is None:
        return f"{unknown.name} changed by {change:+.3g}"
    over = f" (less {unknown.floor:g})" if unknown.floor else ""
    return f"{unknown.name}{over} times {np.exp(change):.3g}"


def measure_words(fit: MaterialFit) -> list[str]:
    """Return in words what further measurements would tell, and which trade-offs they part."""
    words = [text for measure in fit.measures for text in _gain(fit, measure)]
    if words or bool(fit.knowledge.told.all()):
        return words
    return ["none of these alone would tell more: " + "; ".join(m.name.rstrip(",") for m in fit.measures)]


def _gain(fit: MaterialFit, measure: Measure) -> list[str]:
    """Return sentences: the parameters that a measurement would tell, and the standard deviations that it lowers."""
    before, after = fit.knowledge, measure.knowledge
    gained = [n for n, was, now in zip(before.names, before.told, after.told, strict=True) if now and not was]
    lowered = [
        f"{name} to {ratio:.2f}"
        for name, ratio in zip(before.names, after.sigma / before.sigma, strict=True)
        if ratio < LOWERED and name not in gained
    ]
    return [
        *([f"{measure.name} would tell {', '.join(gained)}"] if gained else []),
        *([f"{measure.name} would lower the standard deviation of {', '.join(lowered)} of it"] if lowered else []),
    ]


def _verdict(fit: MaterialFit) -> str:
    chance = f"misfit {fit.misfit:.4g} with {fit.freedom} degrees of freedom, probability {fit.surprise:.2g}"
    if fit.model_holds:
        return f"the models describe the levels: {chance}"
    return f"warning: the models do not describe the levels, so that the intervals are too narrow: {chance}"
