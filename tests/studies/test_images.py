"""The images that a side-looking scenario leaves: their geometry, their resolution at a point, and their files."""

import dataclasses
import json
import re
import shutil

import h5py
import numpy as np
import pytest
from pyproj import CRS, Transformer
from scipy.io import netcdf_file
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from sionna_radar import process, run
from sionna_radar.cli.app import app
from sionna_radar.execution.execution import Execution
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.raster import Georeference
from sionna_radar.scenario import parse_scenario
from sionna_radar.scene.model import Target
from sionna_radar.scene.motion import Rotor, Way
from sionna_radar.studies.images.aperture import PixelGrid
from sionna_radar.studies.images.document import DOCUMENT, write_slar
from sionna_radar.studies.images.point_response import Point, Widths, isolated, measured_in_patch, relative_to_track
from sionna_radar.studies.images.study import image as run_images
from sionna_radar.studies.images.study import image_recording

EAST, GROUND = 1.0, 29.0
SMALL = {
    "terrain": {"kind": "flat", "size_m": [120.0, 120.0]},
    "targets": [{"position_m": [EAST, -GROUND], "rcs_dbsm": 0.0}],
    "platform": {"altitude_m": 28.0, "speed_mps": 5.0, "start_m": [-4.5, 0.0], "length_m": 11.0},
    "radar": {
        "chirp_rate_hz": 400.0,
        "samples_per_chirp": 256,
        "sampling": "iq",
        "snr_db": 30.0,
        "antenna": {"beamwidth_deg": [2.5, 12.0], "side_lobe_db": -25.0},
        "scan": {"mode": "side_looking", "incidence_deg": 45.0},
    },
    "tracing": {"speckle": "persistent", "scatterers_per_m2": 2.0},
}


def scenario_of(**tables: dict):
    return parse_scenario(SMALL | {name: SMALL.get(name, {}) | table for name, table in tables.items()})


@pytest.fixture(scope="module")
def imagery():
    return run_images(scenario_of())


@pytest.fixture(scope="module")
def folder(imagery, tmp_path_factory):
    directory = tmp_path_factory.mktemp("image") / "out"
    DOCUMENT.write(imagery, directory)
    return directory


def test_what_leaks_is_taken_out_of_the_images(imagery):
    """A still way of 36 m, its echo far over that of the ground there."""
    receiver = {"leakage": [{"delay_ns": 240.0, "level_db": -70.0}]}
    found = run_images(scenario_of(radar=SMALL["radar"] | {"receiver": receiver}, processing={"leakage": "subtract"}))
    cell = int(np.argmin(np.abs(imagery.slant.range_m - 240e-9 * 299_792_458.0 / 2)))
    near = slice(cell - 2, cell + 3)
    plain = np.nanmean(imagery.slant.power[:, near])
    assert plain < 1e-2 * 10**-7.0
    assert np.nanmean(found.slant.power[:, near]) == pytest.approx(plain, rel=0.3)


def test_the_strip_is_what_the_half_power_beam_lights(imagery):
    strip = imagery.strip
    assert strip.near_m == pytest.approx(28.0 * np.tan(np.deg2rad(39.0)), rel=1e-3)
    assert strip.far_m == pytest.approx(28.0 * np.tan(np.deg2rad(51.0)), rel=1e-3)
    assert strip.height_m == pytest.approx(0.0, abs=1e-9)
    assert strip.length_m == pytest.approx(11.0, abs=0.02)
    grid = imagery.focused.grid
    assert grid.across_m[0] == strip.near_m
    # At both ends the far edge is left out as far as the beam is long there: its pixels would lack pulses.
    edge = np.hypot(28.0, strip.far_m) * np.tan(imagery.focused.aperture.width_rad / 2)
    assert grid.along_m[0] == pytest.approx(edge)
    assert np.ptp(imagery.focused.pulses[-1]) <= 2


def test_a_point_is_as_wide_as_the_theory_says(imagery):
    (reflector,) = imagery.reflectors
    assert reflector.position_m[:2] == (EAST, -GROUND)
    assert reflector.place.ground_m == pytest.approx(GROUND)
    slar, sar = reflector.slar, reflector.sar
    assert sar.measured.along_m == pytest.approx(sar.theory.along_m, rel=0.03)
    assert sar.measured.across_m == pytest.approx(sar.theory.across_m, rel=0.03)
    assert slar.measured.along_m == pytest.approx(slar.theory.along_m, rel=0.05)
    assert slar.measured.across_m == pytest.approx(slar.theory.across_m, rel=0.05)
    # c / (2 B) = 0.3 m, and a Hann window makes it 1.44 times as wide.
    assert slar.theory.across_m == pytest.approx(1.44 * 0.2998, rel=0.01)
    sine = GROUND / np.hypot(GROUND, 28.0)
    assert sar.theory.across_m == pytest.approx(slar.theory.across_m / sine)


def test_the_files_hold_the_point_where_it_stands(folder, imagery):
    with netcdf_file(folder / "sar.nc", mmap=False) as file:
        names = {name: file.variables[name][:].copy() for name in file.variables}
        assert file.variables["along"].units == b"m"
        assert file.variables["pulses"].coordinates == b"east north"
        assert not hasattr(file.variables["pulses"], "grid_mapping")
    power = names["amplitude_real"] ** 2 + names["amplitude_imag"] ** 2
    np.testing.assert_allclose(power, imagery.focused.power)
    row, column = np.unravel_index(power.argmax(), power.shape)
    assert names["east"][row, column] == pytest.approx(EAST, abs=0.02)
    assert names["north"][row, column] == pytest.approx(-GROUND, abs=0.3)
    assert names["ground_range"][row] == pytest.approx(GROUND, abs=0.3)
    with netcdf_file(folder / "slar.nc", mmap=False) as file:
        names = {name: file.variables[name][:].copy() for name in file.variables}
    row, column = np.unravel_index(names["power"].argmax(), names["power"].shape)
    assert names["slant_range"][column] == pytest.approx(np.hypot(GROUND, 28.0), abs=0.1)
    assert names["east"][row] == pytest.approx(EAST, abs=0.4)
    np.testing.assert_allclose(names["radar_height"], 28.0)


def test_the_files_of_a_place_on_the_earth_hold_its_coordinates(imagery, tmp_path):
    crs = CRS.from_epsg(32632)
    place = Georeference(crs_wkt=crs.to_wkt(), origin_m=(500_000.0, 5_000_000.0, 300.0))
    described = imagery.scenario.model_copy(update={"description": "H\u00fcgel"})
    write_slar(tmp_path / "slar.nc", dataclasses.replace(imagery, georeference=place, scenario=described))
    with netcdf_file(tmp_path / "slar.nc", mmap=False) as file:
        power, mapping = file.variables["power"], file.variables["crs"]
        assert power.coordinates == b"east north longitude latitude"
        assert power.grid_mapping == b"crs"
        assert "H\u00fcgel" in file.scenario.decode()
        assert CRS.from_cf({name: value.decode() for name, value in vars(mapping).items() if name == "crs_wkt"}) == crs
        assert mapping.grid_mapping_name == b"transverse_mercator"
        assert mapping.longitude_of_central_meridian == 9.0
        assert file.variables["east"].standard_name == b"projection_x_coordinate"
        lonlat = [file.variables[name][:].copy() for name in ("longitude", "latitude")]
        east, north, height = (file.variables[name][:].copy() for name in ("east", "north", "radar_height"))
        assert file.ground_height_m == pytest.approx(300.0)
        assert file.variables["east"].long_name == b"map easting"
    np.testing.assert_allclose(east, 500_000.0 - 4.5 + imagery.slant.along_m, atol=0.02)
    np.testing.assert_allclose(north, 5_000_000.0, atol=1e-6)
    np.testing.assert_allclose(height, 328.0)
    expected = Transformer.from_crs(crs, 4326, always_xy=True).transform(east, north)
    np.testing.assert_allclose(lonlat, expected, atol=1e-12)


def test_the_numbers_are_written_and_printed(folder, imagery, capsys):
    told = json.loads((folder / DOCUMENT.marker).read_text())
    assert told["sar"]["theory"]["along_m"] == imagery.sar.along_m
    assert told["reflectors"][0]["sar"]["measured"]["along_m"] == imagery.reflectors[0].sar.measured.along_m
    assert told["sar"]["columns"] * told["sar"]["rows"] == imagery.focused.power.size
    assert {path.name for path in folder.rglob("*.png")} == {"slar.png", "sar.png"}
    DOCUMENT.show(imagery)
    printed = capsys.readouterr().out
    assert "SAR, targets.0" in printed
    assert "of theory" in printed


def test_blocks_do_not_change_the_images(imagery):
    again = run_images(scenario_of(), execution=Execution(block_size=97))
    np.testing.assert_allclose(again.slant.power, imagery.slant.power, rtol=1e-9)
    peak = np.abs(imagery.focused.amplitude).max()
    np.testing.assert_allclose(again.focused.amplitude, imagery.focused.amplitude, atol=1e-9 * peak)


def test_new_scatterers_each_pulse_make_no_focused_image(tmp_path, capsys):
    imagery = run_images(scenario_of(tracing={"speckle": "per_pulse", "paths_per_pulse": 64}))
    assert imagery.focused is None
    assert imagery.reflectors[0].sar is None
    names = {path.name for path in DOCUMENT.write(imagery, tmp_path / "out")}
    assert names == {DOCUMENT.marker, "manifest.json", "scenario.toml", "slar.nc", "slar.png"}
    assert json.loads((tmp_path / "out" / DOCUMENT.marker).read_text())["sar"] is None
    DOCUMENT.show(imagery)
    assert "tracing.speckle = 'persistent'" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("tables", "field"),
    [
        ({"radar": {"scan": {"mode": "whisk_broom"}}}, r"radar\.scan\.mode: 'whisk_broom' .* 'side_looking'"),
        ({"radar": {"sweep": "triangular"}}, r"radar\.sweep"),
        ({"platform": {"length_m": 2.0}}, r"platform\.length_m: .* raise it above"),
        ({"radar": {"chirp_rate_hz": 50.0}}, r"radar\.chirp_rate_hz: 50 .* raise it to"),
    ],
    ids=["looks ahead", "triangle", "short", "too few chirps"],
)
def test_what_cannot_be_imaged_is_refused(tables, field):
    with pytest.raises(ScenarioError, match=field):
        run_images(scenario_of(**tables))


def test_a_bent_track_and_a_lidar_are_refused_at_once():
    platform = {"altitude_m": 28.0, "speed_mps": 5.0, "waypoints_m": [[0, 0], [5, 0], [5, 5]]}
    with pytest.raises(ScenarioError) as error:
        run_images(parse_scenario(SMALL | {"platform": platform, "sensor": "lidar"}))
    assert {problem.field for problem in error.value.problems} == {"platform.waypoints_m", "sensor"}
    gusty = scenario_of(platform={"altitude_m": 28.0, "speed_mps": 5.0, "wind": {"speed_mps": 3.0}})
    with pytest.raises(ScenarioError, match=r"platform\.wind: makes no straight track at one speed; remove wind"):
        run_images(gusty)


def point_at(along_m: float, slant_range_m: float) -> Point:
    return Point(
        along_m=along_m, ground_m=28.0, height_m=0.0, slant_range_m=slant_range_m, incidence_rad=0.8, steady=True
    )


def test_what_moves_or_turns_is_no_point_to_measure(imagery):
    still = Target(position_m=(EAST, -GROUND, 0.0), rcs_m2=1.0)
    way = Way(corner_m=np.array([[EAST, -GROUND, 0.0], [EAST + 1.0, -GROUND, 0.0]]), speed_mps=1.0)
    axis = (0.0, 0.0, 1.0)
    rotor = Rotor(offset_m=axis, axis=axis, radius_m=0.1, turns_per_s=1.0, blades=2, points=2, rcs_m2=1.0)
    seen = [still, dataclasses.replace(still, way=way), dataclasses.replace(still, rotors=(rotor,))]
    assert [relative_to_track(target, imagery.strip).steady for target in seen] == [True, False, False]


def test_points_side_by_side_are_not_isolated():
    theory = Widths(along_m=1.0, across_m=0.5)
    here, beside, behind = point_at(0.0, 40.0), point_at(3.0, 40.5), point_at(0.0, 44.0)
    assert isolated(here, [here, behind], theory)
    assert not isolated(here, [here, beside, behind], theory)
    assert isolated(here, [here, beside], dataclasses.replace(theory, along_m=0.4))


def patch_power(width_m: float, floor: float, beside: float = 0.0):
    """A Gaussian in a patch; `beside` is the power of another one at its edge."""
    axis = np.linspace(-3.0, 3.0, 121)
    grid = PixelGrid(origin_m=np.zeros(3), along=np.eye(3)[0], across=np.eye(3)[1], along_m=axis, across_m=axis)
    x, y = np.meshgrid(axis, axis)
    power = np.exp2(-4 * (x**2 / width_m**2 + y**2)) + beside * np.exp2(-4 * ((x - 2.5) ** 2 + y**2)) + floor
    return power, grid


def test_widths_are_those_at_half_power():
    widths = measured_in_patch(*patch_power(1.4, 0.0))
    assert widths.along_m == pytest.approx(1.4, rel=5e-3)
    assert widths.across_m == pytest.approx(1.0, rel=5e-3)


@pytest.mark.parametrize(
    "power", [patch_power(1.0, 0.2), patch_power(1.0, 1e-6, 1.5), patch_power(20.0, 0.0)], ids=["faint", "two", "wide"]
)
def test_a_width_that_cannot_be_told_is_none(power):
    assert measured_in_patch(*power) is None


def zigzag(path):
    """A log of the flight of SMALL that swings by 5 cm to the sides and by 3 cm up and down."""
    lines = ["time_s,east_m,north_m,up_m,roll_deg,pitch_deg,heading_deg"]
    for t in np.arange(0.0, 2.4, 0.02):
        swing = 2 * np.pi * 5.0 * t / 4.0
        lines.append(f"{t:.2f},{5 * t - 5:.5f},{0.05 * np.sin(swing):.6f},{28 + 0.03 * np.cos(swing):.6f},0,0,90")
    path.write_text("\n".join(lines))
    return {"log": str(path), "log_height": "datum"}


@pytest.fixture(scope="module")
def flown(imagery, tmp_path_factory):
    path = tmp_path_factory.mktemp("strip") / "strip.nc"
    run(imagery.scenario, recordings={"signals": path})
    return path


@pytest.fixture
def strip(flown, tmp_path):
    """The recording of the flight, to be changed."""
    return shutil.copy(flown, tmp_path / "strip.nc")


def test_a_recording_of_the_simulated_flight_gives_its_images(imagery, strip):
    recorded = image_recording(strip)
    np.testing.assert_array_equal(recorded.focused.amplitude, imagery.focused.amplitude)
    np.testing.assert_array_equal(recorded.slant.power, imagery.slant.power)
    assert recorded.sar == imagery.sar
    with h5py.File(strip, "r+") as file:
        for name in ("scenario", "survey", "true_height", "lit"):
            del file[name]
    with pytest.raises(ScenarioError, match="--ground-height: is needed"):
        image_recording(strip)
    antenna = {"radar.antenna.beamwidth_deg": [2.5, 12.0], "radar.antenna.side_lobe_db": -25.0}
    foreign = image_recording(strip, antenna, ground_m=0.0)
    np.testing.assert_array_equal(foreign.focused.amplitude, imagery.focused.amplitude)
    with pytest.raises(InputFileError, match=r"the ground is -2.0 m below the track"):
        image_recording(strip, antenna, ground_m=30.0)
    with h5py.File(strip, "r+") as file:
        turned = file["measured_rotation"][...]
        file["measured_rotation"][...] = Rotation.from_euler("z", -20, degrees=True).as_matrix() @ turned
    with pytest.raises(InputFileError, match=r"looks -20.0 deg ahead of the side of the track"):
        image_recording(strip, antenna, ground_m=0.0)


def test_a_recording_is_focused_along_its_measured_poses(imagery, tmp_path):
    """A target is as bright and as narrow from a track that swings by 25 wavelengths, and gone along a straight one."""
    path = tmp_path / "strip.nc"
    run(parse_scenario(SMALL | {"platform": zigzag(tmp_path / "flight.csv")}), recordings={"signals": path})
    focused = image_recording(path, ground_m=0.0).focused
    row, column = np.unravel_index(focused.power.argmax(), focused.power.shape)
    east, north, _ = focused.grid.position_m[row, column]
    assert abs(east - EAST) < imagery.sar.along_m / 2
    assert abs(north + GROUND) < imagery.sar.across_m / 2
    assert focused.power.max() == pytest.approx(imagery.focused.power.max(), rel=0.2)
    with h5py.File(path, "r+") as file:
        place = file["measured_position"][...]
        file["measured_position"][...] = np.linspace(place[0], place[-1], len(place))
    straight = image_recording(path, ground_m=0.0).focused
    assert straight.power.max() < 0.1 * focused.power.max()


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("beat_q", lambda q: -q, "as where Q has the other sign; set radar.conjugate = true"),
        ("measured_velocity", lambda v: -v, r"velocities -11.0 [+-]0.0 [+-]0.0 m; look at signs, axes and units"),
        ("measured_rotation", lambda R: np.swapaxes(R, 1, 2), "look at measured_rotation"),
        ("beat_q", lambda q: q, ""),
    ],
)
def test_poses_and_signs_that_contradict_what_is_seen_are_told(strip, caplog, name, change, words):
    antenna = {"radar.antenna.beamwidth_deg": [2.5, 12.0]}
    with h5py.File(strip, "r+") as file:
        for own in ("scenario", "survey", "true_height", "lit"):
            del file[own]
        file[name][...] = change(file[name][...])
    caplog.clear()
    if name == "measured_rotation":
        with pytest.raises(InputFileError, match=words):
            image_recording(strip, antenna, ground_m=0.0)
        assert "looks to the horizon or above it in 100%" in process(strip, antenna).warnings[0]
        return
    image_recording(strip, antenna, ground_m=0.0)
    assert re.search(words, caplog.text) if words else not caplog.text


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"tracing.speckle": "per_pulse"}, None),
        ({"radar.sweep": "triangular", "tracing.speckle": "per_pulse"}, "signals of one sweep and one receiver"),
        ({"radar.scan.mode": "fixed", "tracing.speckle": "per_pulse"}, "deg ahead of the side of the track"),
    ],
)
def test_what_is_recorded_otherwise_is_not_focused(tmp_path, changes, words):
    scenario = scenario_of().replace(changes)
    run(scenario, recordings={"signals": tmp_path / "strip.nc"})
    if words is None:
        assert image_recording(tmp_path / "strip.nc").focused is None
        return
    with pytest.raises(InputFileError, match=words):
        image_recording(tmp_path / "strip.nc")


def test_the_command_images_a_recording(imagery, strip, tmp_path):
    done = CliRunner().invoke(app, ["image", str(strip), "-q", "-o", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    told = json.loads((tmp_path / "out" / DOCUMENT.marker).read_text())
    assert told["recording"] == "strip.nc"
    assert told["sar"]["theory"]["along_m"] == imagery.sar.along_m
    with pytest.raises(ScenarioError, match="--ground-height: is of a recording"):
        CliRunner().invoke(app, ["image", "slar", "--ground-height", "3"], catch_exceptions=False)


def test_a_recording_of_powers_has_a_slant_range_image_alone(imagery, strip, tmp_path, capsys):
    """Range profiles of the same flight, described by a TOML file, whose log flies straight and looks to the right."""
    chirp = imagery.focused.chirp
    with h5py.File(strip) as file:
        beat = file["beat_i"][...] + 1j * file["beat_q"][...]
        time_s, (x, y, z), speed = file["time"][...], file["measured_position"][0], file["measured_velocity"][0]
    power = np.abs(np.fft.fft(beat * np.hanning(256) / np.hanning(256).sum(), axis=1)) ** 2
    np.save(tmp_path / "profiles.npy", power)
    rows = [f"{t:.4f},{x + speed[0] * (t - 0.1):.6f},{y},{z},0,0,90" for t in np.arange(0.0, 2.6, 0.05)]
    header = "time_s,east_m,north_m,up_m,roll_deg,pitch_deg,heading_deg"
    (tmp_path / "flight.csv").write_text("\n".join([header, *rows]))
    sweep = f"carrier_hz = {chirp.carrier_hz}\nbandwidth_hz = {chirp.bandwidth_hz}\n"
    sweep += f"sampling_rate_hz = {chirp.sampling_rate_hz}\npulse_rate_hz = {1 / (time_s[1] - time_s[0])}"
    (tmp_path / "strip.toml").write_text(
        '[recording]\nsamples = "profiles.npy"\naxes = ["pulse", "range"]\nvalues = "power"\n'
        f'[sweep]\n{sweep}\n[poses]\nlog = "flight.csv"\nfirst_pulse_s = 0.1\n'
        'incidence_deg = 45.0\nlook = "right"\n'
    )
    found = image_recording(tmp_path / "strip.toml", {"radar.antenna.beamwidth_deg": [2.5, 12.0]}, ground_m=0.0)
    assert found.focused is None
    assert found.strip.side == "right"
    assert found.strip.near_m == pytest.approx(imagery.strip.near_m)
    row, column = np.unravel_index(np.nanargmax(found.slant.power), found.slant.power.shape)
    assert found.slant.range_m[column] == pytest.approx(np.hypot(GROUND, 28.0), abs=0.31)
    assert found.slant.along_m[row] == pytest.approx(EAST - x, abs=0.4)
    DOCUMENT.show(found)
    assert "because the recording holds powers" in capsys.readouterr().out
