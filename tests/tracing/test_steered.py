"""Arrays that steer their beams: each pulse is traced with the antenna of its own beam."""

from dataclasses import replace

import numpy as np
import pytest

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.radar.antenna import in_main_lobe
from sionna_radar.scenario import load_scenario
from sionna_radar.survey.preparation import prepare
from sionna_radar.survey.warnings import steered_warnings
from sionna_radar.tracing.build import build_steered_tracer

SCAN = {"mode": "electronic", "beams": 3, "half_swath_deg": 40.0, "scans_per_s": 40.0, "incidence_deg": 30.0}
OVERRIDES = {
    "radar.antenna": {"elements": [12, 12], "taper_db": -25.0},
    "radar.scan": SCAN,
    "platform.length_m": 2.0,
    "tracing.paths_per_pulse": 128,
    # The same for the whole scan and for one beam of it, which footprints ask for less.
    "tracing.scatterers_per_m2": 0.5,
}


@pytest.fixture(scope="module")
def prepared():
    return prepare(load_scenario("hills", OVERRIDES))


def test_every_pulse_has_the_antenna_of_its_beam(prepared):
    pulses = prepared.flight.pulses(np.arange(9))
    paths = prepared.sensor_inputs().tracer().trace(pulses)
    assert np.all(np.diff(paths.pulse) >= 0)
    for number, beam in enumerate(prepared.instrument.beams):
        own = pulses.rows(np.flatnonzero(pulses.beam == number))
        inputs = prepared.sensor_inputs()
        alone = replace(inputs, engine=replace(inputs.engine, antenna=beam, beams=())).tracer().trace(own)
        kept = np.isin(paths.pulse, own.index)
        np.testing.assert_array_equal(paths.gain[kept], alone.gain)
        np.testing.assert_array_equal(paths.hit_m[kept], alone.hit_m)


def test_blocks_do_not_matter(prepared):
    tracer = prepared.sensor_inputs().tracer()
    whole = tracer.trace(prepared.flight.pulses(np.arange(12)))
    parts = [tracer.trace(prepared.flight.pulses(np.arange(i, i + 4))) for i in (0, 4, 8)]
    np.testing.assert_array_equal(whole.gain, np.concatenate([part.gain for part in parts]))


def test_a_rest_forgets_nothing_that_matters(prepared):
    tracer = prepared.sensor_inputs().tracer()
    pulses = prepared.flight.pulses(np.arange(12))
    before = tracer.trace(pulses)
    engine = tracer._tracers[0]._engine
    assert engine._scatterers._used > 0
    tracer.release_memory()
    assert engine._scatterers._used == 0
    np.testing.assert_array_equal(tracer.trace(pulses).gain, before.gain)


def test_most_power_comes_from_the_beam_itself(prepared):
    """Two-way power falls off so fast that the half-power beam has most of an echo's."""
    pulses = prepared.flight.pulses(np.arange(12))
    paths = prepared.sensor_inputs().tracer().trace(pulses)
    row = pulses.row_of(paths.pulse)
    away = paths.hit_m - pulses.true.position_m[row]
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    ahead = np.einsum("nij,ni->nj", pulses.true.R_world_antenna[row], away)
    power = np.abs(paths.gain.astype(complex)) ** 2
    for number, beam in enumerate(prepared.instrument.beams):
        own = pulses.beam[row] == number
        assert power[own & in_main_lobe(beam, ahead)].sum() > 0.7 * power[own].sum()


def test_maps_of_whole_echoes_say_what_they_take_a_beam_for():
    assert [*steered_warnings(0, "refined", "required"), *steered_warnings(45, "linear", "unused")] == []
    (said,) = steered_warnings(45, "refined", "required")
    assert "models every beam of the scan as the narrower broadside beam" in said


def test_an_engine_that_cannot_be_steered_is_refused(prepared):
    given = prepared.engine_inputs()

    class Fixed:
        def trace(self, pulses):
            """An engine, but for an antenna that is not its own."""

    with pytest.raises(ScenarioError, match=r"tracing.engine: Fixed has no method with_antenna"):
        build_steered_tracer(Fixed(), given, prepared.local.weather)
