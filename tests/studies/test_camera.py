"""Frames of a camera: geometry, light, air and exposure against closed forms."""

import json

import numpy as np
import pytest
from matplotlib.image import imread

from sionna_radar import ScenarioError, camera, load_scenario, prepare, run
from sionna_radar.scenario.camera import CameraTable
from sionna_radar.studies.camera import DOCUMENT, optics
from sionna_radar.studies.camera.study import normals

LENS = {"camera.pixels": [64, 48], "camera.frames": 1}
SHORT = {"platform.length_m": 5.0, "camera.frames": 2, "camera.pixels": [64, 48]}
# The platform flies east, 50 m above level ground.
FLAT = {"terrain": {"kind": "flat", "size_m": [340.0, 340.0]}, "platform.length_m": 5.0}


def test_pixels_of_a_pinhole_span_the_field_of_view_around_the_axis():
    table = CameraTable(pixels=(400, 301), field_of_view_deg=80.0, depression_deg=25.0)
    direction = optics.pixel_directions(table)
    assert direction.shape == (301, 400, 3)
    assert np.linalg.norm(direction, axis=-1) == pytest.approx(1.0)
    axis = np.array([np.cos(np.deg2rad(25)), 0.0, np.sin(np.deg2rad(25))])
    middle = direction[150]
    assert middle[199] + middle[200] == pytest.approx(axis * np.linalg.norm(middle[199] + middle[200]))
    # The outermost pixels lie half a pixel inside the field of view: tangents are even.
    tangent = np.tan(np.arccos(middle @ axis))
    assert tangent[0] == pytest.approx(np.tan(np.deg2rad(40.0)) * 399 / 400)
    assert np.diff(tangent[200:]) == pytest.approx(2 * np.tan(np.deg2rad(40.0)) / 400)
    assert (middle[:200, 1] < 0).all()
    assert (direction[-1, :, 2] > direction[0, :, 2]).all()
    # Pixels are square.
    column = direction[:, 200] / (direction[:, 200] @ axis)[:, None]
    assert np.linalg.norm(np.diff(column, axis=0), axis=1) == pytest.approx(2 * np.tan(np.deg2rad(40.0)) / 400)


def test_a_level_plane_is_as_bright_as_the_cosine_of_the_suns_zenith():
    up, lit = np.array([[0.0, 0.0, 1.0]]), np.array([True])
    luminance = {
        elevation: optics.surface_luminance(
            optics.light_of(CameraTable(sun_elevation_deg=elevation)), np.array([0.3]), up, lit
        )[0]
        for elevation in (10.0, 30.0, 90.0)
    }
    for elevation in (10.0, 30.0):
        assert luminance[elevation] / luminance[90.0] == pytest.approx(np.cos(np.deg2rad(90 - elevation)))
    # Global illuminance is the sun's over the share that is direct.
    assert luminance[90.0] == pytest.approx(0.3 / np.pi * optics.SUNLIGHT_LX / (1 - optics.DIFFUSE_FRACTION))


def test_the_sun_stands_at_its_azimuth_and_a_wall_faces_half_of_the_sky():
    light = optics.light_of(CameraTable(sun_elevation_deg=30.0, sun_azimuth_deg=90.0))
    assert light.toward_sun == pytest.approx([np.cos(np.pi / 6), 0.0, 0.5])
    walls = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    east, west = optics.surface_luminance(light, np.ones(2), walls, np.array([True, True]))
    assert west == pytest.approx(light.sky_cd_m2 / 2)
    assert east == pytest.approx(light.sky_cd_m2 / 2 + optics.SUNLIGHT_LX * np.cos(np.pi / 6) / np.pi)


@pytest.mark.parametrize("kind", ["fog", "dust"])
def test_a_black_target_fades_into_the_horizon_by_koschmieders_law(kind):
    """Its contrast against the sky at a range r is -exp(-a r); 2 % are left at the visibility."""
    keys = {**FLAT, **LENS, "camera.albedos": {"ground": 0.0}, f"weather.{kind}_visibility_m": 150.0}
    film = camera(load_scenario("hills", keys))
    frame = film.frames[0]
    sky = frame.luminance_cd_m2[~frame.ground]
    assert np.ptp(sky) == 0
    contrast = frame.luminance_cd_m2[frame.ground] / sky[0] - 1
    range_m = frame.range_m[frame.ground]
    assert contrast == pytest.approx(-(0.02 ** (range_m / 150.0)), abs=1e-6)
    assert film.visibility_m == pytest.approx(150.0)
    assert range_m.min() < 150.0 < range_m.max()


def test_clear_air_leaves_the_ground_as_it_is_and_rain_takes_by_its_extinction():
    clear, rain = (
        camera(load_scenario("hills", {**FLAT, **LENS, **keys})) for keys in ({}, {"weather.rain_rate_mm_per_h": 50.0})
    )
    frame, wet = clear.frames[0], rain.frames[0]
    light = optics.light_of(CameraTable())
    global_lx = light.sun_lx * light.toward_sun[2] + np.pi * light.sky_cd_m2
    assert frame.luminance_cd_m2[frame.ground] == pytest.approx(0.1 * global_lx / np.pi, rel=1e-6)
    # Carbonneau and Wisely 1998: 1.076 R^0.67 dB/km.
    loss = 10 ** (-1.076 * 50**0.67 / 1e4 * wet.range_m[wet.ground])
    airlight = light.sky_cd_m2 * (1 - loss)
    assert wet.luminance_cd_m2[wet.ground] == pytest.approx(
        loss * frame.luminance_cd_m2[frame.ground] + airlight, rel=1e-5
    )
    assert clear.visibility_m == np.inf


def test_ranges_are_those_of_the_ray_caster_from_the_pose_of_the_radar():
    scenario = load_scenario("buildings", {**SHORT, "camera.depression_deg": 40.0})
    prepared, film = prepare(scenario), camera(scenario)
    flight = prepared.flight
    pose = flight.pulses(np.array([0, len(flight) - 1])).true
    direction = optics.pixel_directions(scenario.camera)
    # Heading east: forward is east, right is south, down is down.
    world = direction[..., [0, 1, 2]] * np.array([1.0, -1.0, -1.0])
    for frame, position in zip(film.frames, pose.position_m, strict=True):
        assert frame.position_m == pytest.approx(position)
        ray = world.reshape(-1, 3)
        hits = prepared.world.caster.cast(np.broadcast_to(position, ray.shape), ray)
        assert frame.range_m.ravel() == pytest.approx(hits.distance_m, rel=1e-5)
    cosine = np.abs(np.einsum("ri,ri->r", normals(prepared.world.scene, hits), ray[hits.hit]))
    assert cosine == pytest.approx(hits.cosine[hits.hit], abs=1e-5)


def test_a_building_casts_its_shadow_away_from_the_sun():
    """A box 20 m long along the track and 8 m high; the sun in the south at 45 deg: 8 m of shadow to its north."""
    box = {"position_m": [0.0, 0.0], "size_m": [20.0, 10.0, 8.0], "heading_deg": 90.0}
    keys = {
        "buildings": [box],
        "platform.start_m": [-1.0, 0.0],
        "platform.length_m": 2.0,
        "camera": {
            "depression_deg": 90.0,
            "pixels": [240, 180],
            "frames": 3,
            "sun_azimuth_deg": 180.0,
            "sun_elevation_deg": 45.0,
        },
    }
    frame = camera(load_scenario("buildings", keys)).frames[1]
    direction = optics.pixel_directions(CameraTable(**keys["camera"]))
    # Looking down along an eastward track: up in the frame is east, right is south.
    place = frame.position_m + frame.range_m[..., None] * direction * np.array([1.0, -1.0, -1.0])
    east, north, height = np.moveaxis(place, -1, 0)
    level, margin = np.abs(height) < 0.1, 0.3
    dark = frame.luminance_cd_m2 < 0.5 * np.median(frame.luminance_cd_m2[level])
    along = np.abs(east) < 10.0 - margin
    shadow = along & (north > 5.0 + margin) & (north < 13.0 - margin) & level
    lit = level & ~((np.abs(east) < 10.0 + margin) & (north > 0.0) & (north < 13.0 + margin))
    assert shadow.sum() > 300
    assert dark[shadow].all()
    assert not dark[lit].any()


def test_exposure_fills_the_well_but_for_the_headroom_with_shot_noise():
    table, luminance = CameraTable(full_well=2000), np.full((200, 200), 4000.0)
    image, exposure_s = optics.expose(luminance, table, np.random.default_rng(1))
    electrons = luminance[0, 0] * optics.electrons_per_cd_m2(table, exposure_s)
    assert electrons == pytest.approx(2000 / 2**0.5)
    # ISO 12232: 0.65 L t / N^2 = 0.78 lx s at saturation.
    assert exposure_s == pytest.approx(0.78 * 2.8**2 / 0.65 / 4000.0 / 2**0.5)
    linear = (image / 255.0) ** 2.2
    # A variance of the mean and of the read noise; white follows the brightest pixels of the same noise.
    assert linear.std() / linear.mean() == pytest.approx(np.sqrt(electrons + 4) / electrons, rel=0.05)


def test_a_long_exposure_saturates_and_noise_hides_the_ground_at_night():
    white = camera(load_scenario("hills", {**FLAT, **LENS, "camera.exposure_ms": 1000.0})).frames[0]
    assert (white.image == 255).all()
    scenario = load_scenario("buildings", {**SHORT, "camera.night": True})
    first, again = (camera(scenario).frames for _ in range(2))
    night = first[0]
    assert night.noise > 100 * night.contrast
    assert night.exposure_s == optics.LONGEST_EXPOSURE_S
    ground = night.image[night.ground].astype(float)
    assert abs(ground.mean() - night.image[~night.ground].mean()) < 0.2 * ground.std()
    assert np.array_equal(night.image, again[0].image)
    assert not np.array_equal(night.image, first[1].image)


def test_a_frame_of_the_sky_alone_has_neither_contrast_nor_noise_of_the_ground(tmp_path):
    keys = {**FLAT, "camera": {"depression_deg": 0.0, "field_of_view_deg": 2.0, "pixels": [16, 12], "frames": 2}}
    film = camera(load_scenario("hills", keys))
    assert not film.frames[0].ground.any()
    assert np.isnan([film.frames[0].contrast, film.frames[0].noise]).all()
    DOCUMENT.write(film, tmp_path / "sky")
    assert json.loads((tmp_path / "sky" / "camera.json").read_text())["frames"][0]["contrast"] is None


def test_the_command_writes_frames_and_a_strip(cli, tmp_path):
    arguments = ["camera", "buildings", "-o", str(tmp_path / "film"), "--set", "sensor=camera"]
    cli(*arguments, *(word for key, value in SHORT.items() for word in ("--set", f"{key}={value}")))
    frames = sorted((tmp_path / "film" / "frames").iterdir())
    assert [frame.name for frame in frames] == ["frame_000.png", "frame_001.png"]
    assert imread(frames[0]).shape[:2] == (48, 64)
    assert (tmp_path / "film" / "figures" / "film_strip.png").is_file()
    document = json.loads((tmp_path / "film" / "camera.json").read_text())
    assert [frame["time_s"] for frame in document["frames"]] == pytest.approx([0.0, 0.5], abs=0.01)


def test_a_camera_makes_no_map():
    with pytest.raises(ScenarioError, match=r"sensor: 'camera' .* use `sionna-radar camera`"):
        run(load_scenario("hills", {"sensor": "camera"}))


@pytest.mark.parametrize(
    ("keys", "named"),
    [
        ({"weather.rain_cell": {"centre_m": [0.0, 0.0], "radius_m": 5.0, "peak_mm_per_h": 9.0}}, "weather.rain_cell"),
        ({"weather.liquid_water_g_per_m3": 0.1}, "weather.fog_visibility_m"),
        ({"camera": {"night": True, "sun_elevation_deg": 20.0}}, "night = false"),
        ({"camera.albedos": {"lawn": 0.1}}, "camera.albedos.lawn"),
    ],
)
def test_what_a_camera_cannot_take_is_refused_with_its_key(keys, named):
    with pytest.raises(ScenarioError, match=named):
        camera(load_scenario("hills", keys))


def test_what_a_camera_does_not_show_is_told():
    target = {"position_m": [0.0, 0.0], "height_m": 1.0, "rcs_dbsm": 10.0}
    film = camera(load_scenario("hills", {**SHORT, "targets": [target]}))
    assert any("[[targets]]" in warning for warning in film.warnings)


def test_a_camera_on_a_vehicle_with_a_panoramic_radar_looks_ahead_along_its_drive():
    """Level at the radar's height h, pixels below the horizon meet the ground at h / sin(depression), or the wall."""
    drive = {
        "terrain": {"kind": "flat", "size_m": [400.0, 400.0]},
        "platform.waypoints_m": [[-50.0, 0.0], [-20.0, 0.0]],
        "buildings": [{"position_m": [6.0, 0.0], "size_m": [40.0, 10.0, 30.0]}],
        "fences": [],
        "poles": [],
        "camera": {"frames": 2, "pixels": [64, 48], "depression_deg": 0.0},
    }
    film = camera(load_scenario("stadium", drive))
    down = optics.pixel_directions(film.scenario.camera)[..., 2]
    ahead = optics.pixel_directions(film.scenario.camera)[..., 0]
    for frame, wall_m in zip(film.frames, (51.0, 21.0), strict=True):
        assert frame.position_m[:2] == pytest.approx([1.0 - wall_m, 0.0], abs=0.1)
        height_m = frame.position_m[2]
        with np.errstate(divide="ignore"):
            ground_m = np.where(down > 0, height_m / down, np.inf)
        nearest_m = np.minimum(ground_m, (1.0 - frame.position_m[0]) / ahead)
        assert frame.range_m[:, 28:36] == pytest.approx(nearest_m[:, 28:36], rel=0.005)


def test_a_drive_under_a_roof_has_no_frames():
    inside = {"buildings": [{"position_m": [0.0, 0.0], "size_m": [90.0, 90.0, 9.0]}]}
    drive = {"platform.waypoints_m": [[-20.0, 0.0], [20.0, 0.0]], "fences": [], "poles": []}
    with pytest.raises(ScenarioError, match="under a roof or the ground"):
        camera(load_scenario("stadium", LENS | drive | inside))
