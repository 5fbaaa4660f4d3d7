"""The ledger of mechanisms of maps of natural ground: `pytest -m study -n 0 -s tests/studies/test_mechanisms.py`.

Short surveys, three seeds each, are mapped with each mechanism and without it. Half of the worlds may be looked at when
one is designed; the other half judges. `python tests/real_files.py` fetches real ground, `SIONNA_RADAR_STUDY=folder`
keeps what was found, so that a study that was cut goes on.
"""

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

import sionna_radar.inference.echo.likelihood as model
import sionna_radar.inference.terrain.covariance_fit as covariance_fit
import sionna_radar.inference.terrain.heights as heights
import sionna_radar.inference.terrain.smoothing as smoothing
import sionna_radar.inference.terrain.uncertainty as uncertainty
import sionna_radar.mapping.echo_heights as echo_heights
import sionna_radar.mapping.linear.gridding as gridding
import sionna_radar.mapping.linear.linear as linear
import sionna_radar.mapping.linear.walls as walls
import sionna_radar.mapping.point_heights as point_heights
import sionna_radar.mapping.points as points
import sionna_radar.mapping.refined.curvature as curvature
import sionna_radar.mapping.refined.refinement as refinement
import sionna_radar.mapping.seen as seen
from elevation_files import NORTH, WEST, from_origin, write_heights
from mechanism_study import Flight, Gain, Mechanism, Score, gain
from real_files import HILLSIDE, MOUNTAIN, place_of

SEEDS = (1, 2, 3)
FLIGHT = {
    "platform.length_m": 44.0,
    "platform.altitude_m": 40.0,
    "platform.height": "level",
    "radar.chirp_rate_hz": 720.0,
    "radar.scan.rotation_rpm": 240.0,
    "radar.scan.half_swath_deg": 25.0,
    "radar.scan.incidence_deg": 40.0,
}
WIDE = {"radar.antenna.beamwidth_deg": 4.0}
DRAWN = {"dem.microrelief_m": 0.0}
RAIN = {
    "weather.rain_rate_mm_per_h": 6.0,
    "radar.snr_db": None,
    "radar.transmit_power_dbm": 10.0,
    "radar.noise_figure_db": 15.0,
}
POSTS_M = 0.5


def fractal(rng: np.random.Generator, hurst: float, cells: int = 260) -> np.ndarray:
    """Fractal relief whose differences over 1 m have the RMS 1."""
    north, east = np.fft.fftfreq(cells, POSTS_M)[:, None], np.fft.rfftfreq(cells, POSTS_M)[None]
    wave = np.hypot(north, east)
    wave[0, 0] = np.inf
    field = np.fft.irfft2(wave ** -(hurst + 1) * np.fft.rfft2(rng.standard_normal((cells, cells))), s=(cells, cells))
    return field / np.sqrt(np.mean((np.diff(field[:, ::2], axis=1)) ** 2))


def gullies(seed: int) -> np.ndarray:
    """A fractal hillside, cut by gullies that run down it 15 m apart, and deepen."""
    rng = np.random.default_rng(seed)
    relief = fractal(rng, 0.8)
    x, y = np.meshgrid(np.arange(260) * POSTS_M, np.arange(260) * POSTS_M)
    across = (x + 0.25 * y + 6 * relief / np.ptp(relief)) / 15
    depth = 2.5 * (1 - y / 130) * np.maximum(0, 1 - 3 * np.abs(across % 1 - 0.5))
    return 100 + 0.2 * y + 0.08 * relief - depth


def dyke(seed: int) -> np.ndarray:
    """A calm field beside broken ground; across it a ditch with sides of 30 deg and a dyke of 2.5 m; a shed, masts."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(260) * POSTS_M, np.arange(260) * POSTS_M)
    broken = 1 / (1 + np.exp((72 - x - 4 * np.sin(y / 11)) / 2))
    height = 100 + 0.01 * y + 0.01 * fractal(rng, 0.6) + broken * 0.2 * fractal(rng, 0.6)
    away = np.abs(y - 60 - 0.3 * x + 10)
    height += np.clip((8 - away) / 2, 0, 2.5) - np.clip(1.7 - np.abs(away - 14) / np.sqrt(3), 0, 1.2)
    height[150:158, 118:130] = height[150, 118] + 3
    height[110, 100], height[96, 150] = height[110, 100] + 6, height[96, 150] + 6
    return height


def yard(seed: int) -> np.ndarray:
    """Boxes of 3 to 6 m on calm ground, and a terrace's wall of 2 m."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(260) * POSTS_M, np.arange(260) * POSTS_M)
    height = 100 + 0.02 * x + 0.02 * fractal(rng, 0.6) + 2.0 * (y > 66 + 0.1 * x)
    for row, column, rise in zip((70, 78, 118, 160, 170), (92, 140, 112, 84, 150), (3, 4, 5, 6, 3), strict=True):
        height[row : row + 16, column : column + 22] = height[row, column] + rise
    return height


def drains(seed: int) -> np.ndarray:
    """A field on a gentle slope, drained by ditches 1 m deep with sides of 45 deg, 13 m apart, along the scan lines."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(260) * POSTS_M, np.arange(260) * POSTS_M)
    away = np.abs((x + 0.1 * y) % 13 - 6.5)
    return 100 + 0.02 * y + 0.02 * fractal(rng, 0.6) - np.clip(1.3 - away, 0, 1)


def lynchets(seed: int) -> np.ndarray:
    """Fields 14 m wide, 1.5 m above one another, whose banks run along the scan lines, nearly."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(260) * POSTS_M, np.arange(260) * POSTS_M)
    field = (x + 0.12 * y + 2 * np.sin(y / 25)) / 14
    bank = np.clip((field % 1 - 0.9) / 0.1, 0, 1)
    return 100 + 1.5 * (np.floor(field) + bank) + 0.02 * y + 0.03 * fractal(rng, 0.6)


# Name, half, ground (drawn; or a file with the first row and column of a part of it), flight.
WORLDS: dict[str, tuple[str, Any, dict[str, Any]]] = {
    "hillside (looked at)": ("looked at", (HILLSIDE, 130, 650), {}),
    "gorge (looked at)": ("looked at", (MOUNTAIN, 390, 650), {}),
    "gullies, first (looked at)": ("looked at", gullies(1), DRAWN),
    "banks": ("judges", (HILLSIDE, 750, 360), {}),
    "mountain, 4 deg": ("judges", (MOUNTAIN, 260, 390), WIDE),
    "gullies, 4 deg": ("judges", gullies(2), DRAWN | WIDE),
    "dyke": ("judges", dyke(3), {}),
    "yard": ("judges", yard(4), {}),
    "steep banks": ("judges", (HILLSIDE, 730, 320), {}),
    "drains": ("judges", drains(5), {"radar.scan.rotation_rpm": 120.0}),
    "lynchets": ("judges", lynchets(6), {"radar.scan.rotation_rpm": 60.0, "radar.chirp_rate_hz": 360.0}),
    "cliff": ("judges", (MOUNTAIN, 130, 260), {}),
    "dyke in rain": ("judges", dyke(3), RAIN),
}
PART_POSTS = 130  # of a file


def _none(*_: Any, **__: Any) -> None:
    return None


def _one(*_: Any, **__: Any) -> float:
    return 1.0


def _all(measured: covariance_fit.Measured, *_: Any) -> np.ndarray:
    return np.ones(len(measured.height_m), dtype=bool)


def patched(*places: tuple[Any, str, Any]) -> Any:
    """Puts something else in some places."""

    def off(monkeypatch: pytest.MonkeyPatch) -> None:
        for module, name, value in places:
            monkeypatch.setattr(module, name, value)

    return off


_above, _information_of = heights.Heights.above, uncertainty.information_of
_linearise, _sides = model.EchoLikelihood.linearise, walls._high_sides


def _every_row(self: model.EchoLikelihood, looks: np.ndarray, fewest_rows: int | None = None) -> model.Linearised:
    return _linearise(self, looks)


def _means_alone(of: heights.Heights, linearised: Any = None, looks_per_cell: float = 1.0) -> uncertainty.Information:
    return _information_of(of)


def _by_normal_equations(of: Any, grid: Any, trend: Any, fitted: Any, local: Any = None) -> smoothing.Smoothed:
    """`smooth_with`, by the solver of whole echoes."""
    terrain = smoothing.TerrainModel(
        smoothing._padded(grid, fitted.covariance.length_m), trend, fitted.covariance, local
    )
    weights = of.weights(terrain.grid)
    whole = weights.T.tocsr().multiply(1 / of.variance_m2(fitted.noise_factor)).tocsr()
    excess = of.height_m - weights @ terrain.trend_m.ravel()
    white = terrain.solve(lambda field: whole @ (weights @ field), terrain.adjoint(whole @ excess), 1000, 1e-6)
    return smoothing.Smoothed(terrain, white, fitted.noise_factor)


MASKED = tuple((each, "low_relief_mask", _all) for each in (smoothing, linear, refinement))
MECHANISMS = (
    Mechanism(
        "local relief",
        "Amplitude of short waves from place to place.",
        ("inference.terrain.local_relief",),
        patched((smoothing, "local_relief", _none), (linear, "local_relief", _none)),
    ),
    Mechanism(
        "misfit between lines",
        "All sigmas are larger where heights of a scan line scatter too much about predictions from other lines.",
        (
            "inference.terrain.local_relief.misfit_between_lines",
            "inference.terrain.local_relief._cross_line_errors",
            "inference.terrain.local_relief._scan_line",
        ),
        patched((uncertainty, "misfit_between_lines", _one), (linear, "misfit_between_lines", _one)),
    ),
    Mechanism(
        "low-relief mask",
        "The covariance is fitted to heights away from poles and walls.",
        ("inference.terrain.local_relief.low_relief_mask", "inference.terrain.local_relief._rms_above_plane"),
        patched(*MASKED),
    ),
    Mechanism(
        "all of local relief",
        "The three above together.",
        ("inference.terrain.local_relief",),
        patched(
            (smoothing, "local_relief", _none),
            (linear, "local_relief", _none),
            (uncertainty, "misfit_between_lines", _one),
            (linear, "misfit_between_lines", _one),
            *MASKED,
        ),
    ),
    Mechanism(
        "information of whole echoes",
        "Sigma of `refined` is smaller than that of mean ranges, by the Fisher information of profiles.",
        ("inference.terrain.uncertainty.information_of", "inference.terrain.uncertainty._noise"),
        patched((refinement, "information_of", _means_alone)),
        ("refined",),
    ),
    Mechanism(
        "unexplained echoes",
        "Sigma is larger in footprints of echoes that the surface does not explain.",
        ("mapping.echo_heights.EchoSurface.outstanding", "inference.terrain.uncertainty.TileUncertainty.unexplained_m"),
        patched((echo_heights.EchoSurface, "outstanding", _none)),
        ("smooth", "refined"),
    ),
    Mechanism(
        "prior of the smoothness",
        "The fit of the covariance leans to rough ground.",
        ("inference.terrain.covariance_fit.PRIOR_NEPERS_SMOOTHNESS",),
        patched((covariance_fit, "PRIOR_NEPERS_SMOOTHNESS", 0.0)),
    ),
    Mechanism(
        "uncorrelated noise",
        "A share of the noise does not repeat between pulses.",
        ("inference.terrain.covariance_fit.UNCORRELATED_NOISE_FRACTION",),
        patched((covariance_fit, "UNCORRELATED_NOISE_FRACTION", 0.0)),
    ),
    Mechanism(
        "microrelief",
        "Real ground is stated to carry fractal relief upon its landforms.",
        ("mapping.mapper.MICRORELIEF_M", "inference.terrain.covariance.Covariance.microrelief"),
        patched((heights.Heights, "above", lambda self, trend, _=0.0: _above(self, trend))),
    ),
    Mechanism(
        "averaged errors of echoes",
        "The error of a mean range is averaged over similar pulses.",
        ("mapping.options.SmoothParameters.similar_pulses",),
        methods=("smooth", "refined"),
        options=(("similar_pulses", 1),),
    ),
    Mechanism(
        "second round",
        "The effect of the beam on mean ranges is predicted again over the first surface.",
        ("mapping.options.SmoothParameters.rounds",),
        methods=("smooth", "refined"),
        options=(("rounds", 1),),
    ),
    Mechanism(
        "repeated speckle",
        "The speckle of neighbouring pulses is the same.",
        ("inference.echo.speckle",),
        patched(
            (model.Sightings, "repeated", lambda self, range_m, **_: np.zeros(len(range_m))),
            (point_heights, "speckle_reach", lambda pulse, *_, **__: np.zeros(len(pulse))),
        ),
    ),
    Mechanism(
        "visibility of gaps",
        "Gaps between lit cells are filled only in view.",
        ("mapping.seen._closed",),
        patched((seen, "VISIBLE_M", np.inf)),
        ("smooth", "refined"),
    ),
    Mechanism(
        "walls of linear",
        "Cells between the foot and the top of a wall stay empty.",
        ("mapping.linear.walls",),
        patched((gridding, "wall_triangles", lambda point_m, sigma_m, corner, *_: np.zeros(len(corner), dtype=bool))),
        ("linear",),
    ),
    Mechanism(
        "steep triangles",
        "A triangle steeper than the ground at its corners is a wall's.",
        ("mapping.linear.walls._steep", "mapping.linear.walls._touching"),
        patched((walls, "_steep", lambda point_m, sigma_m, corner, *_: np.zeros(len(corner), dtype=bool))),
        ("linear",),
    ),
    Mechanism(
        "sides between two levels",
        "A side steeper than the ground beyond both of its ends is a wall's.",
        ("mapping.linear.walls._Sides", "mapping.linear.walls._high_sides", "mapping.linear.walls._slopes_beyond"),
        patched((walls, "_high_sides", lambda *args: _sides(*args).rows(slice(0, 0)))),
        ("linear",),
    ),
    *(
        Mechanism(
            f"`{name}`", sentence, (f"options.LinearParameters.{name}",), methods=("linear",), options=((name, value),)
        )
        for name, value, sentence in (
            ("wall_contrast", 1e-6, "A wall's slope is twice that of the ground around."),
            ("wall_sigmas", 1e-6, "A wall's height is no noise."),
            ("wall_diagonal", 1e6, "Along long sides any jump is a shadow's."),
            ("wall_rounds", 1, "Slopes and walls are found in turn."),
        )
    ),
    Mechanism(
        "noise factor",
        "The variance of the noise is fitted, too.",
        ("inference.terrain.covariance_fit.NOISE_FACTOR_SPREAD",),
        patched(
            (covariance_fit, "NOISE_FACTOR_SPREAD", 1e-3), (covariance_fit.fit_covariance, "__defaults__", (3, 1e-3))
        ),
        ("smooth", "refined"),
    ),
    Mechanism(
        "longest side",
        "Triangles with a long side stay empty.",
        ("mapping.options.LinearParameters.longest_side_gaps",),
        methods=("linear",),
        options=(("longest_side_gaps", 1e6),),
    ),
    Mechanism(
        "shared error behind rain",
        "Sigma holds an error that all heights behind a volume share.",
        ("mapping.points.Points.shared_height_sigma_m", "detection.volume.end.VolumeEnd.shared_sigma_cells"),
        patched((points.Points, "shared_height_sigma_m", 0.0)),
    ),
    Mechanism(
        "Anderson acceleration",
        "Scoring steps are mixed.",
        ("inference.anderson.AndersonAcceleration",),
        patched((refinement.AndersonAcceleration, "next", lambda _, place, step, seen: place + step)),
        ("refined",),
    ),
    Mechanism(
        "thinned rows",
        "Curvature is made from some rows.",
        ("mapping.refined.refinement.ROWS",),
        patched((model.EchoLikelihood, "linearise", _every_row)),
        ("refined",),
    ),
    Mechanism(
        "coarser steps",
        "Steps are solved on a coarser grid.",
        ("inference.terrain.smoothing.TerrainModel.coarser", "inference.terrain.smoothing.TerrainModel.left_out"),
        patched((refinement, "COARSER", (1,))),
        ("refined",),
    ),
    Mechanism(
        "curvature kept",
        "Curvature is computed on the first two surfaces alone.",
        ("mapping.refined.refinement.CURVED",),
        patched((refinement, "CURVED", 12)),
        ("refined",),
    ),
    Mechanism(
        "occlusion kept",
        "Rays start where they met the last surface.",
        ("mapping.refined.refinement.COARSE_M",),
        patched((refinement, "COARSE_M", 0.0)),
        ("refined",),
    ),
    Mechanism(
        "curvature on cells",
        "The curvature of a pulse is brought onto cells.",
        (
            "mapping.refined.curvature.curvature_on_cells",
            "mapping.refined.curvature.touch",
            "mapping.refined.curvature.onto_cells",
            "mapping.refined.curvature.curve_cells",
        ),
        patched((refinement, "curvature_on_cells", curvature._by_nodes)),
        ("refined",),
    ),
    Mechanism(
        "kriging solver",
        "Mean ranges are solved for in their own space, with an approximate inverse.",
        (
            "inference.terrain.kriging.Kriging.near_inverse",
            "inference.terrain.smoothing.smooth_with",
            "inference.terrain.smoothing.TerrainModel.covaried",
        ),
        patched((smoothing, "smooth_with", _by_normal_equations)),
        ("smooth", "refined"),
    ),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    kept = os.environ.get("SIONNA_RADAR_STUDY")
    found = Path(kept) if kept else tmp_path_factory.mktemp("mechanisms")
    found.mkdir(parents=True, exist_ok=True)
    return found


def flown(folder: Path, name: str, seed: int) -> Flight | None:
    """A flight over a world; None over a file that is not here."""
    _, ground, changes = WORLDS[name]
    path = folder / f"{name.replace(' ', '_')}.tif"
    if isinstance(ground, tuple):
        if not place_of(ground[0]).exists():
            return None
        with rasterio.open(place_of(ground[0])) as file:
            row, column = ground[1:]
            height = file.read(1)[row : row + PART_POSTS, column : column + PART_POSTS]
        write_heights(path, height.astype(np.float32), from_origin(WEST, NORTH, 1.0, 1.0))
    else:
        write_heights(path, ground.astype(np.float32), from_origin(WEST, NORTH, POSTS_M, POSTS_M))
    wanted = FLIGHT | changes | {"inference.terrain.path": str(path), "seed": seed}
    return Flight({key: value for key, value in wanted.items() if value is not None})


def scores(folder: Path, name: str, seed: int) -> dict[str, Score]:
    """The scores of all maps of a flight, by mechanism and method; `on` with all of them."""
    kept = folder / f"{name.replace(' ', '_')}-{seed}.json"
    found = {key: Score(**value) for key, value in json.loads(kept.read_text()).items()} if kept.exists() else {}
    wanted = [Mechanism("on", "", ()), *MECHANISMS]
    missing = [(each, method) for each in wanted for method in each.methods if f"{each.name}|{method}" not in found]
    flight = flown(folder, name, seed) if missing else None
    for each, method in missing if flight else []:
        if not found:
            flight.score(method)  # compiles
        with pytest.MonkeyPatch.context() as monkeypatch:
            each.off(monkeypatch)
            found[f"{each.name}|{method}"] = flight.score(method, each.options)
        kept.write_text(json.dumps({key: asdict(value) for key, value in found.items()}))
    return found


def ledger(gains: dict[str, dict[str, Gain]]) -> str:
    """The table of mechanisms, by the place (world and method) where each wins most."""
    lines = [
        "| mechanism | lines | wins most | RMS | coverage | interval | time | |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for each in MECHANISMS:
        own = gains[each.name]
        place, most = max(own.items(), key=lambda item: item[1].greatest)
        lines.append(
            f"| {each.name} | {each.lines} | {place} | {100 * most.rms:+.1f} % | {most.filled:+.1f} | "
            f"{most.interval:+.1f} ({most.which}) | {np.median([each.slower for each in own.values()]):.2f} | "
            f"{'stays' if most.earned else '-'} |"
        )
    return "\n".join(lines)


@pytest.mark.study
def test_ledger(folder):
    gains: dict[str, dict[str, Gain]] = {each.name: {} for each in MECHANISMS}
    for name, (half, *_) in WORLDS.items():
        every = [scores(folder, name, seed) for seed in SEEDS]
        for each in MECHANISMS if half == "judges" and every[0] else ():
            for method in each.methods:
                keys = f"on|{method}", f"{each.name}|{method}"
                gains[each.name][f"{name}, `{method}`"] = gain(*([scored[key] for scored in every] for key in keys))
    assert all(gains.values()), "a mechanism that no world judges"
    print(ledger(gains))
