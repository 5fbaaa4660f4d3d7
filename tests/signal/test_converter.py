"""The converter: rounding, clipping, gain control, and the two parts of I/Q samples, by their closed forms."""

import numpy as np
import pytest

from direct_receiver import points_at
from flights import make_pulses
from receivers import radar_with, receiver_of
from sionna_radar.execution.execution import Execution
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario import load_scenario
from sionna_radar.scenario.presets import filled_in
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.signal.beat import synthesise
from sionna_radar.signal.build import noise_power
from sionna_radar.survey.observation import observe
from sionna_radar.survey.preparation import prepare
from sionna_radar.survey.warnings import saturation_warnings

PHYSICAL = {"transmit_power_dbm": 30.0, "noise_figure_db": 10.0, "samples_per_chirp": 4096}
# A beat that shares no period with the sampling, so that rounding errors are spread evenly.
FAR_M = 77.77


@pytest.mark.parametrize("sampling", ["real", "iq"])
@pytest.mark.parametrize("bits", [8, 10, 12])
def test_rounding_leaves_6_02_bits_and_1_76_db(bits, sampling):
    radar = radar_with({"converter": {"bits": bits, "full_scale_dbm": 0.0}}, sampling=sampling, **PHYSICAL)
    receiver = receiver_of(radar)
    # Just under a full-scale sine, whose highest code would be one too many.
    paths = points_at(FAR_M, np.sqrt(1e-3) * (1 - 2.0**-bits))
    (beat,), pulses = receiver.beats(paths, make_pulses(1)), make_pulses(1)
    clean = synthesise(paths, pulses, receiver.chirp)
    error = np.mean(np.abs(beat - clean) ** 2)
    snr_db = 10 * np.log10(np.mean(np.abs(clean) ** 2) / error)
    assert snr_db == pytest.approx(6.02 * bits + 1.76, abs=0.4)
    assert receiver.reception(paths, pulses).saturated.tolist() == [0]


@pytest.mark.parametrize(("sampling", "bits"), [("real", None), ("real", 8), ("iq", None)])
def test_a_flash_is_clipped_and_counted(sampling, bits):
    table = {"full_scale_dbm": 10.0, "gain_db": 20.0, **({} if bits is None else {"bits": bits})}
    receiver = receiver_of(radar_with({"converter": table}, sampling=sampling, **PHYSICAL))
    # 1e-4 W at the antenna fill it; the second pulse has four times that.
    paths, pulses = points_at(FAR_M, [0.999e-2, 2e-2], pulse=[0, 1]), make_pulses(2)
    seen = receiver.reception(paths, pulses)
    full = 1e-2 * (np.sqrt(2) if sampling == "real" else 1)
    beat = seen.beats[0]
    assert np.max(np.abs(np.stack([beat.real, beat.imag]))) <= full * (1 + 1e-12)
    # A sine of twice the amplitude of full scale lies beyond it two thirds of the time.
    expected = 2 / 3 if sampling == "real" else 1.0
    rounded = 0 if bits is None else 0.1
    assert seen.saturated[0] <= rounded * receiver.chirp.samples
    assert seen.saturated[1] / receiver.chirp.samples == pytest.approx(expected, abs=0.01)


def test_one_bit_tells_the_sign():
    receiver = receiver_of(radar_with({"converter": {"bits": 1, "agc_headroom_db": 0.0}}))
    (beat,) = receiver.beats(points_at(20.0, 0.01), make_pulses(1))
    clean = synthesise(points_at(20.0, 0.01), make_pulses(1), receiver.chirp)
    np.testing.assert_array_equal(np.sign(beat), np.where(clean < 0, -1, 1))
    assert len(np.unique(np.abs(beat))) == 1


def test_a_gain_control_gives_every_sweep_the_same_share_of_the_converter():
    receiver = receiver_of(radar_with({"converter": {"bits": 8, "agc_headroom_db": 6.0}}, samples_per_chirp=4096))
    paths, pulses = points_at(FAR_M, [1e-6, 1.0], pulse=[0, 1]), make_pulses(2)
    seen = receiver.reception(paths, pulses)
    clean = synthesise(paths, pulses, receiver.chirp)
    error = np.sqrt(np.mean((seen.beats[0] - clean) ** 2, axis=1))
    np.testing.assert_allclose(error / [1e-6, 1.0], error[1], rtol=0.1)
    # A quarter of the power of full scale: 6 dB less than a sine that fills it.
    assert -20 * np.log10(error[1]) == pytest.approx(6.02 * 8 + 1.76 - 6.0, abs=0.5)
    assert not np.any(seen.saturated)


def test_full_scale_over_the_noise_needs_no_powers():
    radar = radar_with({"converter": {"full_scale_over_noise_db": 20.0}}, sampling="iq")
    receiver = receiver_of(radar, noise_w=1e-6)
    (beat,) = receiver.beats(points_at(20.0, 1.0), make_pulses(1))
    assert np.max(np.abs(beat.real)) == pytest.approx(1e-2)


@pytest.mark.parametrize(("gain_db", "phase_deg"), [(0.5, 0.0), (0.0, 3.0), (-1.0, 2.0)])
def test_unlike_parts_have_the_image_of_their_closed_form(gain_db, phase_deg):
    keys = {"converter": {"iq_gain_db": gain_db, "iq_phase_deg": phase_deg}}
    receiver = receiver_of(radar_with(keys, sampling="iq", samples_per_chirp=1024))
    chirp = receiver.chirp
    (beat,) = receiver.beats(points_at(100 * chirp.range_resolution_m), make_pulses(1))
    power = np.abs(np.fft.fft(beat[0])) ** 2
    g, lag = 10 ** (gain_db / 20), np.deg2rad(phase_deg)
    rejection = (1 + 2 * g * np.cos(lag) + g**2) / (1 - 2 * g * np.cos(lag) + g**2)
    assert power[100] / power[1024 - 100] == pytest.approx(rejection, rel=1e-6)
    # By definition: the parts of the clean samples, one of them amplified and late.
    clean = synthesise(points_at(100 * chirp.range_resolution_m), make_pulses(1), chirp)
    late = g * (clean.imag * np.cos(lag) - clean.real * np.sin(lag))
    np.testing.assert_allclose(beat, clean.real + 1j * late, atol=1e-12)


def test_an_offset_stands_at_zero():
    keys = {"converter": {"full_scale_over_noise_db": 60.0, "dc_offset_db": -20.0}}
    (beat,) = receiver_of(radar_with(keys), noise_w=1e-6).beats(points_at(20.0, 0.0), make_pulses(3))
    # A tenth of the amplitude of a sine of 1 W, beside the noise.
    assert beat.mean() == pytest.approx(0.1 * np.sqrt(2), abs=5e-3 / np.sqrt(beat.size / 25))


def test_the_noise_figure_of_amplifiers_is_friis():
    """Skolnik: a low-noise amplifier of 20 dB and 3 dB in front of a mixer of -7 dB and an amplifier of 4 dB."""
    chain = [(20.0, 3.0), (-7.0, 7.0), (30.0, 4.0)]
    amplifiers = [{"gain_db": gain, "noise_figure_db": figure} for gain, figure in chain]
    radar = RadarTable(transmit_power_dbm=10.0, receiver={"amplifiers": amplifiers})
    factors, gains = (10 ** (np.array(column) / 10) for column in ([f for _, f in chain], [g for g, _ in chain]))
    expected = factors[0] + (factors[1] - 1) / gains[0] + (factors[2] - 1) / (gains[0] * gains[1])
    assert radar.system_noise_figure_db == pytest.approx(10 * np.log10(expected))
    assert radar.receiver.amplifier_gain_db == 43.0
    plain = RadarTable(transmit_power_dbm=10.0, noise_figure_db=10 * np.log10(expected))
    chirp = receiver_of(radar).chirp
    assert noise_power(radar, chirp, 1.0) == pytest.approx(noise_power(plain, chirp, 1.0))
    # A preset's own noise figure makes room for them.
    filled = filled_in({"preset": "ti_awr1843", "receiver": {"amplifiers": amplifiers}}, {})
    assert RadarTable(**filled).system_noise_figure_db == radar.system_noise_figure_db


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"converter.bits": 8}, "converter.bits: needs a full scale"),
        ({"converter": {"agc_headroom_db": 3.0, "full_scale_over_noise_db": 60.0}}, "contradicts full_scale_over"),
        ({"converter.full_scale_dbm": 0.0}, "full_scale_dbm: needs transmit_power_dbm"),
        ({"converter.gain_db": 3.0}, "gain_db: has no effect"),
        ({"converter.iq_phase_deg": 3.0}, "real samples have no quadrature component"),
        ({"anti_alias_order": 3}, "anti_alias_order: 3 has no effect"),
        ({"anti_alias_corner_hz": 1e8}, "lies far beyond"),
        ({"anti_alias_corner_hz": 1e-300}, "anti_alias_corner_hz: 1e-300 is negligible against the highest beat"),
        ({"high_pass_corner_hz": 1e-40, "high_pass_order": 4}, "high_pass_corner_hz: 1e-40 is negligible against"),
        ({"oscillator.phase_noise_dbc_hz": [[1e6, -100.0], [np.nextafter(1e6, 2e6), -90.0]]}, "offsets must increase"),
        ({"oscillator": {"drift_ppm_per_k": -1e4, "warmer_k": 100.0}}, "drift_ppm_per_k: -10000 over 100 K scale"),
        ({"amplifiers": [{"gain_db": -100.0, "noise_figure_db": 100.0}] * 40}, "amplifiers: their total gain of -400"),
        ({"stages.mixer": "noise"}, "stages.mixer: 'noise' is a built-in stage of another position"),
    ],
)
def test_what_cannot_be_is_refused(keys, message):
    with pytest.raises(ScenarioError, match=message):
        load_scenario("hills", {f"radar.receiver.{key}": value for key, value in keys.items()})


def test_amplifiers_beside_a_noise_figure_are_refused():
    amplifiers = [{"gain_db": 20.0, "noise_figure_db": 3.0}]
    with pytest.raises(ScenarioError, match=r"receiver.amplifiers: contradicts noise_figure_db"):
        RadarTable(transmit_power_dbm=10.0, noise_figure_db=3.0, receiver={"amplifiers": amplifiers})


def test_saturation_is_counted_over_a_survey_in_any_blocks():
    scenario = load_scenario(
        "hills",
        {
            "platform.length_m": 2.0,
            "tracing.paths_per_pulse": 32,
            "terrain.spacing_m": 2.0,
            "radar.receiver.converter": {"bits": 10, "full_scale_over_noise_db": 36.0},
        },
    )
    ready = prepare(scenario)
    counts = []
    for block in (7, 64):
        recording = observe(ready, Execution(block_size=block))[1]
        counts.append((recording.saturated_pulses, recording.saturated_samples))
        again = type(recording).unpacked(recording.packed())
        assert (again.saturated_pulses, again.saturated_samples) == counts[-1]
    assert counts[0] == counts[1]
    assert 0 < counts[0][0] < counts[0][1]


@pytest.mark.parametrize(("headroom_db", "remedy"), [(None, "set agc_headroom_db"), (0.0, "raise agc_headroom_db")])
def test_clipped_pulses_are_told_with_what_helps(headroom_db, remedy):
    (said,) = saturation_warnings(3, 10, headroom_db)
    assert said.endswith(remedy)
    assert list(saturation_warnings(0, 10, headroom_db)) == []
