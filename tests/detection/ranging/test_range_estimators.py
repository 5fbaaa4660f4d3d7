"""Range estimators on speckled echoes of planes: nearly unbiased, and honest about their uncertainty."""

from dataclasses import replace

import numpy as np
import pytest

from beams import make_chirp
from flights import make_pulses
from sionna_radar.detection.build import build_detector, build_range_estimator
from sionna_radar.detection.detector import Spectra
from sionna_radar.detection.ranging.estimators import EchoSpans
from sionna_radar.detection.ranging.plane_fit import beam_profile
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.array_antenna import taylor_cut
from sionna_radar.scenario.processing import ProcessingTable

CELL_M = 0.3
BORESIGHT_M = 70.7
ECHOES = 150
NAMES = ("peak", "centroid", "leading_edge", "model_fit")
ESTIMATORS = {name: build_range_estimator(ProcessingTable(ranging=name)) for name in NAMES}


def plane_echoes(beamwidth_deg: float, incidence_deg: float) -> EchoSpans:
    """Echoes of a plane by brute force over the beam, the powers of all cells exponential and independent."""
    cut = taylor_cut(np.deg2rad(beamwidth_deg), -20.0)
    beam = beam_profile(Antenna(cut, cut), np.array([1.0]))
    u, v = (axis.ravel() for axis in np.meshgrid(*[np.linspace(-1.2, 1.2, 301) * np.deg2rad(beamwidth_deg)] * 2))
    tilt = np.deg2rad(incidence_deg)
    range_m = BORESIGHT_M * np.cos(tilt) / (np.sqrt(1 - u**2 - v**2) * np.cos(tilt) - v * np.sin(tilt))
    weight = (cut.at(u) * cut.at(v)) ** 4 / range_m**2
    edges = (np.arange(401) - 0.5) * CELL_M
    mean = np.histogram(range_m, edges, weights=weight)[0]
    power = np.random.default_rng(2).exponential(size=(ECHOES, 400)) * (mean / mean.max() + 1e-6)
    strong = np.flatnonzero(mean > 1e-2 * mean.max())
    return EchoSpans(
        power=power,
        noise=np.full_like(power, 1e-6),
        row=np.arange(ECHOES),
        start=np.full(ECHOES, strong[0]),
        stop=np.full(ECHOES, strong[-1] + 1),
        peak=np.argmax(power, axis=1),
        bin_m=CELL_M,
        beam=beam,
    )


@pytest.mark.parametrize(("beamwidth_deg", "incidence_deg"), [(2.0, 45.0), (4.0, 60.0)])
def test_uncertainties_are_those_of_the_errors(beamwidth_deg, incidence_deg):
    runs = plane_echoes(beamwidth_deg, incidence_deg)
    spread = {}
    for name, estimate in ESTIMATORS.items():
        ranges = estimate(runs)
        spread[name] = np.std(ranges.range_m)
        assert 0.5 < spread[name] / np.sqrt(np.mean(ranges.sigma_m**2)) < 1.6, name
    assert spread["model_fit"] < spread["centroid"] < spread["leading_edge"] < spread["peak"]


def test_the_fit_lessens_the_beams_bias():
    runs = plane_echoes(8.0, 60.0)
    bias = {name: np.mean(ESTIMATORS[name](runs).range_m) - BORESIGHT_M for name in ("centroid", "model_fit")}
    assert abs(bias["model_fit"]) < 0.3
    assert abs(bias["model_fit"]) < abs(bias["centroid"])


def test_a_span_below_the_noise_lies_at_its_strongest_bin():
    """So may spans be that are cut about a track, behind rain."""
    runs = plane_echoes(2.0, 45.0)
    hidden = replace(runs, noise=np.full_like(runs.noise, 1.01 * runs.power.max()))
    for name, estimate in {
        **ESTIMATORS,
        "threshold": build_range_estimator(ProcessingTable(ranging="threshold")),
    }.items():
        found = estimate(hidden)
        assert found.range_m.shape == found.sigma_m.shape == (ECHOES,), name
        if name != "model_fit":
            np.testing.assert_allclose(found.range_m, runs.peak * CELL_M, atol=1.01 * CELL_M)


def test_an_echo_wider_than_the_cfar_window_is_kept_whole():
    # Two hundred raised cells: the training cells lie inside the echo, and the CFAR alone finds its rims.
    detector = build_detector(ProcessingTable(zero_padding=1, doppler_correction=False), make_chirp())
    power = np.ones((1, 512))
    power[0, 150:350] = 1e4
    noise, both = detector.cfar.noise_level(power)
    factor = np.where(both, detector.cfar.both_sides_factor, detector.cfar.one_side_factor)
    assert np.sum(power > noise * factor) < 150
    pulses = make_pulses(1)
    spectra = Spectra(power=power, noise=noise, threshold=noise * factor)
    echoes = detector.echoes(spectra, pulses.index, pulses.measured)
    assert echoes.range_m / detector.analyser.bin_m == pytest.approx([249.5], abs=0.1)
