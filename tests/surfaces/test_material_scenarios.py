"""Materials as a scenario writes them: what is refused and how, what is warned of, what is built."""

import logging
import math
import tomllib

import numpy as np
import pytest

from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.scenario import load_scenario, parse_scenario, to_toml
from sionna_radar.scenario.shipped import shipped_scenarios
from sionna_radar.surfaces.build import build_materials
from sionna_radar.surfaces.permittivity import soil_permittivity
from sionna_radar.surfaces.rough_surface import IntegralEquationModel, SmallPerturbationModel
from sionna_radar.survey.preparation import prepare

SOIL = {
    "kind": "soil", "temperature_c": 20.0, "sand_percent": 40.0, "clay_percent": 20.0, "water_fraction": 0.2,
    "specific_gravity": 2.65,
}  # fmt: skip
ROUGH = {"rms_height_m": 2e-4, "correlation_length_m": 0.0015, "permittivity": [4.0, 0.3]}
HANDBOOK = {f"p{i}": float(i) for i in range(1, 7)} | {
    "model": "ulaby_dobson", "min_incidence_deg": 0.0, "max_incidence_deg": 80.0, "source": "a test",
}  # fmt: skip
GOOD = {
    "gamma": {"model": "constant_gamma", "gamma_db": -20.0, "cross_polar_db": -10.0},
    "mirror": {"model": "lambertian", "nadir_sigma0_db": -10.0, "specular": True, "rms_height_m": 0.0,
               "medium": {"kind": "metal"}},
    "handbook": HANDBOOK,
    "kirchhoff": {"model": "kirchhoff", "rms_height_m": 2e-3, "correlation_length_m": 0.03,
                  "medium": {"kind": "concrete"}},
    "optics": {"model": "physical_optics", **ROUGH},
    "bragg": {"model": "small_perturbation", "rms_height_m": 1e-4, "correlation_length_m": 2e-3, "medium": SOIL},
    "equation": {"model": "integral_equation", **ROUGH, "correlation": "exponential", "specular": True},
    "slab": {"model": "sionna_itu", "itu_type": "concrete", "scattering_coefficient": 0.3, "xpd_coefficient": 0.2},
}  # fmt: skip


def hills(materials, **changes):
    return load_scenario("hills", {"materials": materials, **changes})


def test_every_model_survives_a_round_trip_and_is_built():
    scenario = hills(GOOD)
    assert parse_scenario(tomllib.loads(to_toml(scenario))) == scenario
    built = build_materials(scenario.all_materials, scenario.radar)
    angle = np.deg2rad([0.0, 30.0, 60.0])
    for name in GOOD:
        assert np.all(built[name].sigma0(angle) > 0)
    assert built["equation"].mirror is not None
    assert built["optics"].mirror is None
    assert built["mirror"].mirror.amplitude == pytest.approx(-1, abs=0.01)


@pytest.mark.parametrize("name", sorted(shipped_scenarios()))
def test_no_shipped_material_returns_more_than_it_receives(name):
    scenario = load_scenario(name)
    for material in build_materials(scenario.all_materials, scenario.radar).values():
        assert material.scattered_fraction(np.deg2rad(np.arange(0.0, 81.0))).max() <= 1.0


def test_carrier_and_polarization_come_from_the_radar():
    polarized = {"radar.antenna.polarization": "H", "radar.carrier_hz": 60e9}
    scenario = hills(GOOD, **polarized)
    bragg = build_materials(scenario.all_materials, scenario.radar)["bragg"]
    soil = {key: value for key, value in SOIL.items() if key != "kind"}
    surface = bragg.horizontal.surface
    assert surface.frequency_hz == 60e9
    assert surface.permittivity == soil_permittivity(60e9, **soil)
    angle = np.deg2rad([40.0])
    np.testing.assert_array_equal(
        bragg.sigma0(angle), SmallPerturbationModel(surface=surface, polarization="H").sigma0(angle)
    )


@pytest.mark.parametrize(("sent", "channels"), [("V", ("VV", "HV")), ("H", ("HH", "VH"))])
def test_the_receiver_chooses_the_channel(sent, channels):
    angle = np.deg2rad([50.0])
    values = []
    for receives, channel in zip(("co", "cross"), channels, strict=True):
        antenna = {"radar.antenna.polarization": sent, "radar.antenna.receive_polarization": receives}
        bragg = {**GOOD["bragg"], "cross_polar_db": -13.0}
        scenario = hills({"bragg": bragg, "ground": bragg}, **antenna)
        material = build_materials(scenario.all_materials, scenario.radar)["bragg"]
        assert material.channel == channel
        values.append(material.sigma0(angle)[0])
        # The noise is set against the co-polar echo, so both channels have the same.
        values.append(prepare(scenario).receiver.noise_power_w)
    weaker = material.horizontal.sigma0(angle)[0]
    assert 10 * math.log10(values[2] / weaker) == pytest.approx(-13.0)
    assert values[1] == values[3]


@pytest.mark.parametrize(
    ("table", "key"),
    [
        ({"model": "constant_gamma"}, "gamma_db"),
        ({"model": "constant_gamma", "gamma_db": -10.0, "cross_polar_db": 3.0}, "cross_polar_db"),
        ({"model": "constant_gamma", "gamma_db": -10.0, "rms_height_m": 0.1}, "rms_height_m"),
        ({"model": "constant_gamma", "gamma_db": -10.0, "specular": True}, "permittivity"),
        ({"model": "lambertian", "nadir_sigma0_db": 0.0, "specular": True, "permittivity": [3.0, 0.1]}, "rms_height_m"),
        ({"model": "physical_optics", "rms_height_m": 1e-3, "correlation_length_m": 0.01}, "permittivity"),
        ({"model": "physical_optics", **ROUGH, "medium": SOIL}, "medium"),
        ({"model": "physical_optics", **ROUGH, "permittivity": [0.5, 0.1]}, "permittivity.0"),
        ({"model": "physical_optics", **ROUGH, "rms_height_m": 1.0}, "rms_height_m"),
        ({"model": "kirchhoff", **ROUGH, "correlation": "exponential"}, "correlation"),
        ({"model": "small_perturbation", **ROUGH, "correlation": "fractal"}, "correlation"),
        ({"model": "integral_equation", **ROUGH, "fresnel_angle": "both"}, "fresnel_angle"),
        ({**HANDBOOK, "source": " "}, "source"),
        ({**HANDBOOK, "max_incidence_deg": 0.0}, "max_incidence_deg"),
        ({k: v for k, v in HANDBOOK.items() if k != "p4"}, "p4"),
        ({"model": "bragg"}, "model"),
        ({"gamma_db": -10.0}, "model"),
        ({"model": "physical_optics", **ROUGH, "permittivity": None, "medium": {}}, "medium.kind"),
        ({"model": "sionna_itu", "itu_type": "concrete", "scattering_coefficient": 0.0}, "scattering_coefficient"),
        ({"model": "sionna_itu", "itu_type": "marble", "scattering_coefficient": 0.3}, "itu_type"),
        ({"model": "sionna_itu", "itu_type": "cheese", "scattering_coefficient": 0.3}, "itu_type"),
    ],
)
def test_what_makes_no_sense_is_refused_by_its_key(table, key):
    with pytest.raises(ScenarioError) as caught:
        prepare(hills({"odd": {key: value for key, value in table.items() if value is not None}}))
    (problem,) = caught.value.problems
    assert problem.field == f"materials.odd.{key}".rstrip(".")


@pytest.mark.parametrize(
    ("medium", "key"),
    [
        ({**SOIL, "water_fraction": 0.9}, "water_fraction"),
        ({**SOIL, "temperature_c": -5.0}, "temperature_c"),
        ({"kind": "soil"}, None),
        ({"kind": "asphalt_concrete"}, ""),
        ({"kind": "asphalt", "mix": "tar"}, "mix"),
        ({"kind": "water", "temperature_c": 90.0}, "temperature_c"),
        ({"kind": "vegetation", "temperature_c": 10.0, "water_fraction": 0.8}, "water_fraction"),
        ({"kind": "wet_snow", "temperature_c": 0.0, "dry_density_g_cm3": 2.0, "liquid_fraction": 0.1}, "density"),
    ],
)
def test_a_medium_out_of_its_range_is_refused_by_its_key(medium, key):
    rough = {"model": "physical_optics", **{k: v for k, v in ROUGH.items() if k != "permittivity"}, "medium": medium}
    with pytest.raises(ScenarioError) as caught:
        prepare(hills({"odd": rough}))
    fields = [problem.field for problem in caught.value.problems]
    assert all(field.startswith("materials.odd.medium") for field in fields)
    if key is None:
        assert "materials.odd.medium.sand_percent" in fields
    elif key != "density":
        assert fields == [f"materials.odd.medium.{key}".rstrip(".")]


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"model": "small_perturbation", **ROUGH, "rms_height_m": 1e-3}, "outside the range of small_perturbation"),
        ({"model": "kirchhoff", **ROUGH}, "outside the range of kirchhoff"),
        ({"model": "small_perturbation", **{**ROUGH, "rms_height_m": 1e-4}, "medium": SOIL, "permittivity": None},
         "extrapolates measurements made from 1.4 to 18 GHz"),
        ({"model": "constant_gamma", "gamma_db": 8.0}, "more power than it receives"),
        # A third of gamma, 100, returns at nadir.
        ({"model": "constant_gamma", "gamma_db": 20.0}, "it would scatter up to 3233 % more power than it receives"),
        ({"model": "lambertian", "nadir_sigma0_db": 6.5}, "more power than it receives"),
        ({"model": "lambertian", "nadir_sigma0_db": 5.9}, None),  # a white Lambertian surface has 6.02 dB
        ({"model": "constant_gamma", "gamma_db": -20.0}, None),
    ],
)  # fmt: skip
def test_doubts_are_logged(table, words, caplog):
    table = {key: value for key, value in table.items() if value is not None}
    scenario = hills({"odd": table})
    with caplog.at_level(logging.WARNING, logger="sionna_radar"):
        build_materials({"odd": scenario.materials["odd"]}, scenario.radar)
    if words is None:
        assert not caplog.records
    else:
        assert f"materials.odd: {words}" in caplog.text or words in caplog.text


def test_a_table_is_found_beside_the_scenario(tmp_path):
    (tmp_path / "grass.csv").write_text("incidence_deg,sigma0_db\n0,-5\n40,-12\n80,-20\n")
    toml = """
    terrain = {kind = "hills"}
    materials.ground = {model = "table", path = "grass.csv"}
    platform = {altitude_m = 50.0, speed_mps = 10.0}
    radar = {snr_db = 30.0}
    """
    (tmp_path / "own.toml").write_text(toml)
    scenario = load_scenario(tmp_path / "own.toml")
    assert scenario.materials["ground"].path == tmp_path / "grass.csv"
    built = build_materials(scenario.all_materials, scenario.radar)
    assert 10 * np.log10(built["ground"].sigma0(np.deg2rad([40.0]))[0]) == pytest.approx(-12.0)
    with pytest.raises(InputFileError, match=r"absent\.csv"):
        prepare(load_scenario(tmp_path / "own.toml", {"materials.ground.path": "absent.csv"}))


def test_sionnas_own_materials_are_kept_only_where_they_work(monkeypatch):
    kept = {"metal": "sionna", "marble": "sionna"}
    with pytest.raises(ScenarioError) as caught:
        prepare(load_scenario("munich", {"terrain.materials": kept}))
    by_field = {problem.field: problem.message for problem in caught.value.problems}
    assert "scattering coefficient of 0" in by_field["terrain.materials.metal"]
    assert "1 to 60 GHz" in by_field["terrain.materials.marble"]
    assert "map it to a material" in by_field["terrain.materials.marble"]


def test_sionnas_own_material_that_scatters_is_kept(monkeypatch):
    from sionna_radar.scene.terrains import city

    original = city.SionnaSlab
    monkeypatch.setattr(city, "SionnaSlab", lambda **k: original(**{**k, "scattering_coefficient": 0.2}))
    surfaces, materials = city.load_city("munich", {"metal": None}, 77e9, "VV")
    assert {"sionna:metal"} == set(materials) == {s.material for s in surfaces if s.material.startswith("sionna")}
    assert materials["sionna:metal"].sigma0(np.zeros(1))[0] == pytest.approx(4 * 0.2**2, rel=0.01)


def test_the_integral_equation_keeps_its_option():
    scenario = hills({"odd": {"model": "integral_equation", **ROUGH, "fresnel_angle": "nadir"}})
    model = build_materials(scenario.materials, scenario.radar)["odd"].vertical
    assert isinstance(model, IntegralEquationModel)
    assert model.fresnel_angle == "nadir"
