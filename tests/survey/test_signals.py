"""Paths, beat signals, spectra and echoes of any pulse are those that the survey flies."""

from dataclasses import fields

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario import load_scenario
from sionna_radar.survey.chain import run
from sionna_radar.survey.preparation import prepare

SHORT = {"platform.length_m": 6.0, "terrain.spacing_m": 2.0, "tracing.paths_per_pulse": 64}


@pytest.fixture(scope="module")
def prepared():
    return prepare(load_scenario("hills", SHORT))


def test_each_stage_of_a_pulse_is_that_of_the_survey(prepared):
    survey, chosen = run(prepared), [3, 17, 40]
    points = survey.points.rows(np.isin(survey.points.pulse, chosen))
    echoes = prepared.echoes(chosen)
    np.testing.assert_array_equal(echoes.range_m, points.range_m)
    paths = prepared.paths(chosen)
    assert set(np.unique(paths.pulse)) == set(chosen)
    (beat,) = prepared.beats(chosen)
    assert beat.shape == (3, prepared.receiver.chirp.samples)
    records = prepared.spectra(chosen)
    assert [record.pulse for record in records] == chosen
    np.testing.assert_array_equal(records[1].beat, beat[1])
    np.testing.assert_array_equal(survey.points.to_dataframe()["range_m"], survey.points.range_m)
    assert list(survey.points.to_dataframe()[["x_m", "y_m", "z_m"]].iloc[5]) == list(survey.points.position_m[5])


@pytest.mark.parametrize("sweep", ["up", "triangular"])
@pytest.mark.usefixtures("sketched_rain")
def test_behind_rain_the_echoes_of_a_pulse_are_those_of_the_survey(sweep):
    """Rain is told apart over a whole scan line, whichever of its pulses are asked for."""
    strongest = {"processing.echoes": "strongest"} if sweep == "triangular" else {}
    coarse = {"radar.samples_per_chirp": 512, "radar.bandwidth_hz": 250e6}
    rainy = SHORT | coarse | {"weather.rain_rate_mm_per_h": 12.0, "radar.sweep": sweep} | strongest
    prepared = prepare(load_scenario("hills", rainy))
    survey, chosen = run(prepared), [5, 6, 29, 40, 60]
    of_survey = survey.points.rows(np.isin(survey.points.pulse, chosen))
    with threadpool_limits(2):  # which a program of its own has, unlike these tests
        echoes = prepared.echoes(chosen)
    assert len(echoes) > 2
    np.testing.assert_array_equal(echoes.pulse, of_survey.pulse)
    np.testing.assert_array_equal(echoes.range_m, of_survey.range_m)
    observed = prepared.observe(chosen)
    profiles = observed.profiles
    assert observed.through_volume
    assert profiles is None or list(profiles.pulse) == list(echoes.pulse)
    of_all = prepared.spectra(range(len(prepared)))
    for record in prepared.spectra(chosen):
        for field in fields(record):
            np.testing.assert_array_equal(getattr(record, field.name), getattr(of_all[record.pulse], field.name))


@pytest.mark.parametrize("index", [[], [5, 4], [-1], [1_000_000]])
def test_pulses_that_there_are_not_are_refused(prepared, index):
    with pytest.raises(IndexError, match="give increasing numbers from 0 to"):
        prepared.paths(index)


def test_a_lidar_has_neither_beats_nor_spectra():
    lidar = prepare(load_scenario("hills", SHORT | {"sensor": "lidar"}))
    assert len(lidar.echoes([0])) == 1
    for call in (lidar.beats, lidar.spectra):
        with pytest.raises(ScenarioError, match="set sensor = 'radar'"):
            call([0])
