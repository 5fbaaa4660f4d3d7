"""Surveys whose pulses are averages of chirps, and those that cannot be."""

import numpy as np
import pytest

from sionna_radar import load_scenario, run
from sionna_radar.execution.execution import Execution
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.studies.images.study import image as run_images
from sionna_radar.studies.link.study import link_budget as run_link_budget
from sionna_radar.survey.preparation import prepare

SHORT = {
    "platform.length_m": 2.5,
    "terrain.spacing_m": 2.0,
    "tracing.paths_per_pulse": 128,
    "radar.chirp_rate_hz": 1440.0,
    "processing.cfar.kind": "CA",
}
MODES = ("coherent", "incoherent")


def averaged(mode, **changes):
    keys = {"processing.average.chirps": 4, "processing.average.mode": mode}
    return load_scenario("hills", SHORT | keys | changes)


@pytest.mark.parametrize("mode", MODES)
def test_the_block_size_changes_no_pulse(mode):
    prepared = prepare(averaged(mode))
    first, second = run(prepared), run(prepared, execution=Execution(block_size=17))
    assert first.points.sha256() == second.points.sha256()
    assert len(first.points) > 0.9 * len(prepared)
    # Each lies on the ground, at the pose in the middle of its burst.
    assert first.lit_error.rms_m < 0.3


def test_the_floor_falls_by_the_chirps_of_a_coherent_mean_alone():
    """Behind all echoes: of four chirps by 6.0 dB where beats are averaged, and by none where powers are."""
    floor, scatter = {}, {}
    for mode in ("single", *MODES):
        prepared = prepare(load_scenario("hills", SHORT) if mode == "single" else averaged(mode))
        sweeps = prepared.build_sensor().sweeps
        pulses = prepared.flight.sample(25)
        beats = sweeps.cleaned(sweeps.beats(pulses), pulses)
        analyser = sweeps.detector.analyser
        power = analyser.power(beats[0])[:, analyser.range_m > 120.0]
        floor[mode], scatter[mode] = power.mean(), power.var() / power.mean() ** 2
    assert 10 * np.log10(floor["single"] / floor["coherent"]) == pytest.approx(6.02, abs=0.15)
    assert 10 * np.log10(floor["single"] / floor["incoherent"]) == pytest.approx(0.0, abs=0.15)
    assert scatter["incoherent"] == pytest.approx(1 / 4, rel=0.1)
    assert scatter["coherent"] == pytest.approx(1.0, rel=0.1)


def test_a_beam_that_turns_on_within_a_pulse_is_told():
    """720 deg/s around the vertical, at 45 deg from it, for 3 of 1440 chirps a second: 1.06 deg."""
    turned = run(averaged("coherent", **{"radar.antenna.beamwidth_deg": 2.0}))
    assert [text for text in turned.warnings if "turns by 1.06 deg within the 4 chirps" in text]
    wider = run(averaged("coherent", **{"radar.antenna.beamwidth_deg": 3.0}))
    assert not [text for text in wider.warnings if "turns by" in text]


def test_speckle_drawn_anew_steadies_ranges_by_the_square_root_of_the_looks():
    single = run(load_scenario("hills", SHORT | {"tracing.speckle": "per_pulse"}))
    steadied = run(averaged("incoherent", **{"tracing.speckle": "per_pulse"}))
    ratio = np.median(single.points.range_sigma_m) / np.median(steadied.points.range_sigma_m)
    assert ratio == pytest.approx(2.0, rel=0.2)


@pytest.mark.parametrize(
    ("mode", "changes", "message"),
    [
        (
            "coherent",
            {"tracing.speckle": "per_pulse"},
            "mode: 'coherent' is not supported with speckle drawn anew",
        ),
        ("coherent", {"radar.sweep": "triangular"}, "processing.average.chirps: 4 is not supported with pairs"),
        (
            "coherent",
            {"weather.rain_rate_mm_per_h": 5.0},
            "processing.average.chirps: 4 is not supported with rain",
        ),
        (
            "coherent",
            {"sensor": "lidar"},
            "processing.average.chirps: 4 is not supported with a sensor",
        ),
        (
            "incoherent",
            {"processing.cfar.kind": "SO"},
            "cfar.kind: 'SO' is not supported with averaged powers",
        ),
        ("incoherent", {"dem.method": "smooth"}, "dem.method: 'smooth' is not supported with averaged powers"),
        (
            "incoherent",
            {"processing.angle": "interferometric", "radar.second_receiver.axis": "both"},
            "processing.average.mode: 'incoherent' is not supported with several receivers, which need phases",
        ),
    ],
)
def test_what_cannot_be_averaged_is_refused_with_a_remedy(mode, changes, message):
    with pytest.raises(ScenarioError, match=message):
        averaged(mode, **changes)


def test_what_supports_single_chirps_only_says_so(tmp_path):
    scenario, recorded = averaged("coherent"), tmp_path / "s.nc"
    refused = {
        "a link budget supports single chirps only; set 1": lambda: run_link_budget(scenario),
        "an image supports single chirps only; set 1": lambda: run_images(scenario),
        "a recording supports single chirps only; set 1": lambda: run(scenario, recordings={"signals": recorded}),
    }
    for message, call in refused.items():
        with pytest.raises(ScenarioError, match=message):
            call()
