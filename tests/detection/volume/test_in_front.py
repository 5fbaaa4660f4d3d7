"""Echoes that stand out of rain in front of the ground, held against closed forms of speckle and of targets in it."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from scipy.special import gammainccinv
from scipy.stats import ncx2

from sionna_radar import load_scenario, run
from sionna_radar.detection.detector import Detector
from sionna_radar.detection.echoes import Echoes
from sionna_radar.detection.ranging.estimators import EchoSpans
from sionna_radar.detection.volume.clutter import speckle_quantile
from sionna_radar.detection.volume.end import VolumeEnd
from sionna_radar.detection.volume.in_front import spans_in_front, with_echoes_in_front, without_spans
from sionna_radar.survey.preparation import prepare
from sionna_radar.survey.sensors.radar import Radar

# Range cells of a boxcar without padding are independent.
PLAIN = {"processing.window": "boxcar", "processing.zero_padding": 1}
RAIN = {"weather.rain_rate_mm_per_h": 20.0, "platform.length_m": 10.0, "tracing.paths_per_pulse": 96}


@dataclass(frozen=True)
class Rain:
    """Rain as a survey found it, and the detector of that survey."""

    detector: Detector
    end: VolumeEnd

    @property
    def mean(self) -> np.ndarray:
        return self.end.volume.background

    def found(self, power: np.ndarray, false_alarm: float, looks: int = 1) -> EchoSpans:
        cfar = replace(self.detector.cfar, kind="CA", false_alarm_probability=false_alarm, looks=looks)
        ratio = self.end.over_volume(power, np.ones(len(power)))
        return spans_in_front(
            replace(self.detector, cfar=cfar, merge_gap_m=0.0),
            np.pad(power, ((0, 0), (0, len(self.detector.analyser.range_m) - power.shape[1]))),
            np.pad(self.mean, (0, len(self.detector.analyser.range_m) - len(self.mean)), mode="edge")[None]
            + np.zeros((len(power), 1)),
            self.end.goes_on(ratio, np.ones(len(power))),
            np.full(ratio.shape, 3.0),
            np.full(len(power), self.detector.min_range_m),
        )


@cache
def rain() -> Rain:
    sensor = Radar(prepare(load_scenario("hills", RAIN | PLAIN)).sensor_inputs())
    through = sensor.sweeps.through[0]
    assert through is not None
    return Rain(through.detector, through.end)


@pytest.mark.parametrize("looks", [1, 4])
def test_rain_alone_exceeds_the_threshold_as_often_as_stated(looks: int) -> None:
    """Exponential powers, or means of four, in 3,000 pulses of rain that does not end: within four sigma."""
    rng = np.random.default_rng(3)
    mean, probability, pulses = rain().mean, 1e-3, 3000
    power = mean * rng.gamma(looks, 1 / looks, (pulses, len(mean)))
    found = rain().found(power, probability, looks)
    cells = np.arange(len(mean))
    # Rain that is well above the noise behind a cell shows that it goes on.
    shown = (cells >= rain().end.first) & (mean > 4 * rain().end.volume.noise)
    shown &= np.append(shown[40:], np.zeros(40, dtype=bool))
    expected = probability * pulses * np.count_nonzero(shown)
    assert expected > 100
    passed = sum(int(np.count_nonzero(shown[a:b])) for a, b in zip(found.start, found.stop, strict=True))
    assert passed == pytest.approx(expected, abs=4 * np.sqrt(expected))


@pytest.mark.parametrize(("swerling", "ratio_db"), [(0, 10.0), (0, 12.0), (0, 14.0), (2, 12.0), (2, 18.0), (2, 24.0)])
def test_pd_in_rain_is_that_of_the_closed_form(swerling: int, ratio_db: float) -> None:
    """A steady target by the non-central chi-squared tail, a fluctuating one by the exponential: within four sigma."""
    rng = np.random.default_rng(4)
    mean, pulses, cell, probability = rain().mean, 4000, 60, 1e-6
    drawn = rng.normal(size=(2, pulses, len(mean))) * np.sqrt(mean / 2)
    amplitude = np.sqrt(mean[cell] * 10 ** (ratio_db / 10))
    if swerling:
        drawn[:, :, cell] += amplitude * rng.normal(size=(2, pulses)) / np.sqrt(2)
    else:
        drawn[0, :, cell] += amplitude
    found = rain().found((drawn**2).sum(axis=0), probability)
    heard = np.unique(found.row[found.peak == cell])
    threshold, ratio = -np.log(probability), 10 ** (ratio_db / 10)
    expected = np.exp(-threshold / (1 + ratio)) if swerling else ncx2.sf(2 * threshold, 2, 2 * ratio)
    assert 0.05 < expected < 0.999
    assert len(heard) / pulses == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / pulses))


def test_ground_that_ends_the_rain_is_not_in_front() -> None:
    """However strong, with silence behind; the same echo with rain behind is."""
    rng = np.random.default_rng(5)
    mean, pulses, cell = rain().mean, 2000, 60
    power = mean * rng.exponential(size=(pulses, len(mean)))
    power[:, cell] = 1000.0 * mean[cell]
    assert len(np.unique(rain().found(power, 1e-6).row)) == pulses
    power[:, cell + 1 :] = rain().end.volume.noise * rng.exponential(size=(pulses, len(mean) - cell - 1))
    assert not np.any(rain().found(power, 1e-6).peak == cell)


def test_echoes_in_front_leave_the_mean_behind_and_are_sorted() -> None:
    """The mean stands in place of a span and of the window's lobe around it; echoes of a pulse go by range."""
    rng = np.random.default_rng(6)
    mean, pulse = rain().mean, np.array([4, 7, 9])
    power = mean * rng.exponential(size=(3, len(mean)))
    power[:, 50] = 100.0 * mean[50]
    power[:2, 60] = 20.0 * mean[60]
    spans = rain().found(power, 1e-6)
    ratio = without_spans(power / mean, spans, rain().detector)
    assert np.all(ratio[:2, [50, 60]] == 1.0)
    np.testing.assert_array_equal(ratio[:, 65:], (power / mean)[:, 65:])
    # The second pulse has none of the ground, and in the last that is more than the dynamic range stronger.
    far_m = 120.0
    ground = Echoes(
        pulse=pulse[[0, 2]],
        number=np.zeros(2, dtype=np.int64),
        range_m=np.full(2, far_m),
        range_sigma_m=np.full(2, 0.1),
        power=mean[50] * np.array([1.0, 1e5]),
        echo_snr_db=np.full(2, 20.0),
        direction=np.tile([1.0, 0.0, 0.0], (2, 1)),
        reach=np.zeros(2),
    )
    both = with_echoes_in_front(ground, spans, rain().detector, pulse)
    np.testing.assert_array_equal(both.pulse, [4, 4, 4, 7, 7, 9])
    np.testing.assert_array_equal(both.number, [0, 1, 2, 0, 1, 0])
    near_m, middle_m = np.array([50, 60]) * rain().detector.analyser.bin_m
    np.testing.assert_allclose(both.range_m, [near_m, middle_m, far_m, near_m, middle_m, far_m], atol=0.01)
    np.testing.assert_allclose(both.echo_snr_db[:2], 10 * np.log10([100.0, 20.0]), atol=0.01)


def test_the_quantile_of_speckle_is_that_of_its_mean_power() -> None:
    """Exponential of one look, and the incomplete gamma function of several."""
    assert speckle_quantile(1e-6) == -np.log(1e-6)
    assert speckle_quantile(1e-4, 8) == pytest.approx(gammainccinv(8, 1e-4) / 8)
    drawn = np.random.default_rng(7).gamma(8, 1 / 8, 400_000)
    assert np.mean(drawn > speckle_quantile(1e-3, 8)) == pytest.approx(1e-3, abs=4 * np.sqrt(1e-3 / 400_000))


@pytest.mark.parametrize("keys", [{}, {"chirp_rate_hz": 100.0, "scan.rotation_rpm": 30.0}])
def test_simulated_rain_makes_no_more_false_echoes_than_stated(keys: dict[str, object]) -> None:
    """Well above the ground, in sweeps of 2.8 ms, and of 10 ms, in which 1 m/s moves an echo by five cells."""
    probability = 1e-3
    flight = {
        "weather.rain_rate_mm_per_h": 10.0,
        "platform.length_m": 30.0 if keys else 10.0,
        "processing.cfar.false_alarm_probability": probability,
        "processing.echoes": "all",
        "processing.obstacles.report": True,
    }
    scenario = load_scenario("rain", flight | {f"radar.{key}": value for key, value in keys.items()})
    ready, above_m = prepare(scenario), 16.0
    found = np.count_nonzero(run(scenario).points.position_m[:, 2] > above_m)
    pose = ready.flight.pulses(np.arange(len(ready))).true
    longest_m = (pose.position_m[:, 2] - above_m) / -pose.boresight[:, 2]
    cells = np.sum(longest_m / ready.receiver.chirp.range_resolution_m)
    # Cells next to the radar are not searched, so that this is the most that is stated.
    assert 0.3 * probability * cells < found < probability * cells + 3 * np.sqrt(probability * cells)
