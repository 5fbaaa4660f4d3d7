"""What each number of mapping and detection decides: `pytest -m study -n 0 -s tests/studies/test_constants.py`.

Every constant is halved and doubled, and short surveys are mapped anew over terrain on which none was chosen: a quarry,
terraces, dunes, and what a lidar measured above Lake Tahoe, if `python tests/real_files.py` fetched it.
`SIONNA_RADAR_STUDY=folder` keeps what was found, so that a study that was cut goes on. An hour on one core.
"""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from constant_study import (
    DOUBLE,
    HALF,
    NOT_VARIED,
    Constant,
    Survey,
    Variation,
    constants,
    kept,
    run_variations,
    scaled,
    sensitivities,
    tolerances,
)
from elevation_files import NORTH, WEST, from_origin, write_heights
from real_files import TAHOE, place_of
from sionna_radar import load_scenario, run
from sionna_radar.mapping.options import CanopyParameters, LinearParameters, SmoothParameters, SteppedParameters
from sionna_radar.scenario.processing import VolumeTable
from sionna_radar.scenario.table import unit_of

REAL = place_of(TAHOE)
FLIGHT = {
    "platform.length_m": 20.0,
    "platform.altitude_m": 40.0,
    "platform.height": "level",
    "radar.chirp_rate_hz": 720.0,
    "radar.scan.rotation_rpm": 240.0,
    "radar.scan.half_swath_deg": 25.0,
    "radar.scan.incidence_deg": 40.0,
}
RAIN = {
    "weather.rain_rate_mm_per_h": 6.0,
    "radar.snr_db": None,
    "radar.transmit_power_dbm": 10.0,
    "radar.noise_figure_db": 15.0,
}
# Long enough for several tiles and blocks.
LONG = {"platform.length_m": 200.0, "radar.scan.rotation_rpm": 120.0, "radar.chirp_rate_hz": 360.0}
PLANTED = "maize"
CLEAR, RAINY, LENGTHY = ("quarry", "terraces", "dunes", "real"), ("quarry in rain", "dunes in rain"), ("long dunes",)


def _places(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    return np.meshgrid((np.arange(columns) + 0.5) / 2 - columns / 4, (np.arange(rows) + 0.5) / 2 - rows / 4)


def quarry() -> np.ndarray:
    """Benches 9 m wide, between faces 3 m high that rise over 2 m."""
    x, y = _places(240, 240)
    inward = (38 - np.hypot(x - 5, 1.3 * (y + 3)) - 2.5 * np.sin(3 * np.arctan2(y + 3, x - 5))) / 9
    bench = np.floor(np.clip(inward, 0, 3))
    return 100 - 3 * np.where(inward < 0, 0.0, bench + np.clip((inward - bench) * 9 / 2, 0, 1))


def terraces() -> np.ndarray:
    """Fields on a hillside, 2.4 m above one another, with walls a fifteenth of their width."""
    x, y = _places(240, 240)
    rise = 8 + 0.12 * x + 0.05 * y + 1.5 * np.sin(x / 23 + y / 31)
    field = np.floor(rise / 1.6)
    return 100 + 2.4 * (field + np.clip((rise / 1.6 - field - 0.93) / 0.07, 0, 1)) + 0.02 * x


def dunes(columns: int = 240) -> np.ndarray:
    """Ridges 22 m apart and 3.5 m high, gentle to windward, with slip faces of 35 deg."""
    x, y = _places(240, columns)
    phase = (0.9 * x + 0.3 * y + 4 * np.sin(y / 17)) / 22 % 1
    return 100 + gaussian_filter(3.5 * np.where(phase < 0.78, phase / 0.78, (1 - phase) / 0.22), 1.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    kept = os.environ.get("SIONNA_RADAR_STUDY")
    found = Path(kept) if kept else tmp_path_factory.mktemp("constants")
    found.mkdir(parents=True, exist_ok=True)
    return found


@pytest.fixture(scope="module")
def recordings(folder) -> dict[str, Path]:
    """The beat signals of each flight, with the truth under them."""
    grounds = {"quarry": quarry(), "terraces": terraces(), "dunes": dunes(), "long dunes": dunes(720)}
    flights = dict.fromkeys(CLEAR, FLIGHT) | dict.fromkeys(RAINY, FLIGHT | RAIN) | {LENGTHY[0]: FLIGHT | LONG}
    found = {}
    for name, flight in flights.items():
        ground = name.removesuffix(" in rain")
        recording, path = folder / f"{name.replace(' ', '_')}.nc", REAL
        if ground != "real":
            path = folder / f"{ground.replace(' ', '_')}.tif"
            write_heights(path, grounds[ground].astype(np.float32), from_origin(WEST, NORTH, 0.5, 0.5))
        elif not REAL.exists():
            continue
        if not recording.exists():
            overrides = {key: value for key, value in flight.items() if value is not None}
            survey = run(
                load_scenario("own_dem", overrides | {"terrain.path": str(path)}), recordings={"signals": recording}
            )
            print(f"{name}: {survey}")
        found[name] = recording
    found[PLANTED] = folder / f"{PLANTED}.nc"
    if not found[PLANTED].exists():
        run(load_scenario("maize", {"platform.length_m": 20.0}), recordings={"signals": found[PLANTED]})
    return found


# The flights and methods that the constants of a room matter to; of a module, where it has its own.
MAPS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "mapping.stepped": (("quarry", "terraces", "dunes"), ("stepped",)),
    "mapping.canopy": ((PLANTED,), ("canopy",)),
    "inference.echo.layer": ((PLANTED,), ("canopy",)),
    "inference.terrain": (CLEAR, ("smooth",)),
    "detection.volume": (RAINY[1:], ("linear",)),
    "inference.echo": (CLEAR, ("refined",)),
    "mapping.refined": (CLEAR, ("refined",)),
    "mapping.linear": (CLEAR, ("linear",)),
    "mapping": (CLEAR, ("linear", "smooth")),
    "detection": (CLEAR, ("linear",)),
    "detection.ranging": (CLEAR, ("linear",)),
}
RANGING = {"detection.ranging.plane_fit": "model_fit", "detection.ranging.estimators": "leading_edge"}
# Extents, which only a long survey exceeds.
EXTENTS = {"TILE_M", "OVERLAP_M", "BLOCK_CELLS", "MAX_ECHOES", "MARGIN_M", "GROUP", "GROUPS"} | {
    *("tile_m", "overlap_m"),
}
# Directions inside the beam need receivers that a recording does not hold.
WITHOUT_MAPS = {"detection.angle"}
# A tolerance is technical that moves the map by no more than this share of its error, fills or empties no more than
# this share of the lit cells, and brings no more than this share of them into the 95 % interval or out of it.
MOVED, FILLED, INSIDE = 0.1, 0.01, 0.02


def surveys_of(constant: Constant, recordings: dict[str, Path]) -> tuple[Survey, ...]:
    flights, methods = MAPS.get(constant.module, MAPS[constant.room])
    settings = (("processing.ranging", RANGING[constant.module]),) if constant.module in RANGING else ()
    if constant.name in EXTENTS and constant.room.startswith("mapping"):
        flights = (*flights, *LENGTHY)
    return tuple(Survey(name, recordings[name], methods, settings) for name in flights if name in recordings)


def decides(result: dict[str, Any]) -> bool:
    """Whether a variation changes a map by more than a technical tolerance may, or cannot be flown."""
    return "failed" in result or any(
        abs(change["error"]) > MOVED
        or not change["moved"] <= MOVED
        or change["filled"] > FILLED
        or abs(change["inside"]) > INSIDE
        for change in result.values()
    )


def _excuse(constant: Constant) -> str:
    """Why a constant is not varied; empty for one that is."""
    if constant.room in WITHOUT_MAPS:
        return "no map is made by it"
    own = {constant.name, ".".join(str(constant).split(".")[-2:])}
    return next((reason for reason, names in NOT_VARIED.items() if own & names), "")


def _variation(constant: Constant, factor: float, recordings: dict[str, Path]) -> tuple[Variation, tuple[Survey, ...]]:
    which = "double" if factor > 1 else "half"
    return Variation(f"{constant}-{which}", constant, factor), surveys_of(constant, recordings)


@pytest.mark.study
def test_constants(folder, recordings):
    methods = ("linear", "smooth", "refined", "stepped")
    every = tuple(
        Survey(name, path, methods if name not in RAINY else ("linear",)) for name, path in recordings.items()
    )
    every = tuple(each for each in every if each.name != PLANTED)
    every += (Survey(PLANTED, recordings[PLANTED], ("canopy",)),)
    every += tuple(
        Survey(name, recordings[name], ("linear",), (("processing.ranging", estimator),))
        for estimator in RANGING.values()
        for name in CLEAR
        if name in recordings
    )
    processes = int(os.environ.get("SIONNA_RADAR_PROCESSES", "1"))
    run_variations(folder, [(Variation("base"), every)])
    varied = sorted((each for each in constants() if not _excuse(each)), key=lambda each: list(MAPS).index(each.room))
    for room in MAPS:
        own = [each for each in varied if each.room == room]
        run_variations(folder, [_variation(each, DOUBLE, recordings) for each in own], processes)
        # What decides when it is doubled need not be halved.
        rest = [each for each in own if not decides(kept(folder, f"{each}-double"))]
        run_variations(folder, [_variation(each, HALF, recordings) for each in rest], processes)
    optional = [
        (Variation(f"{key}-{which}", options=((key, scaled(default, factor)),)), flights_of(key, recordings))
        for key, _, default in options()
        for which, factor in (("half", HALF), ("double", DOUBLE))
    ]
    run_variations(folder, optional, processes)
    clear = tuple(name for name in CLEAR if name in recordings)
    keys = [(key, unit, f"{default:g}") for key, unit, default in options()]
    of_maps = [each for each in keys if each[0].startswith("dem")]
    parts = [
        sensitivities(folder, of_maps, clear),
        sensitivities(folder, [each for each in keys if each not in of_maps], RAINY),
        tolerances(folder, varied),
    ]
    (folder / "sensitivity.md").write_text("\n\n".join(parts))
    deciding = [
        str(each) for each in varied if any(decides(kept(folder, f"{each}-{which}")) for which in ("half", "double"))
    ]
    print("constants that decide:", *deciding, sep="\n")
    listed = PAGE[: PAGE.index("## Technical tolerances")]
    assert [each for each in deciding if f"`{each.rsplit('.', 1)[-1]}`" not in listed] == []


def options() -> list[tuple[str, str, float]]:
    """All numeric options of the methods and of detection behind a volume: key, unit and default."""
    tables = (
        ("dem.linear", LinearParameters, ()),
        ("dem.smooth", SmoothParameters, ()),
        ("dem.stepped", SteppedParameters, SmoothParameters.model_fields),
        ("dem.canopy", CanopyParameters, SmoothParameters.model_fields),
        ("processing.volume", VolumeTable, ()),
    )
    return [
        (f"{place}.{name}", unit_of(name), field.default)
        for place, table, others in tables
        for name, field in table.model_fields.items()
        if name not in others
    ]


def flights_of(key: str, recordings: dict[str, Path]) -> tuple[Survey, ...]:
    """The flights and methods that an option matters to."""
    method, name = key.split(".")[1:]
    if method == "canopy":
        return (Survey(PLANTED, recordings[PLANTED], ("canopy",)),)
    names = RAINY if method == "volume" else (*CLEAR, *LENGTHY) if name in EXTENTS else CLEAR
    methods = ("linear",) if method == "volume" else (method,)
    return tuple(Survey(each, recordings[each], methods) for each in names if each in recordings)


PAGE = (Path(__file__).parents[2] / "docs" / "theory" / "sensitivity.md").read_text(encoding="utf-8")


def test_every_constant_and_option_is_on_the_page():
    """One that is new is to be varied, and derived or made an option if it decides."""
    rows = PAGE.splitlines()
    missing = [
        str(each)
        for each in constants()
        if not any(f"`{each.module}`" in row and f"`{each.name}`" in row for row in rows)
    ]
    assert missing == []
    assert [key for key, _, _ in options() if f"`{key}`" not in PAGE] == []
