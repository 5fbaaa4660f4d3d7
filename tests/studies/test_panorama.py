"""Panoramic images: levels by the radar equation, widths, contrast, folding, distortion, and the file."""

import numpy as np
import pytest
from matplotlib.image import imread

from sionna_radar import load_scenario, panorama
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.radar.build import build_antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.studies.panorama import read_images
from sionna_radar.studies.panorama.document import document_of, write_polar
from sionna_radar.studies.panorama.polar_images import PolarImages, Way
from sionna_radar.survey.sensors.radar import Radar

PLACE = (60.0, 0.0)
TARGET = {"position_m": [60.0, 0.0], "height_m": 2.0, "rcs_dbsm": 20.0}
EMPTY = {
    "buildings": [],
    "fences": [],
    "poles": [],
    "terrain": {"kind": "flat", "size_m": [800.0, 800.0]},
    "platform.waypoints_m": [[0.0, -8.0], [0.0, 8.0]],
    "tracing.paths_per_pulse": 64,
}


def drive(**overrides):
    return panorama(load_scenario("stadium", EMPTY | overrides))


@pytest.fixture(scope="module")
def passed():
    """A corner reflector to the right of the road, passed at 8 m/s."""
    slow = {"platform.speed_mps": 8.0, "platform.waypoints_m": [[0.0, -20.0], [0.0, 12.0]]}
    return drive(targets=[TARGET], **slow)


def at_target(seen, turn, way):
    """Return the patch of a turn around the target, its cell of 0.25 m, and where it is brightest."""
    grid = seen.images.grid(way, 0.25, 100.0, turn=turn)
    power = seen.images.on_grid(turn, grid, way)
    power[np.hypot(grid.x_m[None] - PLACE[0], grid.y_m[:, None] - PLACE[1]) > 6] = np.nan
    row, column = np.unravel_index(np.nanargmax(power), power.shape)
    return power, np.array([grid.x_m[column], grid.y_m[row]])


def test_a_target_stands_where_it_is_in_every_turn(passed):
    errors = [at_target(passed, turn, passed.images.true)[1] - PLACE for turn in range(len(passed.images))]
    # Half a pixel, and the width of the beam at 60 m within which noise and ground may shift its top.
    assert np.abs(errors)[:, 0].max() < 0.3
    assert np.abs(errors)[:, 1].max() < 0.6


def test_a_target_behind_stands_once_where_a_turn_begins_and_ends():
    """A turn begins and ends at the rear, from places 12 m apart."""
    behind = TARGET | {"position_m": [0.3, -40.0], "rcs_dbsm": 35.0}
    fast = {"platform.waypoints_m": [[0.0, -13.0], [0.0, 13.0]], "platform.speed_mps": 12.0}
    images = drive(targets=[behind], **fast).images
    for turn in range(len(images)):
        grid = images.grid(images.true, 0.25, 100.0, turn=turn)
        bright = images.on_grid(turn, grid, images.true) > images.power_w.max() / 10
        away = np.hypot(grid.x_m[None] - 0.3, grid.y_m[:, None] + 40.0)[bright]
        # Twice the two-way beam of 3 deg, and two range cells, around it.
        assert len(away) > 0
        assert away.max() < np.deg2rad(3.0) * 55.0 + 1.2


@pytest.mark.parametrize("antenna", [1, -1])
@pytest.mark.parametrize("yaw_deg", [-50.0, 0.0, 30.0])
def test_a_place_shows_the_chirp_that_looked_at_it_or_nothing(yaw_deg, antenna):
    """A vehicle that turns on the spot, against its antenna or with it: the images hold the bearing of each chirp."""
    azimuths = 400
    share = np.arange(azimuths) / azimuths
    bearing = 0.7 + antenna * (2 * np.pi + np.deg2rad(yaw_deg)) * share[None]
    at_rest = np.zeros((1, azimuths, 3))
    chirp = Chirp(carrier_hz=24e9, bandwidth_hz=250e6, rate_hz=400.0, samples=512)
    images = PolarImages(
        chirp=chirp,
        beamwidths_rad=(0.07, 0.3),
        power_w=np.broadcast_to((antenna * (bearing - 0.7))[:, :, None], (1, azimuths, 256)),
        range_m=chirp.range_resolution_m * np.arange(256),
        time_s=share[None],
        scan_rad=antenna * 2 * np.pi * share[None],
        true=Way(position_m=at_rest, velocity_mps=at_rest, bearing_rad=bearing),
        measured=None,
    )
    grid = images.grid(images.true, 1.0, 60.0, turn=0)
    shown = images.on_grid(0, grid, images.true).ravel()
    wanted = np.mod(antenna * (np.arctan2(*grid.centres_m.T) - 0.7), 2 * np.pi)
    off = np.deg2rad(360.0 + yaw_deg) / azimuths
    # The last chirp stands for one step, and what the search leaves.
    assert np.abs(shown - wanted)[np.isfinite(shown)].max() <= 1.5 * off
    unseen = wanted > np.deg2rad(360.0 + yaw_deg) + off
    clear = np.abs(wanted - np.deg2rad(360.0 + yaw_deg)) > 2 * off
    assert np.array_equal(np.isnan(shown)[clear], unseen[clear])


def test_as_one_picture_it_errs_by_what_was_driven_and_by_doppler(passed):
    images, turn = passed.images, 0
    way = images.true
    grid = images.grid(way, 0.25, 100.0, turn=turn)
    power = images.on_grid(turn, grid, way, as_one=True)
    row, column = np.unravel_index(np.nanargmax(np.where(np.hypot(*(grid.centres_m - PLACE).T).reshape(grid.shape) < 9,
                                                         power, np.nan)), grid.shape)  # fmt: skip
    at = np.array([grid.x_m[column], grid.y_m[row]])
    # The beam looks to the right a quarter of a turn after the middle of it: 2 m farther on its way, the target appears
    # so much farther back; and Doppler brings it nearer by what the radar approaches it.
    row = int(np.argmin(np.abs(np.mod(way.bearing_rad[turn] - np.arctan2(60, -way.position_m[turn, :, 1]), 2 * np.pi))))
    place, middle = way.position_m[turn, row], way.position_m[turn, way.bearing_rad.shape[1] // 2]
    away = np.array([*PLACE, 2.0]) - place
    shift_m = passed.images.chirp.doppler_range_s * -(way.velocity_mps[turn, row] @ away) / np.linalg.norm(away)
    expected = PLACE + (middle - place)[:2] + shift_m * away[:2] / np.linalg.norm(away[:2])
    assert at == pytest.approx(expected, abs=0.6)
    assert np.linalg.norm(expected - PLACE) > 1.5


def test_its_level_and_widths_are_those_of_the_radar_equation_and_the_beam(passed):
    images = passed.images
    chirp, scenario = images.chirp, passed.scenario
    row = int(np.argmax(images.power_w[1].max(axis=1)))
    peak = images.power_w[1, row].max()
    place = images.true.position_m[1, row]
    range_m = np.linalg.norm([*PLACE, 2.0] - place)
    gain = float(build_antenna(scenario.radar.antenna, None).gain(np.array([[1.0, 0.0, 0.0]]))[0])
    expected = 0.1 * gain**2 * chirp.wavelength_m**2 * 100.0 / ((4 * np.pi) ** 3 * range_m**4)
    # Between two bins of half a cell the Hann window loses up to 0.36 dB, between two chirps the beam up to 0.30 dB.
    assert -0.7 < 10 * np.log10(peak / expected) < 0.1
    cut = images.power_w[1, :, np.argmax(images.power_w[1, row])]
    above = np.count_nonzero(cut > cut.max() / 2) * 2 * np.pi / images.power_w.shape[1]
    step = 2 * np.pi / images.power_w.shape[1]
    assert above == pytest.approx(passed.azimuth_resolution_rad, abs=1.5 * step)


def test_ground_is_fully_developed_speckle():
    images = drive(**{"tracing.paths_per_pulse": 4096}).images
    # Ground from 20 to 40 m, where its echo is far over the noise; each range has its own mean. N equal scatterers in a
    # cell have the contrast sqrt(1 - 1 / N): here there are some 40.
    ground = images.power_w[:, :, (images.range_m > 20) & (images.range_m < 40)].astype(float)
    contrast = ground.std(axis=(0, 1)) / ground.mean(axis=(0, 1))
    assert np.median(contrast) == pytest.approx(1.0, abs=0.04)


@pytest.mark.parametrize("corner_hz", [0.0, 1e5])
def test_what_lies_beyond_the_unambiguous_range_folds_unless_an_ideal_filter_takes_it_out(corner_hz):
    far = {"position_m": [200.0, 0.0], "height_m": 2.0, "rcs_dbsm": 60.0}
    images = drive(**{"targets": [far], "radar.receiver.anti_alias_corner_hz": corner_hz}).images
    row, cell = np.unravel_index(np.argmax(images.power_w[0] * (images.range_m > 50)), images.power_w[0].shape)
    folded_m = 2 * images.chirp.max_range_m - 200.0
    if corner_hz:
        assert images.range_m[cell] == pytest.approx(folded_m, abs=0.5)
        assert np.rad2deg(images.scan_rad[0, row]) == pytest.approx(90.0, abs=3.0)
    else:
        assert images.power_w[0, row, cell] < 1e-11  # of the ground; the folded echo has 1e-7 W


def test_the_file_holds_the_images(passed, tmp_path):
    path = tmp_path / "panorama.nc"
    passed.images.write(path)
    read = read_images(path)
    assert read.chirp == passed.images.chirp
    for name in ("power_w", "range_m", "time_s", "scan_rad"):
        assert np.array_equal(getattr(read, name), getattr(passed.images, name)), name
    for name in ("position_m", "velocity_mps", "bearing_rad"):
        assert np.array_equal(getattr(read.true, name), getattr(passed.images.true, name)), name
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(InputFileError, match="panoramic images"):
        read_images(path)


def test_the_picture_of_a_turn_is_brightest_at_the_target(passed, tmp_path):
    path = tmp_path / "turn.png"
    write_polar(path, passed.images.power_w[0])
    pixels = imread(path)
    assert pixels.shape[:2] == passed.images.power_w[0].shape
    row, column = np.unravel_index(passed.images.power_w[0].argmax(), pixels.shape[:2])
    assert pixels[..., :3].sum(axis=2).max() == pixels[row, column, :3].sum()
    assert passed.images.range_m[column] == pytest.approx(60.0, abs=10.0)


def test_a_mosaic_reaches_as_far_as_its_images_and_is_not_laid_on_endless_pixels(passed, tmp_path):
    keys = {"along": "true", "every": 1}
    far, last = (
        document_of(spacing_m=1.0, reach_m=reach_m, **keys).content(passed)["mosaic"]
        for reach_m in (1e12, float(passed.images.range_m[-1]))
    )
    assert far == last
    with pytest.raises(ScenarioError, match=r"spacing_m: 0\.005 m makes .* pixels along this way, more than"):
        document_of(spacing_m=0.005, reach_m=None, **keys).write(passed, tmp_path / "fine")
    assert not (tmp_path / "fine").exists()


@pytest.mark.parametrize("along", ["true", "measured"])
def test_a_mosaic_of_endless_pixels_is_refused_before_the_drive(cli, tmp_path, monkeypatch, along):
    monkeypatch.setattr(Radar, "beat", lambda *_: pytest.fail("the drive began"))
    command = ("panorama", "stadium", "--spacing", "0.02", "--along", along, "-o", tmp_path / "fine")
    assert "spacing_m: 0.02 m makes " in cli(*command, code=2).stderr
    assert not (tmp_path / "fine").exists()


def test_what_is_accepted_before_the_drive_are_the_times_and_poses_of_the_images(passed):
    seen = []
    again = panorama(passed.scenario, accept=lambda images: seen.append((images, images.power_w.shape)))
    assert seen[0][0] is again.images
    assert seen[0][1] == passed.images.power_w.shape
    np.testing.assert_array_equal(again.images.power_w, passed.images.power_w)
    np.testing.assert_array_equal(again.images.time_s, passed.images.time_s)


@pytest.mark.parametrize(
    ("overrides", "key"),
    [
        ({"radar.scan": {"mode": "whisk_broom"}}, "radar.scan.mode"),
        ({"radar.snr_db": 30.0}, "radar.snr_db"),
        ({"platform.waypoints_m": [[0.0, 0.0], [0.0, 4.0]]}, "no complete turn"),
        ({"sensor": "lidar"}, "sensor"),
        ({"tracing.speckle": "persistent"}, "tracing.speckle"),
        ({"buildings": [{"position_m": [0.0, 0.0], "size_m": [6.0, 6.0, 9.0]}]}, "under a roof"),
    ],
)
def test_what_makes_no_images_is_refused(overrides, key):
    with pytest.raises(ScenarioError, match=key):
        drive(**overrides)


def test_a_survey_of_a_panoramic_scan_is_refused_with_the_command_that_takes_it():
    from sionna_radar import prepare

    with pytest.raises(ScenarioError, match="sionna-radar panorama"):
        prepare(load_scenario("stadium", EMPTY))


def test_its_keys_are_validated_and_its_drive_is_left_to_the_command(cli):
    said = cli("validate", "stadium").stdout
    assert 'preset = "pelican"' in said
    assert "checked by `sionna-radar panorama`" in said
