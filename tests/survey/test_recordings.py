"""Recordings: what they hold, as xarray reads it, and what processing makes of them."""

import io
import json
import re
import shutil
import subprocess
import sys

import h5py
import numpy as np
import pytest
import xarray as xr
from rich.console import Console

from cluster_tasks import LikeWorkers
from packed_pages import array_of, numbers_of
from sionna_radar import RadarError, ScenarioError, load_scenario, prepare, process, run, to_toml
from sionna_radar.execution.checkpoints import open_checkpoints
from sionna_radar.execution.execution import Execution
from sionna_radar.foundation.errors import OutputError, PluginError
from sionna_radar.mapping.linear.linear import Linear
from sionna_radar.radar import Antenna, taylor_cut
from sionna_radar.report.files.contents import Figures
from sionna_radar.report.survey.processed import processed_document, processed_table
from sionna_radar.report.survey.products import write_survey
from sionna_radar.survey.custom_parts import CustomParts
from sionna_radar.survey.recordings import netcdf

pytestmark = pytest.mark.usefixtures("rough_errors")

SHORT = {"platform.length_m": 6.0}
COARSE = {"terrain.spacing_m": 2.0}


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


@pytest.mark.parametrize("sampling", ["real", "iq"])
def test_recorded_noise_has_the_power_that_the_comment_says(sampling, tmp_path):
    radar = {"radar.sampling": sampling, "radar.snr_db": None, "radar.transmit_power_dbm": -60.0}
    _, files = recorded(tmp_path, radar | {"radar.noise_figure_db": 12.0})
    with xr.open_dataset(files["signals"], engine="h5netcdf") as file:
        mean = float((file.beat_i**2).mean() + ((file.beat_q**2).mean() if sampling == "iq" else 0.0))
        assert mean == pytest.approx(file.radar.attrs["noise_power_w"], rel=0.02)
        assert ("mean of I² + Q²" in file.beat_i.attrs["comment"]) == (sampling == "iq")


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
        ("hills", {"radar.stagger": 1.0, "platform.length_m": 20.0}),
        pytest.param("rain", {"platform.length_m": 4.0}, marks=pytest.mark.study),
    ],
)
def test_the_same_settings_give_the_same_bits(scene, overrides, tmp_path):
    survey, files = recorded(tmp_path, overrides, scene=scene)
    again = process(files["signals"], execution=Execution(block_size=37))
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
    processed_document(figures=Figures.PNG).write(process(files["signals"]), tmp_path / "again")
    for name in ("points.laz", "dem.tif", "truth.tif", "error.tif"):
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "flown" / name).read_bytes(), name
    lines = (tmp_path / "again" / "echoes.csv").read_text().splitlines()
    assert len(lines) == 1 + len(survey.points)
    document = json.loads((tmp_path / "again" / "processed.json").read_text())
    assert document["points_sha256"] == survey.points.sha256()
    assert document["lit_error"]["rms_m"] == survey.lit_error.rms_m
    assert (tmp_path / "again" / "figures" / "dem.png").stat().st_size > 5000
    of_survey, of_recording = ((tmp_path / name / "report.html").read_text() for name in ("flown", "again"))
    cell = f'data-key="lit_error.rms_m" data-value="{survey.lit_error.rms_m}"'
    assert cell in of_survey
    assert cell in of_recording
    shown, arrays = numbers_of(of_recording)
    maps = {one["name"]: array_of(one["z"], arrays) for one in shown["maps"]}
    np.testing.assert_allclose(maps["DEM"], survey.dem.height_m, atol=0.00051)


def test_neither_the_terrain_nor_the_ray_tracer_is_needed(flown, tmp_path):
    program = f"""
import sys
from sionna_radar import process
again = process({str(flown[1]["signals"])!r})
assert again.comparison.lit_error.count > 0
print([name for name in ("mitsuba", "drjit", "sionna") if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", program], check=True, cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout == "[]\n"


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
        run(
            load_scenario("hills", SHORT | COARSE),
            recordings={"signals": tmp_path / "a.nc"},
            execution=Execution(progress=stop),
        )
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
    with pytest.raises(ScenarioError, match=r"radar\.snr_db: cannot be changed for a recording"):
        process(flown[1]["signals"], {"radar.snr_db": 3.0})
    with pytest.raises(ScenarioError, match=r"processing\.cfar\.guard"):
        process(flown[1]["signals"], {"processing.cfar.guard": 2000})


@pytest.mark.parametrize("range_m", [152.95, 153.5, 4e6])
def test_ranges_beyond_the_last_cell_are_refused(flown, range_m):
    """The last of 512 cells of c / 2B, at 153.2 m, is not tested."""
    with pytest.raises(
        ScenarioError, match=r"processing\.min_range_m: .* is beyond the last tested range cell, at 152\.9"
    ):
        process(flown[1]["signals"], {"processing.min_range_m": range_m})


@pytest.mark.parametrize("range_m", [140.0, 151.0, 152.8])
def test_few_cells_are_searched_without_a_volume(flown, range_m):
    """Behind all ground there is noise: nothing but false alarms is found, and no rain."""
    processed = process(flown[1]["signals"], {"processing.min_range_m": range_m})
    assert len(processed.echoes) < 0.1 * flown[0].pulses


def test_workers_process_a_recording_to_the_same_bits_and_go_on(flown, tmp_path):
    """Each opens the file once; what is kept is not processed again."""
    survey, files = flown
    others, nobody = LikeWorkers(), LikeWorkers()
    with open_checkpoints(tmp_path / "parts", {}, resume=False) as kept:
        there = process(files["signals"], execution=Execution(block_size=50, workers=others, checkpoints=kept))
        again = process(files["signals"], execution=Execution(block_size=50, workers=nobody, checkpoints=kept))
    assert others.tasks
    assert nobody.tasks == []
    for processed in (there, again):
        assert processed.points.sha256() == survey.points.sha256()
        np.testing.assert_array_equal(processed.dem.height_m, survey.dem.height_m)
    with pytest.raises(PluginError, match=r"^dem\.method replaced from Python"):
        process(files["signals"], parts=CustomParts(dem_method=Linear()), execution=Execution(workers=LikeWorkers()))


def test_errors_away_from_walls_are_those_of_the_flight(tmp_path):
    scenario = load_scenario("buildings", {"platform.length_m": 20.0, "dem.method": "linear"})
    survey = run(scenario, recordings={"signals": tmp_path / "a.nc"})
    comparison = process(tmp_path / "a.nc").comparison
    assert repr(comparison.off_wall_error) == repr(survey.off_wall_error)
    assert comparison.off_wall_error.count < comparison.lit_error.count


def test_a_custom_antenna_must_be_given_again(tmp_path):
    cut = taylor_cut(float(np.deg2rad(3.0)), -25.0)
    antenna = Antenna(cut, cut)
    overrides = SHORT | COARSE | {"dem.method": "smooth"}
    survey = run(
        load_scenario("hills", overrides), recordings={"signals": tmp_path / "a.nc"}, parts=CustomParts(antenna=antenna)
    )
    with pytest.raises(ScenarioError, match=r"radar\.antenna: was replaced by"):
        process(tmp_path / "a.nc")
    assert process(tmp_path / "a.nc", parts=CustomParts(antenna=antenna)).points.sha256() == survey.points.sha256()


def test_the_place_on_the_map_is_recorded(tmp_path):
    overrides = {"platform.length_m": 60.0, "platform.speed_mps": 60.0}
    prepared = prepare(load_scenario("jacksboro", overrides))
    run(prepared, recordings={"signals": tmp_path / "a.nc"})
    again = process(tmp_path / "a.nc")
    assert again.georeference == prepared.world.scene.georeference
    with xr.open_dataset(tmp_path / "a.nc", engine="h5netcdf", decode_coords="all") as file:
        assert "crs" in file.coords
        survey = again.comparison.truth
        place = again.georeference.origin_m
        np.testing.assert_allclose(file.x, survey.grid.x_m + place[0])
        np.testing.assert_array_equal(file.true_height, survey.height_m)
        assert file.crs.attrs["grid_mapping_name"] == "transverse_mercator"


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
        run(
            load_scenario("hills", SHORT | COARSE),
            recordings={"paths": tmp_path / "a.nc"},
            execution=Execution(block_size=20),
        )
    assert list(tmp_path.iterdir()) == []


def test_a_result_without_a_lit_cell_says_so(flown, tmp_path, caplog):
    path = tmp_path / "a.nc"
    path.write_bytes(flown[1]["signals"].read_bytes())
    with h5py.File(path, "r+") as file:
        file["lit"][...] = 0
    with caplog.at_level("WARNING", logger="sionna_radar"):
        found = process(path)
    assert "no cell of the DEM is filled" in caplog.text
    processed_document().write(found, tmp_path / "out")
    assert "nan" not in render(processed_table(found))


def test_another_process_looks_at_a_file_first_once_for_each_content(flown, monkeypatch, tmp_path):
    asked = []

    def sound(path):
        asked.append(path)
        return ""

    monkeypatch.setattr(netcdf, "error_of_tables", sound)
    own, path = flown[1]["signals"], tmp_path / "a.nc"
    path.write_bytes(own.read_bytes())
    for file, count in ((own, 0), (path, 1), (path, 1)):
        with netcdf.open_netcdf(file, "file", "record it again") as opened:
            assert "beat_i" in opened
        assert len(asked) == count
    with h5py.File(path, "r+") as changed:
        changed["lit"][...] = 0
    with netcdf.open_netcdf(path, "file", "record it again"):
        assert len(asked) == 2


@pytest.mark.parametrize("number", range(12))
def test_a_damaged_recording_ends_in_one_error_or_a_result(flown, number, tmp_path):
    rng = np.random.default_rng(number)
    data = bytearray(flown[1]["signals"].read_bytes()[: 200_000 if number % 2 else None])
    for _ in range(int(rng.integers(1, 30))):
        # The head holds the tables of the file.
        data[int(rng.integers(0, 20_000 if number % 3 else len(data)))] = int(rng.integers(0, 256))
    (tmp_path / "a.nc").write_bytes(data if number % 4 else data[: int(rng.integers(0, len(data)))])
    try:
        sound = np.isfinite(process(tmp_path / "a.nc").echoes.range_m).all()
    except RadarError as error:
        sound = "a.nc" in f"{error}"
    assert sound
