"""Pattern files: the antenna that was written comes back, in every format, the right way up."""

import numpy as np
import pytest

from beams import make_antenna
from pattern_files import WRITERS, csv_grid, sphere
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.radar.antenna import antenna_of
from sionna_radar.radar.array_antenna import beams_of, read_elements
from sionna_radar.radar.build import array_antenna, build_antenna
from sionna_radar.radar.pattern import SphericalPattern, directions_of
from sionna_radar.readers.antennas.reader import read_pattern
from sionna_radar.scenario import load_scenario
from sionna_radar.scenario.radar import ArrayAntennaTable, ElectronicScanTable, PatternAntennaTable, RadarTable


@pytest.fixture(scope="module")
def lopsided():
    """A beam of 12 by 20 deg with shoulders to the left (-8 dB) and upward (-5 dB): no two sides are alike."""
    own = make_antenna(12.0, 20.0)

    def amplitude(direction):
        left = directions_of(np.array([np.deg2rad(20.0)]), np.zeros(1))[0]
        up = directions_of(np.zeros(1), np.array([np.deg2rad(30.0)]))[0]
        shoulders = 0.16 * np.exp(60 * (direction @ left - 1)) + 0.32 * np.exp(60 * (direction @ up - 1))
        return np.sqrt(own.gain(direction) / own.peak_gain + shoulders + 1e-7)

    return antenna_of(SphericalPattern.of(amplitude, np.deg2rad(0.5)))


@pytest.mark.parametrize("kind", WRITERS)
def test_what_was_written_comes_back(kind, lopsided, tmp_path):
    name, write = WRITERS[kind]
    pattern = read_pattern(write(lopsided, tmp_path / name), "radar.antenna.pattern")
    copy = antenna_of(pattern)
    for along in (0, 1):  # both cuts, which the files of cuts have too
        angles = np.zeros((2, 121))
        angles[along] = np.deg2rad(np.linspace(-60, 60, 121))
        away = directions_of(*angles)
        relative, expected = copy.gain(away) / copy.peak_gain, lopsided.gain(away) / lopsided.peak_gain
        np.testing.assert_allclose(relative, expected, atol=0.01)
    if "cuts" not in kind and "MSI" not in kind:
        assert copy.peak_gain == pytest.approx(lopsided.peak_gain, rel=0.01)
        away = directions_of(*np.random.default_rng(1).uniform(-1.2, 1.2, size=(2, 500)))
        np.testing.assert_allclose(copy.gain(away), lopsided.gain(away), atol=0.01 * lopsided.peak_gain)


@pytest.mark.parametrize(
    ("total", "of_gain"),
    [
        ("Abs(E   )[V/m   ]", lambda g: 10 ** (g / 20)),
        ("Abs(H   )[A/m   ]", lambda g: 10 ** (g / 20)),
        ("Abs(V/m   )", lambda g: 10 ** (g / 20)),
        ("Abs(E   )[dBV/m ]", lambda g: g),
        ("Abs(Gain)[      ]", lambda g: 10 ** (g / 10)),
        ("Abs(P   )[VA/m^2]", lambda g: 10 ** (g / 10)),
    ],
)
def test_a_table_of_cst_holds_what_its_total_is_said_to_be(total, of_gain, lopsided, tmp_path):
    path = tmp_path / "farfield.txt"
    rows = np.column_stack([*sphere(lopsided)[:2], of_gain(sphere(lopsided)[2]), np.zeros(len(sphere(lopsided)[0]))])
    head = f"Theta [deg.]  Phi   [deg.]  {total}   Abs(Theta)[dBi   ]"
    np.savetxt(path, rows, "%.6e", header=f"{head}\n{'-' * len(head)}", comments="")
    copy = antenna_of(read_pattern(path, "radar.antenna.pattern"))
    assert copy.peak_gain == pytest.approx(lopsided.peak_gain, rel=0.01)


def test_the_axis_of_a_file_is_stated(lopsided, tmp_path):
    path = csv_grid(lopsided, tmp_path / "x.csv", boresight="x")
    copy = antenna_of(read_pattern(path, "radar.antenna.pattern", "x"))
    away = directions_of(*np.random.default_rng(1).uniform(-1.0, 1.0, size=(2, 500)))
    np.testing.assert_allclose(copy.gain(away), lopsided.gain(away), atol=0.01 * lopsided.peak_gain)
    with pytest.raises(
        InputFileError, match=r"its boresight is .* dB below its peak; set radar.antenna.boresight = 'x'"
    ):
        read_pattern(path, "radar.antenna.pattern", "z")


def test_vertical_angles_may_count_from_the_zenith(lopsided, tmp_path):
    path = WRITERS["MSI Planet"][1](lopsided, tmp_path / "zenith.prn")
    head, tail = path.read_text(encoding="latin-1").split("VERTICAL 360\n")
    losses = [line.split()[1] for line in tail.splitlines()]
    tail = "\n".join(f"{angle} {losses[(angle - 90) % 360]}" for angle in range(360))
    path.write_text(f"{head}VERTICAL 360\n{tail}", encoding="latin-1")
    copy = antenna_of(read_pattern(path, "radar.antenna.pattern", "x"))
    away = directions_of(np.zeros(121), np.deg2rad(np.linspace(-60, 60, 121)))
    np.testing.assert_allclose(copy.gain(away) / copy.peak_gain, lopsided.gain(away) / lopsided.peak_gain, atol=0.01)
    with pytest.raises(InputFileError, match=r"set radar.antenna.boresight = 'x'"):
        read_pattern(path, "radar.antenna.pattern")


def test_a_part_of_the_sphere_is_enough(tmp_path):
    """Cuts of +-40 deg of a Gaussian beam: nothing beyond, and the directivity is that of what there is."""
    angle = np.arange(-40.0, 40.5, 0.5)
    power = -3.0 * (angle / 5.0) ** 2
    path = tmp_path / "cuts.csv"
    rows = np.column_stack([angle, power, power])
    np.savetxt(path, rows, "%.6f", ",", header="angle_deg,azimuth_db,elevation_db", comments="")
    antenna = antenna_of(read_pattern(path, "radar.antenna.pattern"))
    assert np.rad2deg(antenna.beamwidths_rad) == pytest.approx((10.0, 10.0), rel=2e-3)
    # exp(-a t^2) in both planes integrates to pi / a; 0.3 dB per square degree times 0.1 ln 10.
    a = 3.0 / 5.0**2 * 0.1 * np.log(10) * np.rad2deg(1.0) ** 2
    assert antenna.peak_gain == pytest.approx(4 * a, rel=0.01)
    assert antenna.gain(directions_of(np.array([np.deg2rad(60.0)]), np.zeros(1)))[0] == 0.0


@pytest.mark.parametrize(("low", "high"), [(-50.0, 50.0), (10.0, 370.0)], ids=["a sector", "all around"])
def test_phis_may_begin_anywhere(low, high, lopsided, tmp_path, caplog):
    """The pattern goes on through the first one, wherever that is, and is zero where none was measured."""
    theta, phi, power = sphere(lopsided, boresight="x", step_deg=2.5)
    phi = low + (phi - low) % 360
    rows = np.column_stack([theta, phi, power])[phi < high + 0.1]
    path = tmp_path / "grid.csv"
    np.savetxt(path, rows, "%.5f", ",", header="theta_deg,phi_deg,gain_db", comments="")
    copy = antenna_of(read_pattern(path, "radar.antenna.pattern", "x"))
    assert ("covers 50 deg around boresight" in caplog.text) == (high < 180)
    azimuth = np.deg2rad([-3.0, 0.0, 4.0, 20.0, 49.0, 90.0, 180.0])
    found, expected = (each.gain(directions_of(azimuth, np.zeros(7))) for each in (copy, lopsided))
    np.testing.assert_allclose(found / found.max(), expected / expected.max(), atol=0.01)
    assert ((found == 0) == (np.abs(np.rad2deg(azimuth)) > high)).all()


def test_antennas_of_a_scenario(lopsided, tmp_path):
    name, write = WRITERS["CSV of cuts"]
    path = write(lopsided, tmp_path / name)
    other = csv_grid(make_antenna(20.0, 20.0), tmp_path / "heard.csv")
    table = RadarTable(snr_db=30.0, antenna={"pattern": path, "receive_pattern": other, "efficiency_db": -1.0}).antenna
    assert isinstance(table, PatternAntennaTable)
    antenna = build_antenna(table)
    sent, heard = antenna_of(read_pattern(path, "k")), antenna_of(read_pattern(other, "k"))
    efficiency = 10**-0.1
    assert antenna.peak_gain == pytest.approx(efficiency * np.sqrt(sent.peak_gain * heard.peak_gain), rel=0.01)
    assert isinstance(RadarTable(snr_db=30.0, antenna={"elements": [8, 8]}).antenna, ArrayAntennaTable)


def test_elements_of_a_file_make_the_same_array(tmp_path):
    left, up = np.meshgrid((np.arange(12) - 5.5) * 0.6, (np.arange(8) - 3.5) * 0.5, indexing="ij")
    path = tmp_path / "elements.csv"
    np.savetxt(
        path,
        np.column_stack([left.ravel(), up.ravel()]),
        "%.6f",
        ",",
        header="left_wavelengths,up_wavelengths",
        comments="",
    )
    place, weight = read_elements(path)
    assert len(place) == 96
    np.testing.assert_array_equal(weight, 1.0)
    listed = array_antenna(ArrayAntennaTable(path=path))
    formula = array_antenna(ArrayAntennaTable(elements=(12, 8), spacing_wavelengths=(0.6, 0.5)))
    assert listed.peak_gain == pytest.approx(formula.peak_gain, rel=1e-6)
    path.write_text("left_wavelengths,up_wavelengths\n0,zero\n", encoding="utf-8")
    with pytest.raises(InputFileError, match="line 2 reads '0,zero'"):
        read_elements(path)


def test_only_an_array_is_steered():
    from sionna_radar.flight.build import build_scan

    scan = build_scan(ElectronicScanTable(beams=5, half_swath_deg=30.0))
    with pytest.raises(ScenarioError, match=r"radar.scan.mode: 'electronic' needs an array"):
        beams_of(make_antenna(2.0, 2.0), scan)
    with pytest.raises(ScenarioError, match=r"radar.antenna.steer_deg"):
        beams_of(array_antenna(ArrayAntennaTable(elements=(8, 8), steer_deg=(10.0, 0.0))), scan)
    beams = beams_of(array_antenna(ArrayAntennaTable(elements=(8, 8))), scan)
    assert [b.transmit.azimuth_rad for b in beams] == pytest.approx(np.arcsin(np.linspace(0.5, -0.5, 5)))


BAD = {
    "empty": ("", "unknown pattern format; its first line is ''"),
    "words": ("hello, world\n" * 9, "its first line is 'hello, world'; give a CSV of cuts"),
    "no rows": (
        "angle_deg,azimuth_db,elevation_db\n",
        "nothing follows line 1; expected rows of 3 numbers .angle_deg, azimuth_db",
    ),
    "letters": (
        "angle_deg,azimuth_db,elevation_db\n0,1,2\n1,x,2\n",
        "line 3 holds '1, x, 2'; expected 3 numbers .angle_deg",
    ),
    "short row": ("theta_deg,phi_deg,gain_db\n0,0\n", "line 2 holds '0, 0'; expected 3 numbers .theta_deg"),
    "falling": (
        "angle_deg,azimuth_db,elevation_db\n2,0,0\n\n1,0,0\n0,0,0\n",
        "line 4 has angle_deg = 1 after 2; it must increase",
    ),
    "holes": ("theta_deg,phi_deg,gain_db\n10,0,0\n20,90,0\n30,180,1\n", "are missing"),
    "radians": ("theta_deg,phi_deg,gain_db\n500,0,0\n20,90,0\n", "theta beyond 180"),
    "two quantities": ('"Theta [deg]","Phi [deg]","dB(GainX)","dB(GainY)"\n0,0,1,2\n', "several columns"),
    "two frequencies": (
        "\"Theta [deg]\",\"dB(G) Freq='1GHz' Phi='0deg'\",\"dB(G) Freq='2GHz' Phi='0deg'\"\n0,1,2\n",
        "frequen",
    ),
    "short section": (
        "NAME x\nHORIZONTAL 360\n0 0\nVERTICAL 360\n0 0\n",
        "line 4 holds 'VERTICAL 360'; expected an angle and a loss",
    ),
    "huge section": (
        "NAME x\nHORIZONTAL 99999999999\n0 0\nVERTICAL 360\n0 0\n",
        "line 2 holds 'HORIZONTAL 99999999999'; expected HORIZONTAL and how many rows follow",
    ),
    "huge field": ("0 180 99999\n0 360 99999\n1 2 3 4\n", "lines 1 and 2 announce .* directions, more than"),
    "truncated field": ("0 180 19\n0 360 37\n1 2 3 4\n", "lines 1 and 2 announce 703 directions, and 1 rows follow"),
    "few angles": ("angle_deg,azimuth_db,elevation_db\n0,0,0\n1,0,0\n", "lines 2 to 3 are 2 angles; give three"),
    "far angle": ("angle_deg,azimuth_db,elevation_db\n0,0,0\n1,0,0\n270,0,0\n", "line 4 has angle_deg = 270; give"),
    "ended section": ("HORIZONTAL 3\n0 0\n1 0\n2 0\nVERTICAL 3\n0 0\n", "line 5 announces 3 rows .* ends after 1"),
    "broken field": ("0 90 2\n0 90 2\nFrequencies 1\nFrequency 1e9\n1 2 3 4\n1 2 x 4\n", "line 6 holds '1 2 x 4'"),
    "broken table": (
        "Theta [deg.]  Phi [deg.]  Abs(Gain)[      ]\n---\n0 0 0\n0 90\n",
        "line 4 holds '0 90'; expected 3",
    ),
    "broken source": (
        "// CST Farfield Source File\n// >> Phi, Theta, Re(E_Theta), Im(E_Theta), ...\n0 0 1 0 0 0\n0 5 1\n",
        "line 4 holds '0 5 1'; expected 6 numbers .phi, theta",
    ),
    "frequencies": ("// CST Farfield Source File\n// #Frequencies\n3\n", "holds 3 frequencies"),
    "no fields": ("// CST Farfield Source File\n", "expected a line .* over the table of fields"),
    "zeros": ("Theta [deg.]  Phi [deg.]  Abs(Gain)[      ]\n---\n0 0 0\n0 90 0\n90 0 0\n90 90 0\n", "all zero"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_one_clear_error(case, tmp_path):
    text, said = BAD[case]
    path = tmp_path / "bad.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputFileError, match=said) as caught:
        read_pattern(path, "radar.antenna.pattern")
    assert str(caught.value).startswith(f"radar.antenna.pattern = {path}")


def test_a_pattern_s_path_is_relative_to_its_scenario(tmp_path):
    (tmp_path / "a.toml").write_text(
        '[terrain]\nkind="flat"\n[platform]\naltitude_m=50\nspeed_mps=5\n[radar]\nsnr_db=30\nantenna.pattern="a.csv"\n',
        encoding="utf-8",
    )
    (tmp_path / "a.csv").write_text("", encoding="utf-8")
    assert load_scenario(tmp_path / "a.toml").radar.antenna.pattern == tmp_path / "a.csv"


def test_a_scene_s_own_antenna_gives_way_to_the_one_that_a_key_means(lopsided, tmp_path):
    name, write = WRITERS["CSV of cuts"]
    path = write(lopsided, tmp_path / name)
    assert load_scenario("hills", {"radar.antenna.pattern": str(path)}).radar.antenna.kind == "pattern"
    array = {"radar.antenna.elements": [16, 16], "radar.scan.mode": "electronic", "radar.scan.scans_per_s": 8.0}
    assert load_scenario("hills", array).radar.antenna.kind == "array"
    with pytest.raises(ScenarioError, match=r"radar.antenna.beamwidth_deg: .* It belongs to kind = 'taylor'"):
        load_scenario("hills", {"radar.antenna": {"pattern": str(path), "beamwidth_deg": 2.0}})


def test_more_beams_than_chirps_are_refused():
    scan = {"mode": "electronic", "beams": 41, "scans_per_s": 10.0}
    with pytest.raises(ScenarioError, match=r"scan.scans_per_s: 41 beams 10 times a second .* lower it to 8.78"):
        RadarTable(snr_db=30.0, scan=scan)


def test_a_file_in_radians_or_of_absurd_levels_is_said(tmp_path, caplog):
    angle = np.linspace(-np.pi, np.pi, 301)
    rows = np.column_stack([angle, -12 * angle**2, -12 * angle**2])
    path = tmp_path / "radians.csv"
    np.savetxt(path, rows, "%.6f", ",", header="angle_deg,azimuth_db,elevation_db", comments="")
    with caplog.at_level("WARNING", "sionna_radar"):
        read_pattern(path, "radar.antenna.pattern")
    assert "covers 3.14 deg around boresight" in caplog.text
    path.write_text("theta_deg,phi_deg,gain_db\n0,0,1e6\n0,90,1e6\n90,0,0\n90,90,0\n", encoding="utf-8")
    with pytest.raises(InputFileError, match=r"highest level is .* dB, beyond 300"):
        read_pattern(path, "radar.antenna.pattern")


def test_two_elements_at_one_place_are_refused(tmp_path):
    path = tmp_path / "elements.csv"
    path.write_text("left_wavelengths,up_wavelengths\n0,0\n0.5,0\n0,0\n", encoding="utf-8")
    with pytest.raises(InputFileError, match="several elements at one place"):
        read_elements(path)
