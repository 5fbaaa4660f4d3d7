"""A radar design as a sentence, tables, figures, `design.json` and one page."""

from base64 import b64encode
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import tomli_w
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from rich.table import Table

from sionna_radar.execution.workers import versions
from sionna_radar.foundation.numerics import is_number
from sionna_radar.report.colours import BLUE, ERRORS, GREEN, ORANGE, PURPLE, RED
from sionna_radar.report.coordinates import Coordinates, frame_of, map_bounds
from sionna_radar.report.drawing import ReportFigure, finish_map, map_size, readable, show_raster
from sionna_radar.report.page.markup import document
from sionna_radar.report.page.scene_data import Pack
from sionna_radar.report.study_document import Column, Columns, StudyDocument
from sionna_radar.report.terminal import NONE, number, table_of, with_spread
from sionna_radar.scenario import to_toml
from sionna_radar.scenario.overrides import apply_overrides
from sionna_radar.studies.design import MARKER
from sionna_radar.studies.design.plan import (
    FLAT,
    INACTIVE,
    MAPPED,
    RELAXED,
    RESULTS,
    Checked,
    RadarDesign,
    Relaxation,
    Slice,
    Standing,
)
from sionna_radar.studies.design.surrogate import SHARES
from sionna_radar.studies.sweep.common_cells import AREAS_ALIKE, unequal_areas
from sionna_radar.studies.sweep.quantities import QUANTITIES
from sionna_radar.studies.sweep.results import MAPPED_MEANING, table_text
from sionna_radar.studies.sweep.settings import label, short
from sionna_radar.studies.sweep.trial import PROBABILITIES, wilson_interval

# Largest width and height of a map, inches.
MAP_IN = (3.6, 3.6)
# Designs listed in a terminal and on the page.
MAX_LISTED = 6
TITLE = "Designs flown with several seeds"
SHOWN = ("rms_m", "le90_m", "coverage", "coverage_of_swath", "mapped_m2", "common_rms_m")
OF_LIT_CELLS = "coverage of lit cells"
COLOURS = (BLUE, ORANGE, GREEN, PURPLE)


def sentence(design: RadarDesign) -> str:
    """Return the answer in a sentence."""
    best = design.best
    setting = ", ".join(f"{readable(key)} {short(value)}" for key, value in best.setting.items())
    reached = " and ".join(
        f"{objective.expression.text} = {value:.3g}"
        for objective, value in zip(design.plan.objectives, best.objectives, strict=True)
    )
    least = min(best.standing, key=lambda standing: standing.probability, default=None)
    sure = "" if least is None else f"; weakest requirement: {least.requirement} (P = {least.probability:.2f})"
    if not design.holds:
        asked = design.plan.confidence
        none = f"No design was shown to meet all requirements with probability {asked:g}"
        return f"{none}; the nearest: {setting}: {reached}{sure}."
    kind = "Best compromise" if len(best.objectives) == 2 else "Best design"
    return f"{kind} after {design.surveys} surveys: {setting}: {reached}, over {best.seeds} seeds{sure}."


def statements(design: RadarDesign) -> list[str]:
    """Return notes on the optimum: tolerances, ends of ranges, active requirements, areas, and failed settings."""
    found = []
    for cut in design.slices:
        if len(cut.tolerance) > 1:
            found.append(_tolerance(design, cut))
        if cut.at_end:
            end = short(design.best.setting[cut.key])
            found.append(f"{cut.key}: the optimum, {end}, lies at the end of its range; a wider --free may improve it")
    found += [text for relaxation in design.relaxations if (text := _relaxed(design, relaxation))]
    found += _areas(design) + _probabilities(design)
    failed = [o.reason for o in design.observations if o.reason]
    if failed:
        found.append(f"{len(failed)} settings could not be flown, e.g. {failed[0]}")
    return found


def _tolerance(design: RadarDesign, cut: Slice) -> str:
    of_range = cut.key in [span.key for span in design.plan.space.spans]
    low, high = short(cut.tolerance[0]), short(cut.tolerance[-1])
    values = f"{low} to {high}" if of_range else " or ".join(map(short, cut.tolerance))
    objective = f"{_objective(design)} within {FLAT:.0%} of {design.best.objectives[0]:.3g}"
    asked = f" and all requirements met with P >= {design.plan.confidence:g}" if design.plan.requirements else ""
    return f"{cut.key}: {values} keeps {objective}{asked}, the other keys as they are (expected)"


def _objective(design: RadarDesign) -> str:
    return design.plan.objectives[0].expression.text


def _relaxed(design: RadarDesign, relaxation: Relaxation) -> str:
    name, objective, by = relaxation.requirement, _objective(design), f"{RELAXED:.0%}"
    if not design.holds:
        known = {f"with its limit relaxed by {by}": relaxation.relaxed, "without it": relaxation.without}
        for how, value in known.items():
            if np.isfinite(value):
                return f"{name}: {how} a design with {objective} = {value:.3g} is expected to meet all others"
        return ""
    if not relaxation.saving >= INACTIVE:
        return f"{name}: not active; relaxing its limit by {by} improves {objective} by less than {INACTIVE:.1%}"
    change = "cut" if design.plan.objectives[0].sign > 0 else "raise"
    return (
        f"{name}: active constraint; relaxing its limit by {by} would {change} {objective} from "
        f"{design.best.objectives[0]:.3g} to about {relaxation.relaxed:.3g}, and leaving it out to about "
        f"{relaxation.without:.3g} (expected)"
    )


def _areas(design: RadarDesign) -> list[str]:
    unequal = unequal_areas([(label(one.setting), one.values.get("mapped_m2", np.nan)) for one in design.checked])
    found = [f"{unequal}: compare common_rms_m, that of the same cells"] if unequal else []
    if design.plan.keeps_swath:
        least = design.plan.requirements[-1].text
        found.append(
            f"{least}: {1 - AREAS_ALIKE:.0%} of the largest seen, so that no design gains from ground left dark; a "
            f"--require on {', '.join(MAPPED)} takes its place"
        )
    elif (share := design.best.values.get("coverage_of_swath", np.nan)) < 1 - AREAS_ALIKE:
        asked = f"--require 'coverage_of_swath > {1 - AREAS_ALIKE:g}' leaves out designs that map less of theirs"
        found.append(f"the best design maps {share:.0%} of its planned swath; {asked}")
    return found


def _probabilities(design: RadarDesign) -> list[str]:
    """Return sentences about probabilities of detection, of which the surveys of a design are so many draws."""
    best = design.best
    return [
        f"{name} = {best.values[name]:.3g} in {best.seeds} surveys is at least "
        f"{wilson_interval(best.values[name], best.seeds)[0]:.2f} (95 %, Wilson); "
        "sionna-radar sweep scenario.toml --repeat 1000 tells it closer"
        for name in PROBABILITIES
        if name in design.plan.results and best.seeds > 0
    ]


def design_rows(design: RadarDesign) -> tuple[list[str], list[list[str]]]:
    """Return heading and rows of the designs flown with several seeds, best first; or of designs along the front."""
    named = [name for name in design.plan.names if name not in design.plan.space.keys]
    shown = [name for name in SHOWN if name in design.best.values]
    columns = list(dict.fromkeys([*named, *(n for n in design.plan.costs.names if n in design.best.values), *shown]))
    texts = [o.expression.text for o in design.plan.objectives if o.expression.text not in columns]
    heads = (OF_LIT_CELLS if name == "coverage" else name for name in columns)
    head = [*design.plan.space.keys, *texts, *heads, "DEM method", "seeds", "probability"]
    listed = list(design.checked[:MAX_LISTED])
    if len(design.front) > 0:
        spread = {int(k) for k in np.linspace(0, len(design.front) - 1, MAX_LISTED)}
        listed = [one for k, one in enumerate(design.front) if k in spread or one.setting == design.best.setting]
    rows = []
    for one in listed:
        reached = {o.expression.text: v for o, v in zip(design.plan.objectives, one.objectives, strict=True)}
        rows.append(
            [
                *(short(one.setting[key]) for key in design.plan.space.keys),
                *(f"{reached[text]:.4g}" for text in texts),
                *(_with_spread(one, name) for name in columns),
                one.scenario.dem.map_method,
                str(one.seeds),
                f"{one.probability:.3f}",
            ]
        )
    return head, rows


def _with_spread(one: Checked, name: str) -> str:
    value, spread = one.values.get(name, np.nan), one.spread.get(name, np.nan)
    form = ".1%" if name in SHARES else ",.0f" if name == "mapped_m2" else ".3g"
    return with_spread(value, spread, form)


def sentences(design: RadarDesign) -> list[str]:
    """Return the state of the optimum's requirements, and the notes on it."""
    standing = [
        f"{standing.requirement}: probability {standing.probability:.2f} for the mean over seeds, "
        f"{number(standing.of_one_survey, '.2f')} for one survey"
        for standing in design.best.standing
    ]
    return [*standing, *statements(design)]


def designs_table(design: RadarDesign) -> Table:
    """Return the designs that were checked, or those along the Pareto front."""
    title = f"Along the Pareto front of {len(design.front)} designs" if design.front else TITLE
    return table_of(f"{title} (mean ± standard deviation of a seed)", *design_rows(design))


def setting_toml(setting: Mapping[str, Any]) -> str:
    """Return a setting as tables of a scenario, for `--set-file` and for pasting."""
    tables: dict[str, Any] = {}
    apply_overrides(tables, setting)
    return tomli_w.dumps(tables)


def survey_rows(design: RadarDesign) -> list[dict[str, Any]]:
    """Return one row per flown setting and seed: the setting, its results, the DEM method, and why it failed."""
    return [
        {key: one.setting[key] for key in design.plan.space.keys}
        | {"run_seed": one.seed, "dem.method": one.method}
        | {name: value if np.isfinite(value := one.results.get(name, np.nan)) else "" for name in RESULTS}
        | {"reason": one.reason}
        for one in design.observations
    ]


def design_numbers(design: RadarDesign) -> dict[str, Any]:
    """Return the numbers."""
    plan = design.plan
    costs = {part: {name: cost.text for name, cost in c.items()} for part, c in plan.costs.components.items()}
    return {
        "answer": sentence(design),
        "source": plan.source,
        "free": [
            *({name: value for name, value in asdict(span).items() if name != "option"} for span in plan.space.spans),
            *plan.space.listed,
        ],
        "objectives": [objective.text for objective in plan.objectives],
        "requirements": [requirement.text for requirement in plan.requirements],
        "worlds": [{"source": source, "overrides": overrides} for source, overrides in plan.worlds],
        "costs": costs,
        "area": plan.area,
        "confidence": plan.confidence,
        "surveys": design.surveys,
        "holds": design.holds,
        "best": _document(design.best),
        "statements": statements(design),
        "relaxations": design.relaxations,
        "tolerance": {cut.key: cut.tolerance for cut in design.slices},
        "sensitivity": design.sensitivity,
        "noise": design.noise,
        "checked": [_document(checked) for checked in design.checked],
        "front": [_document(checked) for checked in design.front],
        "observations": design.observations,
        "scenario": design.best.scenario,
        "meaning": {name: f"{quantity.unit}: {quantity.formula}" for name, quantity in QUANTITIES.items()}
        | MAPPED_MEANING,
        "versions": versions(),
    }


def _document(checked: Checked) -> dict[str, Any]:
    return {
        "setting": checked.setting,
        "method": checked.scenario.dem.map_method,
        "seeds": checked.seeds,
        "objectives": checked.objectives,
        "probability": checked.probability,
        "values": checked.values,
        "spread": checked.spread,
        "standing": checked.standing,
    }


def figures_of(design: RadarDesign) -> dict[str, Any]:
    """Return the drawings of a design by name."""
    front = {"front": draw_front} if design.front else {}
    maps = {"maps": draw_maps} if design.maps else {}
    return {**front, "slices": draw_slices, "sensitivity": draw_sensitivity, **maps}


def draw_front(design: RadarDesign) -> Figure:
    """Draw the Pareto front in the plane of both objectives."""
    figure = ReportFigure(figsize=(7.0, 5.0), layout="constrained")
    axes = figure.subplots()
    front = np.array([one.objectives for one in design.front])
    axes.plot(*front.T, ls="--", marker="o", color=BLUE, label="Pareto front")
    axes.plot(*design.best.objectives, ls="", marker="*", ms=15, color=RED, label="Best compromise")
    first, second = (objective.expression.text for objective in design.plan.objectives)
    axes.set(xlabel=first, ylabel=second)
    axes.legend(frameon=False)
    _plain(axes)
    return figure


def draw_slices(design: RadarDesign) -> Figure:
    """Draw each objective and result along every free parameter through the optimum, with one standard deviation."""
    results = list(design.noise)
    texts = [o.expression.text for o in design.plan.objectives]
    rows = [*(text for text in texts if text not in results), *results, "Requirements hold"]
    columns = len(design.slices)
    figure = ReportFigure(figsize=(max(3.2 * columns, 5.0), 2.2 * len(rows)), layout="constrained")
    panels = figure.subplots(len(rows), columns, squeeze=False, sharex="col", sharey="row")
    for column, cut in enumerate(design.slices):
        place, names = _places(cut.values)
        best = place[_nearest(cut, design.best.setting[cut.key])]
        for row, name in enumerate(rows):
            axes = panels[row, column]
            line = {"color": COLOURS[row % len(COLOURS)], **({} if names is None else {"marker": "o", "ls": ""})}
            if name in results:
                mean, sigma = cut.results[name]
                axes.plot(place, mean, **line)
                if names is None:
                    axes.fill_between(place, mean - sigma, mean + sigma, color=line["color"], alpha=0.2, lw=0)
                else:
                    axes.errorbar(place, mean, sigma, capsize=3, **line)
            else:
                values = cut.holds if name == rows[-1] else cut.objectives[:, texts.index(name)]
                axes.plot(place, values, **line)
            axes.axvline(best, color="black", lw=0.8, ls=":")
            _plain(axes)
            if column == 0:
                axes.set_ylabel(name)
        panels[-1, column].set_xlabel(readable(cut.key))
        panels[-1, column].set_ylim(-0.05, 1.05)
        if names is not None:
            panels[-1, column].set_xticks(place, names)
            panels[-1, column].set_xlim(-0.5, len(names) - 0.5)
    figure.suptitle("Through the optimum (dotted): expected values and one standard deviation", fontsize="medium")
    return figure


def _places(values: tuple[Any, ...]) -> tuple[Any, list[str] | None]:
    """Return the abscissae of values, and the names of those that are no numbers."""
    if all(map(is_number, values)):
        return np.array(values, dtype=float), None
    return np.arange(len(values)), [short(value) for value in values]


def _nearest(cut: Slice, value: Any) -> int:
    if _places(cut.values)[1] is None:
        return int(np.argmin(np.abs(np.array(cut.values, dtype=float) - float(value))))
    return [repr(known) for known in cut.values].index(repr(value))


def draw_sensitivity(design: RadarDesign) -> Figure:
    """Draw the total Sobol index of each free parameter for results and objectives."""
    keys = design.plan.space.keys
    figure = ReportFigure(figsize=(7.0, 1.2 + 0.35 * len(keys) * len(design.sensitivity)), layout="constrained")
    axes = figure.subplots()
    height = 0.8 / len(design.sensitivity)
    for number_of, (name, indices) in enumerate(design.sensitivity.items()):
        at = np.arange(len(keys)) + (number_of - (len(design.sensitivity) - 1) / 2) * height
        axes.barh(at, [indices[key] for key in keys], height * 0.9, color=COLOURS[number_of % len(COLOURS)], label=name)
    axes.set(xlim=(0, 1.05), xlabel="Total-order Sobol index over the free ranges")
    axes.set_yticks(range(len(keys)), [readable(key) for key in keys])
    axes.invert_yaxis()
    axes.legend(frameon=False, fontsize="small")
    _plain(axes)
    return figure


def draw_maps(design: RadarDesign) -> Figure:
    """Draw the height errors of the best designs side by side, on one scale and in map coordinates if known."""
    count = len(design.maps)
    bounds = [map_bounds(error.grid.extent_m, np.zeros((0, 3))) for _, error in design.maps]
    sizes = [map_size(each, MAP_IN) for each in bounds]
    size = sum(width for width, _ in sizes) + 1.0 * count + 1.4, max(height for _, height in sizes) + 1.6
    figure = ReportFigure(figsize=size, layout="constrained")
    panels = figure.subplots(1, count, squeeze=False, width_ratios=[width for width, _ in sizes])[0]
    errors = np.concatenate([error.height_m[error.filled] for _, error in design.maps])
    limit = float(np.percentile(np.abs(errors), 98)) if len(errors) else 1.0
    scale = Normalize(-limit, limit)
    for axes, (name, error), edges in zip(panels, design.maps, bounds, strict=True):
        show_raster(axes, error, ERRORS, scale)
        finish_map(axes, edges, name.replace(", ", "\n"), frame_of(error.grid.georeference, Coordinates.MAP))
    figure.colorbar(panels[0].images[0], ax=panels, label="DEM minus truth, lit cells (m)", extend="both")
    return figure


def _plain(axes: Any) -> None:
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)


def design_page(design: RadarDesign) -> str:
    """Return the page of a design as HTML."""
    head, rows = design_rows(design)
    best = design.best
    return document(
        "design.html",
        Pack().text({}),
        (),
        package=__package__,
        title=f"Design of {design.plan.source}",
        answer=sentence(design),
        holds=design.holds,
        tiles=_tiles(design),
        statements=statements(design),
        asked=[*(o.text for o in design.plan.objectives), *(r.text for r in design.plan.requirements)],
        standing_head=STANDING.heads,
        standing=STANDING.cells(best.standing, "best.standing."),
        head=head,
        rows=rows,
        images={name: _image(draw(design)) for name, draw in figures_of(design).items()},
        toml=setting_toml(best.setting),
        scenario=to_toml(best.scenario, defaults=False),
        costs=_costs_of(design),
        cost_head=["Component", *design.plan.costs.names],
    )


def _tiles(design: RadarDesign) -> list[tuple[str, str, str]]:
    best = design.best
    reached = [
        (f"{value:.3g}", o.expression.text, "minimised" if o.sign > 0 else "maximised")
        for o, value in zip(design.plan.objectives, best.objectives, strict=True)
    ]
    free = [(short(value), readable(key), "free") for key, value in best.setting.items()]
    return [*reached, *free, (str(design.surveys), "surveys", "check included")]


def _costs_of(design: RadarDesign) -> list[list[str]]:
    plan: Mapping[str, Any] = design.plan.costs.components
    if not all(name in design.best.values for name in design.plan.costs.needs):
        return []
    names = design.plan.costs.names
    parts = {name: design.plan.costs.parts(name, design.best.values) for name in names}
    return [
        [part, *(f"{float(parts[name][part]):.3g}" if part in parts[name] else NONE for name in names)] for part in plan
    ]


def _image(figure: Figure) -> str:
    assert isinstance(figure, ReportFigure)
    return "data:image/png;base64," + b64encode(figure._repr_png_()).decode("ascii")


STANDING = Columns[Standing](
    [
        Column(key="requirement", heading="requirement"),
        Column(key="margin", heading="margin", form=".3g"),
        Column(key="spread", heading="from seed to seed", form=".2g"),
        Column(key="probability", heading="probability, mean over seeds", form=".2f"),
        Column(key="of_one_survey", heading="probability, one survey", form=".2f"),
    ]
)
DOCUMENT = StudyDocument[RadarDesign](
    marker=MARKER,
    suffix="_design",
    numbers=design_numbers,
    opening=lambda design: [sentence(design)],
    tables=lambda design: [designs_table(design)],
    lines=sentences,
    figures=figures_of,
    notebook=["slices"],
    texts={
        "design.toml": lambda design: setting_toml(design.best.setting),
        "scenario.toml": lambda design: to_toml(design.best.scenario, defaults=False),
        "surveys.csv": lambda design: table_text(survey_rows(design)),
    },
    page=design_page,
)
