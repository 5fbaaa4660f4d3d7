"""Fitted and tabulated backscatter: the form, interpolation, ends and bad files."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sionna_radar.foundation.errors import InputFileError
from sionna_radar.surfaces.backscatter import TableBackscatter, UlabyDobsonBackscatter

# Grass, C band, HH, from a public Julia transcription of the handbook: here to test the form only.
GRASS = {
    "p1": -15.75,
    "p2": 17.931,
    "p3": 2.369,
    "p4": -1.502,
    "p5": 4.592,
    "p6": -3.142,
    "min_incidence_rad": 0.0,
    "max_incidence_rad": math.radians(80.0),
    "source": "Ulaby and Dobson 1989, grass, C band, HH",
}


def test_the_handbook_form_by_hand():
    model = UlabyDobsonBackscatter(**GRASS)
    # Nadir: -15.75 + 17.931 + 1.502 = 3.683 dB. 0.5 rad: 17.931 e^-1.1845 = 5.4850, cos(-0.846) = 0.6629.
    level_db = 10.0 * np.log10(model.sigma0(np.array([0.0, 0.5])))
    np.testing.assert_allclose(level_db, [3.683, -15.75 + 5.4850 - 1.502 * 0.6629], atol=2e-3)


def test_the_handbook_form_holds_its_ends_and_ends_at_grazing():
    model = UlabyDobsonBackscatter(**GRASS)
    last, beyond, back = model.sigma0(np.radians([80.0, 85.0, 95.0]))
    assert beyond == last
    assert back == 0.0


def write(tmp_path, text):
    path = tmp_path / "sigma0.csv"
    path.write_text(text)
    return path


def test_a_table_is_met_at_its_rows_and_monotone_between(tmp_path):
    path = write(tmp_path, "# field campaign\nincidence_deg,sigma0_db\n0,5\n10,-8\n\n40, -18\n70,-24\n")
    table = TableBackscatter.from_csv(path)
    rows = 10.0 * np.log10(table.sigma0(np.radians([0.0, 10.0, 40.0, 70.0])))
    np.testing.assert_allclose(rows, [5.0, -8.0, -18.0, -24.0])
    assert np.all(np.diff(table.sigma0(np.radians(np.linspace(0.0, 70.0, 500)))) < 0.0)


def test_a_table_holds_its_ends():
    table = TableBackscatter(incidence_rad=(0.2, 1.0), sigma0_db=(0.0, -10.0))
    angles = np.array([0.0, 0.2, -0.2, 1.0, 1.5, 1.6])
    np.testing.assert_allclose(table.sigma0(angles), [1.0, 1.0, 1.0, 0.1, 0.1, 0.0])


@given(
    levels=st.lists(st.floats(-60.0, 20.0), min_size=2, max_size=8),
    angle=st.floats(0.0, 1.5),
)
def test_a_table_never_overshoots(levels, angle):
    angles = tuple(np.linspace(0.0, 1.5, len(levels)).tolist())
    table = TableBackscatter(incidence_rad=angles, sigma0_db=tuple(levels))
    level_db = 10.0 * math.log10(table.sigma0(np.array([angle]))[0])
    assert min(levels) - 1e-8 <= level_db <= max(levels) + 1e-8


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "line 1 reads ''"),
        ("# only a comment\n", "line 1 reads ''"),
        ("angle,sigma\n0,1\n10,2\n", "line 1 reads 'angle,sigma', and is not a header of column names"),
        ("incidence_deg,sigma0_db\n0,1\n", r"holds 1 row"),
        ("incidence_deg,sigma0_db\n0,1\n10,minus\n", "line 3 reads '10,minus'"),
        ("incidence_deg,sigma0_db\n0,1,2\n10,3\n", "line 2 reads '0,1,2'"),
        ("incidence_deg,sigma0_db\n0,1\n0,2\n", "line 3: incidence_deg = 0 must increase"),
        ("incidence_deg,sigma0_db\n0,1\n95,2\n", "line 3: incidence_deg = 95 must increase within 0 to 90"),
        ("incidence_deg,sigma0_db\n0,1\n# note\n20,nan\n", "line 4 reads '20,nan'; give finite numbers"),
    ],
)
def test_bad_files_name_the_line_and_the_remedy(tmp_path, text, words):
    with pytest.raises(InputFileError, match=words):
        TableBackscatter.from_csv(write(tmp_path, text))


def test_a_missing_and_a_binary_file(tmp_path):
    with pytest.raises(InputFileError, match="does not exist; give a CSV file"):
        TableBackscatter.from_csv(tmp_path / "absent.csv")
    binary = tmp_path / "binary.csv"
    binary.write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(InputFileError, match="not text"):
        TableBackscatter.from_csv(binary)


@pytest.mark.parametrize(
    ("angles", "levels", "words"),
    [
        ((0.0, 1.0), (1.0,), "pair up"),
        ((0.0,), (1.0,), "two rows"),
        ((1.0, 0.5), (1.0, 2.0), "increase strictly"),
        ((0.0, 2.0), (1.0, 2.0), "within 0 to pi/2"),
        ((0.0, 1.0), (1.0, math.inf), "finite"),
    ],
)
def test_impossible_tables_are_refused(angles, levels, words):
    with pytest.raises(ValueError, match=words):
        TableBackscatter(incidence_rad=angles, sigma0_db=levels)
