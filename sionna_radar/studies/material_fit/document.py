"""A fit of materials: numbers, levels, tables to paste, figure, and trade-offs in words."""

from collections.abc import Callable, Mapping
from itertools import compress
from typing import Any

import numpy as np
import tomli_w
from matplotlib.figure import Figure

from sionna_radar.foundation.decibels import decibels
from sionna_radar.mapping.navigation.refinement import MAX_POSTERIOR_RATIO
from sionna_radar.report.colours import BLUE, ORANGE
from sionna_radar.report.drawing import ReportFigure
from sionna_radar.report.study_document import Column, Columns, StudyDocument
from sionna_radar.studies.calibration.estimation import Further
from sionna_radar.studies.material_fit.study import MaterialFit, Unknown

# Half-widths of intervals that hold 68 and 95 % of a Gaussian, in standard deviations.
SIGMAS = {"interval_68": 0.9945, "interval_95": 1.9600}
# Correlations that are named.
NAMED = 0.9
# Shares of a standard deviation below which it is said to be lowered.
LOWERED = 0.7


def materials_numbers(fit: MaterialFit) -> dict[str, Any]:
    """Return the numbers: parameters in the units of their keys, covariances in nepers or those units."""
    posterior = fit.posterior
    return {
        "told_below": MAX_POSTERIOR_RATIO,
        "parameters": _parameters(fit),
        "covariance": posterior.covariance,
        "correlation": posterior.correlation,
        "trade_offs": trade_off_words(fit),
        "measures": [
            {"name": m.name, "sigma": m.posterior.sigma, "told": m.posterior.observable} for m in fit.measures
        ],
        "misfit": fit.chi2,
        "degrees_of_freedom": fit.dof,
        "probability_of_misfit": fit.p_value,
        "model_holds": fit.model_holds,
    }


def _parameters(fit: MaterialFit) -> list[dict[str, Any]]:
    """Return prior, estimate and intervals of each parameter; see `PARAMETERS`."""
    intervals = {key: fit.intervals(sigmas) for key, sigmas in SIGMAS.items()}
    return [
        {
            "name": unknown.name,
            "before": unknown.value(unknown.start),
            "estimate": fit.estimates[unknown.name],
            "sigma": fit.posterior.sigma[k],
            "sigma_unit": "Np" if unknown.floor is not None else "of the key",
            **{key: found[unknown.name] for key, found in intervals.items()},
            "told": bool(fit.posterior.observable[k]),
        }
        for k, unknown in enumerate(fit.unknowns)
    ]


def _interval(key: str) -> Callable[[Mapping[str, Any]], str]:
    return lambda row: " to ".join(f"{end:.4g}" for end in row[key])


PARAMETERS = Columns[Mapping[str, Any]](
    [
        Column(key="name", heading="parameter"),
        Column(key="before", heading="prior", form=".4g"),
        Column(key="estimate", heading="estimate", form=".4g"),
        Column(key="interval_68", heading="68 %", text=_interval("interval_68")),
        Column(key="interval_95", heading="95 %", text=_interval("interval_95")),
        Column(key="told", heading="observable"),
    ]
)


def materials_toml(fit: MaterialFit) -> str:
    """Return the materials with their estimates as tables of a scenario."""
    tables = {
        name: {"model": table.model, **table.model_dump(mode="json", exclude_none=True, exclude_defaults=True)}
        for name, table in fit.tables.items()
    }
    held = list(compress(fit.posterior.names, ~fit.posterior.observable))
    head = "# Materials as fitted: they replace those of the same names in a scenario.\n"
    head += f"# Not observable from the levels, and near the prior: {', '.join(held)}.\n" if held else ""
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


def trade_off_words(fit: MaterialFit) -> list[str]:
    """Return in words what the levels leave open, alone or together, and which estimates trade off."""
    known = {unknown.name: unknown for unknown in fit.unknowns}
    words = []
    for direction in fit.posterior.null_space:
        parts = [_change(known[name], change) for name, change in direction.items()]
        verdict = "not observable" if len(parts) == 1 else "not separable"
        words.append(f"{verdict}: {' with '.join(parts)} leaves the levels nearly as they are")
    names, correlation = fit.posterior.names, fit.posterior.correlation
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
    """Return in words what further measurements would make observable, and which trade-offs they resolve."""
    words = [text for measure in fit.measures for text in _gain(fit, measure)]
    if words or bool(fit.posterior.observable.all()):
        return words
    return ["none of these alone would make more observable: " + "; ".join(m.name.rstrip(",") for m in fit.measures)]


def _gain(fit: MaterialFit, measure: Further) -> list[str]:
    """Return sentences: parameters that a measurement makes observable, standard deviations that it lowers."""
    before, after = fit.posterior, measure.posterior
    gained = list(compress(before.names, after.observable & ~before.observable))
    lowered = [
        f"{name} to {ratio:.2f}"
        for name, ratio in zip(before.names, after.sigma / before.sigma, strict=True)
        if ratio < LOWERED and name not in gained
    ]
    return [
        *([f"{measure.name} would make {', '.join(gained)} observable"] if gained else []),
        *([f"{measure.name} would lower the standard deviation of {', '.join(lowered)} of it"] if lowered else []),
    ]


def _verdict(fit: MaterialFit) -> str:
    chance = f"chi-squared {fit.chi2:.4g} with {fit.dof} degrees of freedom, p = {fit.p_value:.2g}"
    if fit.model_holds:
        return f"the models describe the levels: {chance}"
    return f"warning: the models do not describe the levels, so that the intervals are too narrow: {chance}"


DOCUMENT = StudyDocument[MaterialFit](
    marker="materials.json",
    suffix="_materials",
    numbers=materials_numbers,
    tables=lambda fit: [PARAMETERS.table(f"{len(fit.levels)} levels of {len(fit.tables)} covers", _parameters(fit))],
    lines=lambda fit: [*trade_off_words(fit), *measure_words(fit), _verdict(fit)],
    figures=lambda _: {"levels": draw_levels},
    notebook=["levels"],
    texts={"levels.csv": lambda fit: fit.levels.to_csv(), "materials.toml": materials_toml},
)
