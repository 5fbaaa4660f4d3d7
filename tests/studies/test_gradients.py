"""Derivatives of echoes: closed forms over a plane, difference quotients for every parameter, and what is refused."""

import numpy as np
import pytest

from sionna_radar import ScenarioError, load_scenario, prepare
from sionna_radar.radar.equation import plane_echo_contributions
from sionna_radar.studies.gradients import study as gradients
from sionna_radar.studies.gradients.study import _evaluated, _frozen, _range_cells, _state, sensitivities
from sionna_radar.surfaces.radar_material import as_radar_material
from sionna_radar.tracing.engines.beam.rays import wide_beam_rays

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


@pytest.fixture
def few_draws(monkeypatch):
    """Two sets of rays instead of eight, where no standard error is looked at: each is held against its own rays."""
    monkeypatch.setattr(gradients, "DRAWS", 2)


def prepared(scene, **changes):
    small = {"platform.length_m": 10.0, "tracing.paths_per_pulse": 32}
    small |= {"terrain.spacing_m": 2.0} if scene == "hills" and "terrain" not in changes else {}
    return prepare(load_scenario(scene, small | {k.replace("__", "."): v for k, v in changes.items()}))


SEEN = ["pose.up_m", "pose.pitch_deg", "radar.antenna.beamwidth_deg", "radar.scan.incidence_deg"]


@pytest.mark.usefixtures("few_draws")
# Walls change what is seen along which ray, and nothing of how each parameter turns it.
@pytest.mark.parametrize(("scene", "parameters"), [("hills", [*POSE, "range_bias_m", *KEYS]), ("buildings", SEEN)])
@pytest.mark.parametrize("speckle", ["expected", "fixed"])
def test_derivatives_agree_with_differences_for_every_parameter(scene, parameters, speckle):
    """To 1 % of the RMS of the difference on the same places: the call itself ends in an error otherwise."""
    found = sensitivities(
        prepared(scene),
        PULSES,
        of=["echo_power", "mean_range", "profile"],
        to=parameters,
        speckle=speckle,
    )
    assert max(found.deviations.values()) < 0.01
    for name in SEEN:
        for quantity in ("echo_power", "mean_range", "profile"):
            assert np.any(found[quantity, name])


@pytest.mark.usefixtures("few_draws")
def test_closed_forms_over_a_plane():
    """A narrow beam at the incidence t from the height h: r = h / cos t, P ~ gamma h^-2 for constant gamma."""
    ready = prepared(
        "hills", terrain={"kind": "flat"}, radar__antenna__beamwidth_deg=1.0, materials__ground__gamma_db=-20
    )
    names = ["pose.up_m", "range_bias_m", "materials.ground.gamma_db"]
    found = sensitivities(ready, PULSES, of=["echo_power", "mean_range"], to=names)
    power, range_m = found.values["echo_power"], found.values["mean_range"]
    np.testing.assert_allclose(found["echo_power", "materials.ground.gamma_db"], power * np.log(10) / 10, rtol=1e-4)
    np.testing.assert_allclose(found["echo_power", "pose.up_m"], -2 * power / 50.0, rtol=0.02)
    np.testing.assert_allclose(found["mean_range", "pose.up_m"], range_m / 50.0, rtol=1e-3)
    np.testing.assert_allclose(found["mean_range", "range_bias_m"], 1.0, rtol=1e-4)
    assert np.all(found["echo_power", "range_bias_m"] == 0)


@pytest.mark.usefixtures("few_draws")
def test_the_taper_of_an_array_changes_what_its_pattern_does():
    """A pattern that is no product of cuts: agreement with differences of the same rays is the call's own test."""
    found = sensitivities(
        prepared("hills", radar__antenna=ARRAY), PULSES, of=["echo_power"], to=["radar.antenna.taper_db"]
    )
    # 3 dB lower side lobes widen the beam: two-way power falls by less than the square of a percent of gain per dB.
    share = found["echo_power", "radar.antenna.taper_db"] / found.values["echo_power"]
    assert (np.abs(share) > 1e-3).all()
    assert (np.abs(share) < 0.05).all()


@pytest.mark.usefixtures("few_draws")
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


@pytest.mark.usefixtures("few_draws")
def test_what_walls_hide_is_told():
    """Rays of one tracing cannot pass the edge of a roof; over hills nothing hides behind another."""
    left = []
    for scene in ("hills", "buildings"):
        ready = prepared(scene, tracing__paths_per_pulse=256, platform__length_m=60.0)
        index = np.arange(0, len(ready), 16)
        found = sensitivities(ready, index, of=["mean_range"], to=["pose.roll_deg"], retraced=True)
        left.append(found.left_out["mean_range", "pose.roll_deg"])
    assert left[0] < 0.01
    assert left[1] > 0.1


@pytest.mark.usefixtures("few_draws")
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


def plane_derivatives(beamwidth_deg, tilt_rad, height_m):
    """Return those of the log of power and of the mean range by the beamwidth, from the integral over a plane."""
    ends = []
    for width_deg in (beamwidth_deg - 0.01, beamwidth_deg + 0.01):
        ready = fixed_beam(width_deg)
        ground = as_radar_material(ready.world.scene.materials[ready.world.scene.ground_material]).co_polar
        echo = plane_echo_contributions(ready.instrument.antenna, ground, 0.0039, height_m, tilt_rad)
        ends.append((np.log(echo.power.sum()), np.sum(echo.power * echo.range_m) / echo.power.sum()))
    return np.diff(ends, axis=0)[0] / 0.02


def fixed_beam(beamwidth_deg, **changes):
    fixed = {
        "tracing__paths_per_pulse": 256,
        "terrain": {"kind": "flat", "size_m": [300.0, 300.0]},
        "radar__scan": {"mode": "fixed", "incidence_deg": 33},
    }
    return prepared("hills", radar__antenna={"beamwidth_deg": beamwidth_deg}, **fixed, **changes)


@pytest.mark.parametrize("beamwidth_deg", [1.3, 5.0])
def test_derivatives_by_the_beamwidth_scatter_about_those_of_the_integral_as_stated(beamwidth_deg):
    """Over level ground, where each pulse is another draw of rays; rays without their opposites scatter more."""
    ready = fixed_beam(beamwidth_deg)
    found = sensitivities(ready, PULSES, of=["echo_power", "mean_range"], to=["radar.antenna.beamwidth_deg"])
    expected = plane_derivatives(beamwidth_deg, np.deg2rad(33.0), 50.0)
    for quantity, truth in zip(("echo_power", "mean_range"), expected, strict=True):
        scale = found.values[quantity] if quantity == "echo_power" else 1.0
        rate = found[quantity, "radar.antenna.beamwidth_deg"] / scale
        error = found.standard_errors[quantity, "radar.antenna.beamwidth_deg"] / scale
        # Student's t of seven degrees of freedom has a variance of 7 / 5.
        assert 0.5 < np.sqrt(np.mean(((rate - truth) / error) ** 2)) < 2.0
        assert np.mean(rate) == pytest.approx(truth, abs=4 * np.sqrt(np.mean(error**2) / len(rate)))
    alone = _frozen(
        _state(ready, PULSES), wide_beam_rays(ready.instrument.antenna), _range_cells(ready), fixed=False, draws=1
    )[0]
    low, high = (_state(fixed_beam(beamwidth_deg + step), PULSES) for step in (-0.01, 0.01))
    pulse = [
        (
            _evaluated([[one]], high, ["mean_range"])["mean_range"]
            - _evaluated([[one]], low, ["mean_range"])["mean_range"]
        )
        / 0.02
        for one in alone
    ]
    assert np.mean(pulse, axis=0).std() < pulse[0].std() / 4


def test_more_rays_state_smaller_errors_and_fixed_scatterers_none():
    errors = []
    for rays in (256, 16):
        ready = prepared("hills", tracing__paths_per_pulse=rays)
        found = sensitivities(ready, PULSES, of=["mean_range"], to=["pose.pitch_deg"])
        errors.append(np.sqrt(np.mean(found.standard_errors["mean_range", "pose.pitch_deg"] ** 2)))
    assert errors[0] < errors[1] / 4
    fixed = sensitivities(ready, PULSES, of=["mean_range"], to=["pose.pitch_deg"], speckle="fixed")
    assert not np.any(fixed.standard_errors["mean_range", "pose.pitch_deg"])
