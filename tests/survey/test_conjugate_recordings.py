"""Simulated recordings whose Q has the other sign: warned of, and turned by the key that the warning names."""

import shutil

import h5py
import numpy as np
import pytest

from sionna_radar import load_scenario, process, run
from sionna_radar.foundation.errors import ScenarioError

WORDS = "of the energy of echoes lies in the farther half of the ranges"


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A recording of I/Q samples over ground within the nearer half of the ranges, and the same with -Q."""
    folder = tmp_path_factory.mktemp("conjugate")
    changes = {"radar.sampling": "iq", "platform.length_m": 4.0, "terrain.spacing_m": 2.0, "radar.bandwidth_hz": 3e8}
    run(load_scenario("hills", changes), recordings={"signals": folder / "whole.nc"})
    shutil.copy(folder / "whole.nc", folder / "turned.nc")
    with h5py.File(folder / "turned.nc", "r+") as file:
        file["beat_q"][...] = -file["beat_q"][...]
    return folder


def test_a_simulated_recording_of_the_other_sign_is_warned_of_and_turned(flown):
    whole, turned = process(flown / "whole.nc"), process(flown / "turned.nc")
    assert not any(WORDS in warning for warning in whole.warnings)
    (warning,) = (warning for warning in turned.warnings if WORDS in warning)
    assert "set radar.conjugate = true" in warning
    again = process(flown / "turned.nc", {"radar.conjugate": True})
    assert not any(WORDS in warning for warning in again.warnings)
    np.testing.assert_array_equal(again.echoes.range_m, whole.echoes.range_m)
    np.testing.assert_array_equal(again.dem.height_m, whole.dem.height_m)


def test_true_ranges_in_the_farther_half_are_no_other_sign(tmp_path):
    """Ground at 66 to 80 m of 128: the truth in the recording says so."""
    far = {"radar.sampling": "iq", "platform.length_m": 6.0, "terrain.spacing_m": 2.0, "radar.bandwidth_hz": 3e8}
    far |= {"radar.samples_per_chirp": 240, "dem.spacing_m": 2.0}
    run(load_scenario("hills", far), recordings={"signals": tmp_path / "far.nc"})
    processed = process(tmp_path / "far.nc")
    assert not any(WORDS in warning for warning in processed.warnings)
    assert np.min(processed.echoes.range_m) > 60.0


@pytest.mark.parametrize(
    ("value", "words"), [(1, "must be true or false, not 1"), ("yes", "must be true or false, not 'yes'")]
)
def test_another_value_is_one_error(flown, value, words):
    with pytest.raises(ScenarioError, match=f"radar.conjugate: {words}"):
        process(flown / "whole.nc", {"radar.conjugate": value})


def test_the_rest_of_the_radar_stays_fixed(flown):
    with pytest.raises(ScenarioError, match=r"radar.sampling: cannot be changed for a recording"):
        process(flown / "whole.nc", {"radar.sampling": "real"})
