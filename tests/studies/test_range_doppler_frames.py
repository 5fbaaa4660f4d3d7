"""Frames of a flight: targets of known place in their maps, files, and what is refused."""

import json

import numpy as np
import pytest

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.report.range_doppler.products import write_frames
from sionna_radar.report.range_doppler.table import print_frames
from sionna_radar.scenario import load_scenario
from sionna_radar.studies.range_doppler import fly_frames

SPARSE = {"tracing.scatterers_per_m2": 10.0}


@pytest.fixture(scope="module")
def flown():
    return fly_frames(load_scenario("slar", SPARSE), chirps=32, frames=8)


def test_still_targets_have_the_range_rates_of_the_passing_radar(flown):
    """Reflectors beside the track: -v . d each, to a fraction of a cell."""
    assert len(flown.targets) == 3
    for target in flown.targets:
        assert target.found_range_m == pytest.approx(target.range_m, abs=0.2 * flown.last.chirp.range_resolution_m)
        assert target.found_rate_mps == pytest.approx(target.range_rate_mps, abs=0.25 * flown.analyser.rate_cell_mps)


def test_the_ground_smears_as_the_radar_passes(flown):
    """At 5 m/s, 28 m up and 45 deg: v^2 / r over 80 ms, in cells of half a wavelength over 80 ms."""
    frame_s = 32 / 400.0
    change_mps = 25.0 / (28.0 * np.sqrt(2)) * frame_s
    assert flown.smear_cells == pytest.approx(change_mps / (flown.last.chirp.wavelength_m / 2 / frame_s), rel=0.05)


def test_ground_that_stays_is_not_new(flown):
    assert flown.changed.mean() < 0.02
    assert flown.last.power.shape == flown.mean.shape == flown.detected.shape


def test_files_and_table(flown, tmp_path, capsys):
    files = write_frames(flown, tmp_path / "out")
    names = {str(file.relative_to(tmp_path / "out")) for file in files}
    assert {"range_doppler.json", "peaks.csv", "figures/range_doppler.png"} <= names
    document = json.loads((tmp_path / "out" / "range_doppler.json").read_text())
    assert document["chirps"] == 32
    assert len(document["targets"]) == 3
    print_frames(flown)
    assert "8 frames of 32 chirps" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("changes", "asked", "said"),
    [
        ({"tracing.speckle": "per_pulse"}, {}, "tracing.speckle: 'per_pulse' breaks"),
        ({"radar.sweep": "triangular"}, {}, "radar.sweep: 'triangular' has two sweeps"),
        (SPARSE, {"chirps": 2000}, "frames: 8 frames of 2000 chirps are not within"),
        (SPARSE, {"chirps": 2}, "chirps: 2 do not resolve"),
    ],
)
def test_what_cannot_be_framed_is_refused(changes, asked, said):
    with pytest.raises(ScenarioError, match=said):
        fly_frames(load_scenario("slar", changes), **asked)


def test_a_beam_that_turns_is_refused():
    with pytest.raises(ScenarioError, match="chirps: 64 turn the beam by"):
        fly_frames(load_scenario("hills", {"platform.length_m": 20.0, "terrain.spacing_m": 4.0}), frames=1)
