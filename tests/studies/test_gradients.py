"""Derivatives of echoes: closed forms over a plane, difference quotients for every parameter, and what is refused."""

import numpy as np
import pytest

from sionna_radar import ScenarioError, load_scenario, prepare
from sionna_radar.studies import sensitivities

POSE = [f"pose.{name}" for name in ("east_m", "north_m", "up_m", "roll_deg", "pitch_deg", "heading_deg")]
KEYS = ["platform.altitude_m", "radar.antenna.beamwidth_deg", "radar.antenna.side_lobe_db", "radar.scan.incidence_deg"]
SURFACE = {
    "model": "integral_equation",
    "rms_height_m": 3e-4,
    "correlation_length_m": 3e-3,
    "permittivity": [6.0, 1.0],
}
ARRAY = {"kind": "array", "elements": [16, 16], "taper_db": -25.0}
PULSES = np.arange(0, 60, 6)


def prepared(scene, **changes):
    small = {"platform.length_m": 10.0, "tracing.paths_per_pulse": 128}
    return prepare(load_scenario(scene, small | {k.replace("__", "."): v for k, v in changes.items()}))


@pytest.mark.parametrize(("scene", "speckle"), [("hills", "expected"), ("buildings", "fixed")])
def test_derivatives_agree_with_differences_for_every_parameter(scene, speckle):
    """To 1 % of the RMS of the difference on the same places: the call itself ends in an error otherwise."""
    found = sensitivities(
        prepared(scene),
        PULSES,
        of=["echo_power", "mean_range", "profile"],
        to=[*POSE, "range_bias_m", *KEYS],
        speckle=speckle,
    )
    assert max(found.deviations.values()) < 0.01
    for name in ("pose.up_m", "pose.pitch_deg", "radar.antenna.beamwidth_deg", "radar.scan.incidence_deg"):
        for quantity in ("echo_power", "mean_range", "profile"):
            assert np.any(found[quantity, name])


def test_closed_forms_over_a_plane():
    """A narrow beam at the incidence t from the height h: r = h / cos t, P ~ gamma h^-2 for constant gamma."""
    ready = prepared(
        "hills", terrain={"kind": "flat"}, radar__antenna__beamwidth_deg=0.5, materials__ground__gamma_db=-20
    )
    names = ["pose.up_m", "range_bias_m", "materials.ground.gamma_db"]
    found = sensitivities(ready, PULSES, of=["echo_power", "mean_range"], to=names)
    power, range_m = found.values["echo_power"], found.values["mean_range"]
    np.testing.assert_allclose(found["echo_power", "materials.ground.gamma_db"], power * np.log(10) / 10, rtol=1e-4)
    np.testing.assert_allclose(found["echo_power", "pose.up_m"], -2 * power / 50.0, rtol=0.02)
    np.testing.assert_allclose(found["mean_range", "pose.up_m"], range_m / 50.0, rtol=1e-3)
    np.testing.assert_allclose(found["mean_range", "range_bias_m"], 1.0, rtol=1e-4)
    assert np.all(found["echo_power", "range_bias_m"] == 0)


def test_the_taper_of_an_array_changes_what_its_pattern_does():
    """A pattern that is no product of cuts: agreement with differences of the same rays is the call's own test."""
    found = sensitivities(
        prepared("hills", radar__antenna=ARRAY), PULSES, of=["echo_power"], to=["radar.antenna.taper_db"]
    )
    # 3 dB lower side lobes widen the beam: two-way power falls by less than the square of a percent of gain per dB.
    share = found["echo_power", "radar.antenna.taper_db"] / found.values["echo_power"]
    assert (np.abs(share) > 1e-3).all()
    assert (np.abs(share) < 0.05).all()


def test_parameters_of_a_rough_surface():
    ready = prepared("hills", materials__ground=SURFACE)
    names = [f"materials.ground.{name}" for name in ("rms_height_m", "correlation_length_m")]
    found = sensitivities(ready, PULSES, of=["echo_power"], to=names)
    for name in names:
        value = SURFACE[name.split(".")[-1]]
        step = 1e-2 * value
        ends = []
        for sign in (-1, 1):
            other = prepare(ready.scenario.replace({name: value + sign * step}))
            ends.append(sensitivities(other, PULSES, of=["echo_power"], to=[]).values["echo_power"])
        np.testing.assert_allclose(found["echo_power", name], (ends[1] - ends[0]) / (2 * step), rtol=0.02)


def test_what_walls_hide_is_told():
    """Rays of one tracing cannot pass the edge of a roof; over hills nothing hides behind another."""
    left = []
    for scene in ("hills", "buildings"):
        ready = prepared(scene, tracing__paths_per_pulse=2048, platform__length_m=60.0)
        index = np.arange(0, len(ready), 4)
        found = sensitivities(ready, index, of=["mean_range"], to=["pose.roll_deg"], retraced=True)
        left.append(found.left_out["mean_range", "pose.roll_deg"])
    assert left[0] < 0.01
    assert left[1] > 0.1


@pytest.mark.parametrize(
    ("scene", "changes", "name", "message"),
    [
        ("hills", {}, "terrain.height_m", "moves the ground"),
        ("hills", {}, "materials.ground.gamma_db", "not a number"),
        ("hills", {}, "radar.chirp_rate_hz", "changes when pulses are sent"),
        ("hills", {"radar__antenna": ARRAY}, "radar.antenna.spacing_wavelengths", "not smooth there"),
    ],
)
def test_what_has_no_derivative_is_refused(scene, changes, name, message):
    with pytest.raises(ScenarioError, match=message):
        sensitivities(prepared(scene, **changes), [0, 5], to=[name])
