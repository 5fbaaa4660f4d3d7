"""`init --from` flies what it writes before it says so."""

import tomllib

import laspy
import numpy as np
import pytest
from pyproj import CRS

from elevation_files import from_origin, write_heights
from sionna_radar import panorama
from sionna_radar.scenario import load_scenario
from sionna_radar.scenario.presets import PRESETS
from sionna_radar.survey.preparation import prepare


@pytest.fixture(scope="module")
def ground(tmp_path_factory):
    folder = tmp_path_factory.mktemp("init")
    heights = np.random.default_rng(2).normal(300, 0.2, size=(140, 140)).astype(np.float32)
    write_heights(folder / "dem.tif", heights, from_origin(560_000.0, 5_500_000.0, 2.0, 2.0))
    for name, size in {"small.las": 30.0, "tiny.las": 2.0}.items():
        header = laspy.LasHeader(point_format=6, version="1.4")
        header.offsets, header.scales = [560_000.0, 5_500_000.0, 0.0], [0.001] * 3
        header.add_crs(CRS.from_epsg(25832))
        cloud = laspy.LasData(header)
        place = np.random.default_rng(1).uniform(0, size, size=(2, 3000))
        cloud.x, cloud.y, cloud.z = 560_000 + place[0], 5_500_000 + place[1], 250 + 0 * place[0]
        cloud.return_number[:] = 1
        cloud.write(folder / name)
    return folder


@pytest.mark.parametrize("preset", PRESETS)
def test_every_preset_begins_over_a_raster(cli, ground, tmp_path, preset):
    file = tmp_path / "a.toml"
    said = cli("init", file, "--from", ground / "dem.tif", "--from", preset).stdout
    if PRESETS[preset].keys["scan"]["mode"] == "panoramic":
        assert f"fly it with: sionna-radar panorama {file}" in said
        assert len(panorama(load_scenario(file, {"platform.length_m": 12.0, "tracing.paths_per_pulse": 64})).images)
    else:
        assert f"fly it with: sionna-radar run {file}" in said
        prepare(load_scenario(file))
    table = tomllib.loads(file.read_text())
    assert ("array" in PRESETS[preset].keys) == (table.get("sensor") == "mimo")
    assert preset.startswith("alt_") == (table.get("processing", {}).get("ranging") == "tracker")


def test_a_small_cloud_is_flown_lower(cli, ground, tmp_path):
    file = tmp_path / "a.toml"
    said = cli("init", file, "--from", ground / "small.las").stdout
    assert "as the ground is small" in said
    assert "fly it with" in said
    scenario = load_scenario(file)
    assert 3.0 < scenario.platform.altitude_m < 15.0
    prepare(scenario)


def test_what_cannot_be_flown_yet_is_said_with_its_reason(cli, ground, tmp_path):
    file, grid = tmp_path / "a.toml", tmp_path / "dgm1.xyz"
    grid.write_text("".join(f"{x} {y} 5.0\n" for x in range(30) for y in range(30)))
    said = cli("init", file, "--from", grid).stdout
    assert "it cannot be flown yet: terrain.crs: missing, and the file has no CRS" in said
    assert "fly it with" not in said
    assert file.exists()
    said = cli("init", tmp_path / "b.toml", "--from", ground / "tiny.las").stdout
    assert "it cannot be flown yet: platform" in said
    assert "exists already" in cli("init", file, "--from", ground / "dem.tif", code=2).stderr
