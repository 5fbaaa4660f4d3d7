"""Maps of one flight by several methods, each with its stated uncertainty held against its errors."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from sionna_radar import load_scenario
from sionna_radar.accuracy.truth import Comparison
from sionna_radar.accuracy.uncertainty import INTERVALS_PERCENT, UncertaintyCheck, check_uncertainty
from sionna_radar.execution.execution import Execution
from sionna_radar.mapping.build import build_dem_method
from sionna_radar.mapping.mapper import Estimate
from sionna_radar.mapping.points import Points
from sionna_radar.survey.observation import observe
from sionna_radar.survey.placement import place
from sionna_radar.survey.preparation import prepare

NOMINAL = np.array(INTERVALS_PERCENT) / 100


def mapped(
    scene: str, methods: tuple[str, ...], changes: dict[str, object]
) -> Iterator[tuple[str, Points, Estimate, Comparison]]:
    """The maps of one flight: method, points, map and its comparison with the truth."""
    whole = {"dem.method": "refined"} if set(methods) & {"smooth", "refined"} else {"dem.method": methods[0]}
    prepared = prepare(load_scenario(scene, whole | changes))
    sensor, observed = observe(prepared, Execution())
    points = place(observed.echoes, sensor, prepared.flight)
    for name in methods:
        method = build_dem_method(prepared.local.dem.model_copy(update={"method": name}))
        mapper = replace(prepared.mapper, method=method, name=name)
        estimate = mapper.map(points, observed.profiles, prepared.measured)
        yield name, points, estimate, prepared.truth.compare(estimate.dem, points, observed.hits.lit)


def checked(scene: str, methods: tuple[str, ...], changes: dict[str, object]) -> dict[str, UncertaintyCheck]:
    """The maps of one flight, each with its stated uncertainty held against its errors."""
    checks = {}
    for name, points, estimate, found in mapped(scene, methods, changes):
        check = check_uncertainty(found.error, estimate.sigma, found.truth, found.lit, points, estimate.uncertainty)
        covered = " ".join(f"{100 * share:5.1f}" for share in check.cells.coverage.values())
        windows = "  ".join(f"{m.window_m:g} m {m.ratio:.2f} ({m.count})" for m in check.means)
        print(
            f"{scene:10s} {name:8s} {changes}: inside {covered} %, NMAD of z {check.cells.nmad_z:.2f}, "
            f"RMS {found.lit_error.rms_m:.3f} m, sigma {check.cells.sigma_rms_m:.3f} m; windows {windows}",
            flush=True,
        )
        checks[name] = check
    return checks


def shares(checks: list[UncertaintyCheck]) -> np.ndarray:
    return np.array([list(check.cells.coverage.values()) for check in checks])
