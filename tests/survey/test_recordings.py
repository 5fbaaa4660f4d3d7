"""Recordings: what they hold, as xarray reads it, and what processing makes of them."""

import contextlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr
from rich.console import Console
from scipy.constants import speed_of_light

from sionna_radar import RadarError, ScenarioError, load_scenario, parse_scenario, prepare, process, run, to_toml
from sionna_radar.foundation.errors import InputFileError, OutputError
from sionna_radar.mapping.points import Points
from sionna_radar.radar import Antenna, taylor_cut
from sionna_radar.report.processed.products import write_processed
from sionna_radar.report.processed.table import processed_table
from sionna_radar.report.survey.products import write_survey
from sionna_radar.survey.recordings import netcdf

SHORT = {"platform.length_m": 6.0}
COARSE = {"terrain.spacing_m": 2.0}
DATA = Path(os.environ.get("SIONNA_RADAR_RECORDINGS") or Path(__file__).parents[2].parent / "shared" / "data")


def recorded(folder, overrides, *kinds, scene="hills", **more):
    files = {kind: folder / f"{kind}.nc" for kind in kinds or ("signals",)}
    coarse = COARSE if scene == "hills" else {}
    return run(load_scenario(scene, SHORT | coarse | overrides), recordings=files, **more), files


def render(table):
    console = Console(width=200, record=True, file=io.StringIO())
    console.print(table)
    return console.export_text()


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A survey with errors of navigation, and its three recordings."""
    wrong = {"platform.navigation.position_markov_m": 0.3}
    return recorded(tmp_path_factory.mktemp("flown"), wrong, "signals", "paths", "profiles")


def test_xarray_reads_the_beat_signals_and_the_poses(flown):
    survey, files = flown
    prepared, pulses = survey.prepared, survey.schedule.pulses(np.arange(survey.pulses))
    sensor = prepared.build_sensor()
    with xr.open_dataset(files["signals"], engine="h5netcdf") as file:
        assert file.attrs["Conventions"] == "CF-1.11"
        assert file.beat_i.dims == ("pulse", "sample")
        np.testing.assert_array_equal(file.beat_i, sensor.observe(pulses).beats[0])
        np.testing.assert_array_equal(file.time, pulses.time_s)
        np.testing.assert_array_equal(file.sample_time, prepared.receiver.chirp.sample_time_s)
        for name, pose in (("true", pulses.true), ("measured", pulses.measured)):
            np.testing.assert_array_equal(file[f"{name}_position"], pose.position_m)
            np.testing.assert_array_equal(file[f"{name}_velocity"], pose.velocity_mps)
            np.testing.assert_array_equal(file[f"{name}_rotation"], pose.R_world_antenna)
        assert np.abs(file.true_position - file.measured_position).max() > 0.05
        assert file.radar.attrs["noise_power_w"] == prepared.receiver.noise_power_w
        assert file.scenario.item() == to_toml(survey.scenario)
        assert json.loads(file.attrs["versions"])["sionna-rt"].startswith("2.2")
        np.testing.assert_array_equal(file.true_height, survey.truth.height_m)
        np.testing.assert_array_equal(file.lit.astype(bool), survey.lit)
        assert all("units" in file[name].attrs for name in ("beat_i", "time", "true_position", "x"))


def test_xarray_reads_the_paths_and_the_profiles(flown):
    survey, files = flown
    seen = survey.prepared.build_sensor().observe(survey.schedule.pulses(np.arange(survey.pulses)))
    with xr.open_dataset(files["paths"], engine="h5netcdf") as file:
        assert file.sizes["path"] == survey.paths
        np.testing.assert_array_equal(file.path_pulse, seen.paths.pulse)
        np.testing.assert_array_equal(file.delay, seen.paths.delay_s)
        np.testing.assert_array_equal(file.hit, seen.paths.hit_m)
        np.testing.assert_array_equal(file.gain_i + 1j * file.gain_q, seen.paths.gain.astype(np.complex64))
    with xr.open_dataset(files["profiles"], engine="h5netcdf") as file:
        np.testing.assert_array_equal(file.power, seen.profiles.power)
        np.testing.assert_array_equal(np.cumsum(file.row_size), seen.profiles.start[1:])
        assert file.power.attrs["cell_m"] == seen.profiles.cell_m


@pytest.mark.parametrize(
    ("scene", "overrides"),
    [
        ("hills", {"platform.navigation.position_markov_m": 0.3, "dem.method": "smooth"}),
        ("hills", {"radar.sweep": "triangular", "radar.sampling": "iq"}),
        ("hills", {"radar.scan.mode": "conical", "processing.expected_ground.tolerance_m": 20.0}),
        (
            "jacksboro",
            {"platform.length_m": 60.0, "platform.speed_mps": 60.0, "radar.receiver.high_pass_corner_hz": 2e3},
        ),
        pytest.param("rain", {"platform.length_m": 4.0}, marks=pytest.mark.study),
    ],
)
def test_the_same_settings_give_the_same_bits(scene, overrides, tmp_path):
    survey, files = recorded(tmp_path, overrides, scene=scene)
    again = process(files["signals"], block_size=37)
    assert again.points.sha256() == survey.points.sha256()
    np.testing.assert_array_equal(again.dem.height_m, survey.dem.height_m)
    assert (again.comparison.lit_error, again.comparison.dem_error) == (survey.lit_error, survey.dem_error)


@pytest.mark.parametrize(
    "settings", [{"processing.ranging": "peak", "processing.window": "blackman"}, {"dem.spacing_m": 2.0}]
)
def test_other_settings_give_what_they_would_have_given_in_flight(flown, settings):
    survey, files = flown
    again = process(files["signals"], settings)
    other = run(survey.scenario.model_validate(changed(survey.scenario, settings)))
    assert again.points.sha256() == other.points.sha256()
    np.testing.assert_array_equal(again.dem.height_m, other.dem.height_m)
    # The truth is recorded on the grid of the flight's own DEM.
    assert (again.comparison is None) == ("dem.spacing_m" in settings)


def changed(scenario, settings):
    data = scenario.model_dump(mode="json", exclude_none=True)
    for key, value in settings.items():
        table, name = key.split(".")
        data[table][name] = value
    return data


def test_products_of_both_are_the_same_files(flown, tmp_path):
    survey, files = flown
    write_survey(survey, tmp_path / "flown")
    write_processed(process(files["signals"]), tmp_path / "again")
    for name in ("points.laz", "dem.tif", "truth.tif", "error.tif"):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "flown" / name).read_bytes(), name
    lines = (tmp_path / "again" / "echoes.csv").read_text().splitlines()
    assert len(lines) == 1 + len(survey.points)
    document = json.loads((tmp_path / "again" / "processed.json").read_text())
    assert document["points_sha256"] == survey.points.sha256()
    assert document["lit_error"]["rms_m"] == survey.lit_error.rms_m
    assert (tmp_path / "again" / "figures" / "dem.png").stat().st_size > 5000


def test_neither_the_terrain_nor_the_ray_tracer_is_needed(flown, tmp_path):
    program = f"""
import sys
from sionna_radar import process
again = process({str(flown[1]["signals"])!r})
assert again.comparison.lit_error.count > 0
known = [name for name in ("mitsuba", "drjit", "sionna") if name in sys.modules]
assert not known, known
"""
    subprocess.run([sys.executable, "-c", program], check=True, cwd=tmp_path)


def test_samples_of_16_bits_are_within_half_a_step(flown, tmp_path):
    survey, _ = flown
    packed = tmp_path / "packed.nc"
    run(survey.scenario, recordings={"signals": packed}, sample_type="int16")
    with xr.open_dataset(flown[1]["signals"], engine="h5netcdf") as whole, h5py.File(packed) as raw:
        assert raw["beat_i"].dtype == np.int16
        assert np.abs(raw["beat_i"][...]).max() == 2**15 - 1
        assert raw["beat_i"].id.get_storage_size() <= whole.beat_i.nbytes / 3
        with xr.open_dataset(packed, engine="h5netcdf") as file:
            (step,) = raw["beat_i"].attrs["scale_factor"]
            # Half a step, and what 32 bits lose of full scale until it is known: 2^15 times 2^-24.
            assert np.abs(file.beat_i - whole.beat_i).max() <= 0.503 * step
    again = process(packed)
    assert again.comparison.lit_error.rms_m == pytest.approx(survey.lit_error.rms_m, rel=0.02)
    assert list(tmp_path.iterdir()) == [packed]


def test_recordings_appear_whole_or_not_at_all(tmp_path):
    def stop(stage, done, total):
        if stage == "tracing" and done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(load_scenario("hills", SHORT | COARSE), recordings={"signals": tmp_path / "a.nc"}, progress=stop)
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten(tmp_path):
    (tmp_path / "mine.nc").write_text("mine")
    with pytest.raises(OutputError, match="exists already"):
        run(load_scenario("hills", SHORT | COARSE), recordings={"signals": tmp_path / "mine.nc"})
    assert (tmp_path / "mine.nc").read_text() == "mine"
    with pytest.raises(OutputError, match="go to one file"):
        run(load_scenario("hills", SHORT | COARSE), recordings=dict.fromkeys(("signals", "paths"), tmp_path / "a.nc"))
    with pytest.raises(OutputError, match="no folder"):
        run(load_scenario("hills", SHORT | COARSE), recordings={"signals": tmp_path / "nowhere" / "a.nc"})
    with pytest.raises(ScenarioError, match="signals, paths, profiles"):
        run(load_scenario("hills", SHORT | COARSE), recordings={"echoes": tmp_path / "a.nc"})
    with pytest.raises(ScenarioError, match="'lidar' makes no beat signals"):
        run(load_scenario("hills", SHORT | COARSE | {"sensor": "lidar"}), recordings={"signals": tmp_path / "a.nc"})
    assert [path.name for path in tmp_path.iterdir()] == ["mine.nc"]


def test_a_recording_fixes_all_but_the_processing_and_the_map(flown):
    with pytest.raises(ScenarioError, match=r"radar\.snr_db: is fixed by the recording"):
        process(flown[1]["signals"], {"radar.snr_db": 3.0})
    with pytest.raises(ScenarioError, match=r"processing\.cfar\.guard"):
        process(flown[1]["signals"], {"processing.cfar.guard": 2000})


def test_a_custom_antenna_must_be_given_again(tmp_path):
    cut = taylor_cut(float(np.deg2rad(3.0)), -25.0)
    antenna = Antenna(cut, cut)
    overrides = SHORT | COARSE | {"dem.method": "smooth"}
    survey = run(load_scenario("hills", overrides), antenna=antenna, recordings={"signals": tmp_path / "a.nc"})
    with pytest.raises(ScenarioError, match=r"radar\.antenna: was replaced by"):
        process(tmp_path / "a.nc")
    assert process(tmp_path / "a.nc", antenna=antenna).points.sha256() == survey.points.sha256()


def test_the_place_on_the_map_is_recorded(tmp_path):
    overrides = {"platform.length_m": 60.0, "platform.speed_mps": 60.0}
    prepared = prepare(load_scenario("jacksboro", overrides))
    run(prepared, recordings={"signals": tmp_path / "a.nc"})
    again = process(tmp_path / "a.nc")
    assert again.georeference == prepared.scene.scene.georeference
    with xr.open_dataset(tmp_path / "a.nc", engine="h5netcdf", decode_coords="all") as file:
        assert "crs" in file.coords
        survey = again.comparison.truth
        place = again.georeference.origin_m
        np.testing.assert_allclose(file.x, survey.grid.x_m + place[0])
        np.testing.assert_array_equal(file.true_height, survey.height_m)
        assert file.crs.attrs["grid_mapping_name"] == "transverse_mercator"


# ------------------------------------------------------------------------------------------ real radars

CARRIER_HZ, BANDWIDTH_HZ, RATE_HZ, SAMPLES = 78e9, 1e9, 5e6, 256


def tone(range_m, speed_mps=speed_of_light, pulses=20, seed=1):
    """Return noisy I/Q samples of a point at a range, by the textbook's phase."""
    time_s = (np.arange(SAMPLES) - SAMPLES // 2) / RATE_HZ
    delay_s = 2 * range_m / speed_mps
    slope = BANDWIDTH_HZ * RATE_HZ / SAMPLES
    beat = np.exp(2j * np.pi * (CARRIER_HZ * delay_s + slope * delay_s * time_s))
    noise = np.random.default_rng(seed).normal(size=(pulses, SAMPLES, 2)) @ [1, 1j]
    return beat + 0.05 * noise


def layout(path, beat, attributes=None, **variables):
    """Write a recording by xarray, as the owner of a real radar would."""
    radar = {"carrier_hz": CARRIER_HZ, "bandwidth_hz": BANDWIDTH_HZ, "sampling_rate_hz": RATE_HZ}
    samples = {"beat_i": (("pulse", "sample"), beat.real)}
    if np.iscomplexobj(beat):
        samples["beat_q"] = (("pulse", "sample"), beat.imag)
    xr.Dataset(samples | variables, attrs=radar | (attributes or {})).to_netcdf(path, engine="h5netcdf")
    return path


NARROW = {"processing.cfar.guard": 8, "processing.cfar.training": 16, "processing.min_range_m": 1.0}


@pytest.mark.parametrize("permittivity", [1.0, 3.18])
def test_a_real_recording_needs_samples_and_a_sweep_only(permittivity, tmp_path):
    speed_mps = speed_of_light / np.sqrt(permittivity)
    path = layout(tmp_path / "a.nc", tone(12.3, speed_mps), {"propagation_mps": speed_mps})
    found = process(path, NARROW)
    assert found.points is None
    assert found.dem is None
    assert len(found.echoes) == 20
    np.testing.assert_allclose(found.echoes.range_m, 12.3, atol=0.02)
    # What windowed noise of the variance 2 * 0.05^2 leaves in a cell.
    window = np.hanning(SAMPLES + 1)[:-1]
    expected = 2 * 0.05**2 * np.sum(window**2) / np.sum(window) ** 2
    assert 10 * np.log10(found.spectrum.floor / expected) == pytest.approx(0.0, abs=1.5)
    assert "no poses" in found.warnings[0]


def test_whole_numbers_with_a_scale_and_real_samples_are_read(tmp_path):
    beat = np.rint(tone(12.3).real / 1e-3).astype(np.int16)
    path = layout(tmp_path / "a.nc", beat)
    with h5py.File(path, "r+") as file:
        file["beat_i"].attrs["scale_factor"] = 1e-3
    found = process(path, NARROW)
    np.testing.assert_allclose(found.echoes.range_m, 12.3, atol=0.02)
    assert found.sweeps[0].sampling == "real"
    assert found.chirp.power.max() == pytest.approx(0.5, rel=0.1)


def test_poses_make_points_and_a_dem(tmp_path):
    """Looking straight down from a moving platform over level ground 12.3 m below."""
    count = 400
    east, north = (axis.ravel() for axis in np.meshgrid(np.arange(20.0), np.arange(20.0)))
    position = np.column_stack([east, north, np.full(count, 12.3)])
    down = np.tile(np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0.0]]), (count, 1, 1))
    path = layout(
        tmp_path / "a.nc",
        tone(12.3, pulses=count),
        time=(("pulse",), 0.1 * np.arange(count)),
        measured_position=(("pulse", "axis"), position),
        measured_velocity=(("pulse", "axis"), np.tile([10.0, 0, 0], (count, 1))),
        measured_rotation=(("pulse", "axis", "antenna_axis"), down),
    )
    found = process(path, NARROW | {"radar.antenna.beamwidth_deg": 3.0})
    assert isinstance(found.points, Points)
    assert np.abs(found.dem.height_m[found.dem.filled]).max() < 0.05
    assert found.dem.filled.sum() > 300
    write_processed(found, tmp_path / "out")
    assert {"points.laz", "dem.tif", "echoes.csv"} <= {file.name for file in (tmp_path / "out").iterdir()}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: f.pop("beat_i"), "no variable 'beat_i'"),
        (lambda f: f.attrs.pop("carrier_hz"), "radar:carrier_hz: required"),
        (lambda f: f.attrs.__setitem__("bandwidth_hz", np.nan), "bandwidth_hz"),
        (lambda f: f.attrs.__setitem__("bandwidth_hz", "wide"), "bandwidth_hz"),
        (lambda f: f.attrs.__setitem__("sweep", "triangular"), "not that of radar:sweep"),
        (lambda f: f.attrs.__setitem__("propagation_mps", 9e8), "propagation_mps"),
        (lambda f: f["beat_i"].__setitem__((3, 5), np.nan), "samples of pulse 3 are no finite numbers"),
        (lambda f: f.create_dataset("time", data=np.zeros(3)), "shape"),
        (lambda f: f.create_dataset("time", data=np.r_[0.0:10.0, 5.0:15.0]), "time of pulse 10 is not after"),
        (lambda f: f.attrs.__setitem__("layout", 99), "has the layout 99"),
        (lambda f: f.attrs.__setitem__("recording", "paths"), "holds paths, not beat signals"),
        (lambda f: f.create_dataset("measured_position", data=np.zeros((20, 3))), "lacks measured_velocity"),
        (lambda f: f.__setitem__("time", h5py.ExternalLink("elsewhere.nc", "time")), "no variable 'time'"),
        (lambda f: f.__setitem__("scenario", "[terrain"), "is not TOML"),
        (lambda f: f.__setitem__("scenario", 'sensor = "radar"'), "required"),
        (lambda f: f.create_group("radar"), "not a variable"),
    ],
)
def test_what_a_recording_lacks_is_named(change, words, tmp_path):
    path = layout(tmp_path / "a.nc", tone(12.3))
    with h5py.File(path, "r+") as file:
        change(file)
    with pytest.raises(RadarError, match=words):
        process(path, NARROW if "scenario" not in words else {})


def test_samples_outside_the_file_are_not_read(tmp_path):
    np.zeros((20, SAMPLES)).tofile(tmp_path / "raw")
    path = layout(tmp_path / "a.nc", tone(12.3).real)
    with h5py.File(path, "r+") as file:
        del file["beat_i"]
        file.create_dataset("beat_i", (20, SAMPLES), "f8", external=[(str(tmp_path / "raw"), 0, 20 * SAMPLES * 8)])
    with pytest.raises(InputFileError, match="not a variable with values in this file"):
        process(path, NARROW)


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        (
            "measured_position",
            lambda v: v.__setitem__((3, 1), 4.0e6),
            "measured_position of pulse 3 is more than 1e+06 m",
        ),
        ("measured_velocity", lambda v: v.__setitem__((0, 0), 1e30), "measured_velocity of pulse 0 is more than"),
        ("measured_rotation", lambda v: v.__setitem__((5, 0, 0), 2.0), "no rotations"),
        ("measured_position", lambda v: v.attrs.__setitem__("units", "km"), "has the unit 'km'; give it in m"),
        ("survey", lambda v: v.attrs.__setitem__("ground_extent_m", [9.0, 0.0, 1.0, 5.0]), "describe no flight"),
        ("radar", lambda v: v.attrs.__setitem__("bandwidth_hz", 250e6), "the scenario's bandwidth_hz is"),
        ("beat_i", lambda v: v.attrs.__setitem__("add_offset", 1e30), "samples of pulse"),
    ],
)
def test_what_does_not_fit_in_a_recording_is_named(flown, name, change, words, tmp_path):
    path = tmp_path / "a.nc"
    path.write_bytes(flown[1]["signals"].read_bytes())
    with h5py.File(path, "r+") as file:
        change(file[name])
    with pytest.raises(RadarError, match=re.escape(words)):
        process(path)


def test_a_disk_that_fills_up_ends_in_one_error(tmp_path, monkeypatch):
    """The HDF5 library crashes on a full disk, so that recording stops before."""
    free = iter([10**12] * 40 + [10**6] * 1000)
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(netcdf.shutil, "disk_usage", lambda folder: usage._replace(free=next(free)))
    with pytest.raises(OutputError, match="MB are free, and"):
        run(load_scenario("hills", SHORT | COARSE), recordings={"paths": tmp_path / "a.nc"}, block_size=20)
    assert list(tmp_path.iterdir()) == []


def test_a_result_without_a_lit_cell_says_so(flown, tmp_path, caplog):
    path = tmp_path / "a.nc"
    path.write_bytes(flown[1]["signals"].read_bytes())
    with h5py.File(path, "r+") as file:
        file["lit"][...] = 0
    with caplog.at_level("WARNING", logger="sionna_radar"):
        found = process(path)
    assert "no cell of the DEM is filled" in caplog.text
    write_processed(found, tmp_path / "out")
    assert "nan" not in render(processed_table(found))


@pytest.mark.parametrize("number", range(12))
def test_a_damaged_recording_ends_in_one_error_or_a_result(flown, number, tmp_path):
    rng = np.random.default_rng(number)
    data = bytearray(flown[1]["signals"].read_bytes()[: 200_000 if number % 2 else None])
    for _ in range(int(rng.integers(1, 30))):
        # The head holds the tables of the file.
        data[int(rng.integers(0, 20_000 if number % 3 else len(data)))] = int(rng.integers(0, 256))
    (tmp_path / "a.nc").write_bytes(data if number % 4 else data[: int(rng.integers(0, len(data)))])
    # A RadarError, or a result; anything else fails the test.
    with contextlib.suppress(RadarError):
        process(tmp_path / "a.nc")


@pytest.mark.skipif(not DATA.is_dir(), reason=f"no recordings of real radars in {DATA}; set SIONNA_RADAR_RECORDINGS")
def test_an_ice_radar_s_profile_is_its_authors_(tmp_path):
    """ApRES: four chirps of 200 to 400 MHz in ice, beside the range profiles that the instrument's own code made."""
    burst = np.load(DATA / "apres_burst.npz")
    ice_mps = 3e8 / np.sqrt(3.18)
    radar = {"carrier_hz": 300e6, "bandwidth_hz": 200e6, "sampling_rate_hz": 40e3, "propagation_mps": ice_mps}
    path = layout(tmp_path / "ice.nc", burst["chirp_v"][:, :40_000], radar)
    settings = {"processing.window": "blackman", "processing.min_range_m": 20.0, "processing.echoes": "all"}
    found = process(path, settings)
    np.testing.assert_allclose(found.spectrum.range_m[:8000], burst["range_m"], rtol=1e-9)
    theirs = np.mean(np.abs(burst["profile"]) ** 2, axis=0)
    # They scale by the window's RMS, and count a real signal's power once.
    window = np.blackman(40_000)
    scale = 2 * np.mean(window**2) / np.mean(window) ** 2
    strong = theirs > 1e-3 * theirs[100:].max()
    off_db = 10 * np.log10(found.spectrum.mean[:8000] / theirs / scale)
    assert strong[100:].sum() > 50
    assert np.abs(off_db[100:][strong[100:]]).max() < 0.2


@pytest.mark.skipif(not DATA.is_dir(), reason=f"no recordings of real radars in {DATA}; set SIONNA_RADAR_RECORDINGS")
def test_the_example_of_a_real_module_runs(tmp_path):
    script = Path(__file__).parents[2] / "examples" / "real_recording.py"
    command = [sys.executable, str(script), str(DATA / "ti_77ghz_frame.npz")]
    done = subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True)
    assert "real module: 128 chirps" in done.stdout
    assert (tmp_path / "real_recording.png").stat().st_size > 20_000


def test_a_recording_of_several_receivers_is_refused_with_the_way_out(tmp_path):
    path = layout(tmp_path / "a.nc", tone(12.3))
    with h5py.File(path, "r+") as file:
        del file["beat_i"], file["beat_q"]
        file.create_dataset("beat_i", data=np.zeros((20, 4, SAMPLES)))
    with pytest.raises(InputFileError, match="is not that of radar:sweep"):
        process(path, NARROW)


def test_parameters_of_a_scenario_come_back(flown):
    survey, files = flown
    with xr.open_dataset(files["signals"], engine="h5netcdf") as file:
        assert parse_scenario(tomllib.loads(file.scenario.item())) == survey.scenario
