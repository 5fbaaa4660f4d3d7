"""The twin of a recording: alike with other seeds, and the right row differs for each thing that is changed."""

import json
import shutil
import warnings
from pathlib import Path

import h5py
import numpy as np
import pytest
from pyproj import Transformer
from scipy.constants import speed_of_light
from scipy.signal import lfilter

from elevation_files import cell_centres, from_origin, write_heights
from sionna_radar import load_scenario, prepare, run
from sionna_radar import twin as run_twin
from sionna_radar.flight.pulses import MeasuredPoseFlight
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.studies.twin.document import DOCUMENT, twin_page
from sionna_radar.studies.twin.statistics import FALSE_ALARM, Statistic, rows_of
from sionna_radar.survey.custom_parts import CustomParts

pytestmark = pytest.mark.usefixtures("rough_errors")

BLOCKS, LENGTH = 48, 20


def walk(rng: np.random.Generator, correlation: float) -> np.ndarray:
    """A stationary series of unit variance whose neighbours correlate."""
    steps = rng.normal(size=BLOCKS * LENGTH) * np.sqrt(1 - correlation**2)
    steps[0] = rng.normal()
    return lfilter([1.0], [1.0, -correlation], steps)


def means(measured: np.ndarray, simulated: np.ndarray) -> Statistic:
    ones = np.ones(len(measured))
    return Statistic(
        name="mean",
        unit="",
        of=lambda sums: sums[..., 1] / sums[..., 0],
        measured=np.stack([ones, measured], axis=1),
        simulated=np.stack([ones, simulated], axis=1),
        block=np.arange(len(measured)) // LENGTH,
        needs=lambda measured, simulated: f"{measured - simulated:+.1f}",
    )


def test_the_rate_of_false_alarms_is_that_of_all_rows_together_and_holds_along_correlated_tracks():
    """200 trials of four rows at 1 %: more than 8 alarms have a probability of 2e-4."""
    rng = np.random.default_rng(3)
    alarms = 0
    for trial in range(200):
        rows = rows_of([means(walk(rng, 0.7), walk(rng, 0.7)) for _ in range(4)], BLOCKS, trial)
        alarms += any(row.differs for row in rows)
    assert FALSE_ALARM == 0.01
    assert alarms <= 8


def test_a_difference_is_found_with_its_deviation():
    """The mean of independent values: the deviation of the difference is the square root of 2 over their number."""
    rng = np.random.default_rng(4)
    one, other = walk(rng, 0.0), walk(rng, 0.0)
    (alike,) = rows_of([means(one, other)], BLOCKS, 1)
    assert alike.sigma == pytest.approx(np.sqrt(2 / (BLOCKS * LENGTH)), rel=0.25)
    assert not alike.differs
    (row,) = rows_of([means(one + 0.5, other)], BLOCKS, 1)
    assert row.differs
    assert row.needs == f"{row.difference:+.1f}"


def test_a_statistic_without_any_value_is_no_row_and_no_warning():
    rng = np.random.default_rng(5)
    nothing = np.full(BLOCKS * LENGTH, np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (row,) = rows_of([means(nothing, nothing), means(walk(rng, 0.0), walk(rng, 0.0))], BLOCKS, 1)
    assert not row.differs


FLOWN = {
    "platform.length_m": 25.0,
    "terrain.spacing_m": 2.0,
    "tracing.paths_per_pulse": 128,
    "radar.sampling": "iq",
    "radar.samples_per_chirp": 512,
    "radar.snr_db": None,
    "radar.transmit_power_dbm": 10.0,
    "radar.noise_figure_db": 12.0,
    "materials.ground": {"model": "constant_gamma", "gamma_db": -10.0},
}


@pytest.fixture(scope="module")
def flown(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("twin") / "flown.nc"
    run(load_scenario("hills", FLOWN), recordings={"signals": path})
    return path


@pytest.fixture(scope="module")
def alike(flown):
    return run_twin(flown)


def test_with_another_seed_nothing_differs(alike):
    assert alike.differing == ()
    assert alike.scenario.seed == 2
    names = [row.name for row in alike.rows]
    assert len(names) >= 13
    assert {"noise floor", "echo width", "speckle contrast", "range bias", "DEM spread"} <= set(names)


def test_offsets_that_no_pulse_samples_are_in_no_profile(tmp_path):
    """From 12 m up a wide beam's echo at a slant begins less than its own length behind the radar."""
    scan = {"mode": "conical", "incidence_deg": 60.0, "half_swath_deg": 40.0, "rotation_rpm": 200.0}
    low = {"platform.altitude_m": 12.0, "platform.length_m": 12.0, "radar.antenna.beamwidth_deg": 8.0}
    run(load_scenario("hills", FLOWN | low | {"radar.scan": scan}), recordings={"signals": tmp_path / "low.nc"})
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        twin = run_twin(tmp_path / "low.nc")
    assert -twin.profile_m[0] < twin.profile_m[-1]
    assert all(np.isfinite(power).all() and power.shape == twin.profile_m.shape for power in twin.profiles)


NOISY = [[1e4, -62.0], [1e5, -77.0], [1e6, -92.0]]


@pytest.mark.parametrize(
    ("changes", "name", "measured_is", "needs"),
    [
        ({"radar.antenna.beamwidth_deg": 2.4}, "echo width", "less", "beam of 2.0"),
        ({"materials.ground.gamma_db": -7.0}, "echo power at 45 to 60 deg", "less", "(gamma), or twice the gain, -3."),
        ({"radar.noise_figure_db": 6.0}, "noise floor", "more", "noise figure, or gain, +6.0 dB"),
        (
            {"radar.receiver.oscillator.phase_noise_dbc_hz": NOISY},
            "floor that follows the echo",
            "less",
            "phase noise or side lobes",
        ),
    ],
)
def test_what_is_changed_is_told_by_its_row(flown, changes, name, measured_is, needs):
    row = run_twin(flown, overrides=changes).row(name)
    assert row.differs
    assert (row.difference < 0) == (measured_is == "less")
    assert needs in row.needs


def test_the_power_over_a_cover_is_told_apart_from_that_of_the_others(tmp_path):
    field = {
        "terrain.fields": [{"centre_m": [-37.0, 22.0], "size_m": [40.0, 44.0], "material": "gravel"}],
        "materials.gravel": {"model": "constant_gamma", "gamma_db": -10.0},
    }
    run(load_scenario("hills", FLOWN | field), recordings={"signals": tmp_path / "flown.nc"})
    twin = run_twin(tmp_path / "flown.nc", overrides={"materials.gravel.gamma_db": -4.0})
    gravel, ground = (twin.row(f"echo power over {name}") for name in ("gravel", "ground"))
    assert gravel.differs
    assert gravel.difference == pytest.approx(-6.0, abs=1.0)
    assert abs(ground.difference) < 1.0
    assert not ground.differs


def test_a_bias_of_range_is_told_with_its_size(flown, tmp_path):
    path = shutil.copy(flown, tmp_path / "biased.nc")
    with h5py.File(path, "r+") as file:
        beat = file["beat_i"][...] + 1j * file["beat_q"][...]
        radar = file["radar"].attrs
        slope = radar["bandwidth_hz"] * radar["sampling_rate_hz"] / beat.shape[1]
        time_s = np.arange(beat.shape[1]) / radar["sampling_rate_hz"]
        beat *= np.exp(2j * np.pi * 2 * slope * 0.3 / speed_of_light * time_s)
        file["beat_i"][...], file["beat_q"][...] = beat.real, beat.imag
    twin = run_twin(path)
    row = twin.row("range bias")
    assert row.differs
    assert row.difference == pytest.approx(0.3, abs=4 * row.sigma)
    assert row.needs == f"range_zero_m {row.difference:+.3f} m"
    lower = twin.row("DEM bias")
    assert lower.difference < 0
    # One cause, of one sign: the beam looks down at some 45 to 60 deg.
    zero_m = float(lower.needs.split("range_zero_m ")[1].removesuffix(" m"))
    assert zero_m == pytest.approx(row.difference, abs=0.1)
    assert not twin.row("echo power at 45 to 60 deg").differs


def test_errors_of_navigation_are_drawn_in_the_twin_as_in_the_recording(tmp_path):
    """Constant and white errors; a drift is one draw in each flight, which no other seed repeats."""
    errors = {"position_constant_m": [0.0, 0.0, 0.4], "position_white_m": [0.0, 0.0, 0.3], "attitude_white_deg": 0.2}
    run(load_scenario("hills", FLOWN | {"platform.navigation": errors}), recordings={"signals": tmp_path / "flown.nc"})
    ideal = run_twin(tmp_path / "flown.nc", overrides={"platform.navigation": {}})
    # A pose reported too high is ranged too short, and maps its ground too high.
    assert ideal.row("range bias").difference < -0.3
    assert ideal.row("DEM bias").difference == pytest.approx(0.4, abs=0.15)
    assert {"range bias", "range spread", "DEM bias"} <= set(ideal.differing)
    assert run_twin(tmp_path / "flown.nc").differing == ()


@pytest.mark.parametrize("table", [{"time_offset_s": 0.05}, {"lever_arm_m": [1.0, 0.5, 0.2], "lever_arm_error_m": 0.1}])
def test_the_true_poses_of_a_twin_are_those_that_its_navigation_reports_as_recorded(table):
    """On a level straight flight, to the product of two errors: 0.1 m/s over 0.05 s before the first pulse."""
    errors = {
        "position_constant_m": 0.3,
        "velocity_constant_mps": 0.1,
        "boresight_error_deg": [0.3, 0.2, -0.4],
        **table,
    }
    scenario = load_scenario("hills", {"platform.length_m": 20.0, "platform.navigation": errors})
    prepared = prepare(scenario)
    every = prepared.flight.pulses(np.arange(len(prepared)))
    again = prepare(scenario, CustomParts(flight=MeasuredPoseFlight(pulses=every))).flight.pulses(every.index)
    for name, tolerance in (("position_m", 6e-3), ("velocity_mps", 1e-6), ("R_world_antenna", 1e-4)):
        np.testing.assert_allclose(getattr(again.measured, name), getattr(every.measured, name))
        ours, theirs = (getattr(pulses.true, name) for pulses in (again, every))
        np.testing.assert_allclose(ours, theirs, atol=tolerance)


@pytest.fixture
def foreign(flown, tmp_path) -> Path:
    """The recording as of a real radar: counts of a converter, and neither scenario nor truth."""
    path = shutil.copy(flown, tmp_path / "foreign.nc")
    with h5py.File(path, "r+") as file:
        for name in ("scenario", "survey", "true_height", "lit"):
            del file[name]
        for name in ("beat_i", "beat_q"):
            file[name][...] = 3e6 * file[name][...]
    return path


def test_a_recording_in_an_unknown_unit_is_compared_over_its_floor(foreign):
    base = {key: value for key, value in FLOWN.items() if key not in ("platform.length_m", "radar.samples_per_chirp")}
    twin = run_twin(foreign, base="hills", overrides=base)
    assert twin.differing == ()
    assert not twin.levels_known
    names = [row.name for row in twin.rows]
    assert "noise floor" not in names
    assert twin.row("echo power at 45 to 60 deg").measured > 30
    with pytest.raises(ScenarioError, match=r"--base: is needed"):
        run_twin(foreign)


UTM = "EPSG:32631"


@pytest.mark.parametrize("crs", [UTM, "EPSG:32632"])
def test_a_recording_on_the_map_flies_over_a_raster_in_its_own_crs_or_another(tmp_path, crs):
    """A slope; the raster of the other zone has its north turned by the convergence of 1.0 and 3.3 deg."""
    east, north = (609_000.0, 5_095_000.0)

    def raster(name: str, crs: str) -> Path:
        to_own = Transformer.from_crs(crs, UTM, always_xy=True)
        x, y = to_own.transform(east, north, direction="INVERSE")
        place = from_origin(round(x) - 200.0, round(y) + 200.0, 1.0, 1.0)
        own_east, own_north = to_own.transform(*cell_centres(place, 400, 400))
        height = 100.0 + 0.1 * (own_east - east) - 0.05 * (own_north - north)
        return write_heights(tmp_path / name, height, place, crs=crs)

    radar = {key: value for key, value in FLOWN.items() if key.startswith(("radar", "materials"))}
    ground = {"terrain": {"kind": "raster", "path": str(raster("own.tif", UTM))}}
    track = {"platform.start_m": [-20.0, 0.0], "platform.length_m": 20.0}
    run(load_scenario("hills", ground | track | radar), recordings={"signals": tmp_path / "flown.nc"})
    reference = raster("reference.tif", crs)
    twin = run_twin(tmp_path / "flown.nc", terrain=reference)
    assert twin.differing == ()
    assert abs(twin.row("range bias").measured) < 0.1
    assert abs(twin.row("DEM bias").measured) < 0.1


def test_what_cannot_be_flown_again_is_one_clear_error(flown, foreign, tmp_path):
    with pytest.raises(ScenarioError, match=r"radar: the scenario's bandwidth_hz is"):
        run_twin(flown, overrides={"radar.bandwidth_hz": 400e6})
    with pytest.raises(ScenarioError, match=r"seed: 1 is the recording's own"):
        run_twin(flown, overrides={"seed": 1})
    ground = write_heights(tmp_path / "dem.tif", np.zeros((50, 50)), from_origin(5e5, 5e6, 1.0, 1.0), crs=UTM)
    with pytest.raises(ScenarioError, match=r"terrain: the recording has no place on the map"):
        run_twin(flown, terrain=ground)
    with h5py.File(foreign, "r+") as file:
        for name in ("measured_position", "measured_velocity", "measured_rotation"):
            del file[name]
    with pytest.raises(InputFileError, match="has no poses, which a twin flies"):
        run_twin(foreign, base="hills")


def test_a_twin_leaves_its_numbers_and_its_page(alike, tmp_path):
    files = {path.name for path in DOCUMENT.write(alike, tmp_path / "out")}
    assert {"twin.json", "report.html", "scenario.toml"} <= files
    document = json.loads((tmp_path / "out" / "twin.json").read_text())
    assert document == DOCUMENT.content(alike)
    assert document["false_alarm_rate"] == FALSE_ALARM
    page = twin_page(alike)
    for row in alike.rows:
        assert row.name in page
    assert "sionna-radar twin flown.nc" in page


PERSISTENT = {"tracing.speckle": "persistent"}


@pytest.mark.study
@pytest.mark.parametrize("changes", [{}, PERSISTENT, PERSISTENT | {"platform.length_m": 60.0}])
def test_other_seeds_differ_in_no_row_in_95_of_100(tmp_path, changes):
    """Each recording and each twin has a seed of its own."""
    alarms = []
    for seed in range(0, 200, 2):
        path = tmp_path / f"{seed}.nc"
        run(load_scenario("hills", FLOWN | changes | {"seed": seed}), recordings={"signals": path})
        twin = run_twin(path)
        path.unlink()
        alarms += [twin.differing] if twin.differing else []
    print(f"{len(alarms)} of 100 differ: {alarms}")
    assert len(alarms) <= 5


@pytest.mark.study
def test_readings_with_other_seeds_differ_in_no_row_in_95_of_100(tmp_path):
    alarms = []
    for seed in range(0, 200, 2):
        twin = run_twin(read_by_radar(tmp_path, seed), base="hills", overrides=ALTIMETER | {"seed": seed + 1})
        alarms += [twin.differing] if twin.differing else []
    print(f"{len(alarms)} of 100 differ: {alarms}")
    assert len(alarms) <= 5


ALTIMETER = {
    "platform.length_m": 60.0,
    "terrain.spacing_m": 1.0,
    "radar.scan": {"mode": "fixed", "incidence_deg": 0.0},
    "radar.antenna": {"kind": "taylor", "beamwidth_deg": 6.0, "side_lobe_db": -20.0},
    "radar.chirp_rate_hz": 50.0,
    "dem": {"method": "smooth", "spacing_m": 1.0},
}


def read_by_radar(folder: Path, seed: int, bias_m: float = 0.0) -> Path:
    """Strongest ranges of a simulated altimeter as a table of readings, with a log of its flight."""
    survey = run(load_scenario("hills", ALTIMETER | {"seed": seed}))
    points, count = survey.points, survey.pulses
    range_m = np.full(count, np.nan)
    order = np.argsort(points.power, kind="stable")
    range_m[points.pulse[order]] = points.range_m[order] + bias_m
    pulses = survey.schedule.pulses(np.arange(count))
    rows = [f"{t:.4f},{'' if np.isnan(r) else f'{r:.4f}'}" for t, r in zip(pulses.time_s, range_m, strict=True)]
    (folder / "read.csv").write_text("\n".join(["time_s,range_m", *rows]))
    position_m, step_s = pulses.true.position_m, pulses.time_s[1] - pulses.time_s[0]
    ends = [(n, position_m[n] + side * step_s * pulses.true.velocity_mps[n]) for n, side in ((0, -1), (-1, 1))]
    fixes = [(pulses.time_s[n] + side * step_s, *place) for (n, place), side in zip(ends, (-1, 1), strict=True)]
    log = ["time_s,east_m,north_m,up_m,roll_deg,pitch_deg,heading_deg"]
    log += [f"{t:.5f},{x:.4f},{y:.4f},{z:.4f},0,0,90" for t, x, y, z in np.linspace(*fixes, 50)]
    (folder / "flight.csv").write_text("\n".join(log))
    text = f'[readings]\nfile = "read.csv"\nrange_cell_m = 0.3\n[poses]\nlog = "flight.csv"\nfirst_pulse_s = {step_s}\n'
    (folder / "read.toml").write_text(text + '[dem]\nmethod = "smooth"\nspacing_m = 1.0\n')
    return folder / "read.toml"


def test_readings_of_an_altimeter_are_compared_by_their_ranges(tmp_path):
    twin = run_twin(read_by_radar(tmp_path, 1), base="hills", overrides=ALTIMETER | {"seed": 2})
    assert twin.differing == ()
    assert {"range bias", "range spread", "DEM bias"} <= {row.name for row in twin.rows}
    assert "noise floor" not in {row.name for row in twin.rows}
    document = DOCUMENT.content(twin)
    assert document["echo"]["offset_m"] == []
    assert "profile" not in {line.partition('id="')[2].partition('"')[0] for line in twin_page(twin).splitlines()}
    assert "report.html" in {file.name for file in DOCUMENT.write(twin, tmp_path / "out")}
    row = run_twin(read_by_radar(tmp_path, 1, 0.3), base="hills", overrides=ALTIMETER | {"seed": 2}).row("range bias")
    assert row.differs
    assert row.difference == pytest.approx(0.3, abs=4 * row.sigma)
    with pytest.raises(ScenarioError, match="--base: is needed"):
        run_twin(tmp_path / "read.toml")
