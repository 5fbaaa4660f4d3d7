"""The frequency that a pattern file states, in each format that states one, and the warning about another carrier."""

import pytest

from beams import make_antenna
from pattern_files import WRITERS
from sionna_radar import load_scenario, prepare
from sionna_radar.readers.antennas.frequency import file_frequency_hz, stated_frequency_hz

CUTS = "HORIZONTAL 360\n0 0\n"
SOURCE = """// CST Farfield Source File
// Version:
3.0
// #Frequencies
1
// Position
0 0 0
// Radiated/Accepted/Stimulated Power , Frequency
4.9e-01
5.0e-01
5.0e-01
2.4125e+10

// >> Total #phi samples, total #theta samples
361 181
"""
TEXTS = {
    "MHz of a Planet file": (f"NAME X\nFREQUENCY 1800\nGAIN 17 dBi\n{CUTS}", (1.8e9, 1.8e9)),
    "with its unit": (f"FREQUENCY 24.125 GHz\n{CUTS}", (24.125e9, 24.125e9)),
    "a band": (f"FREQUENCY 1710-1880\n{CUTS}", (1.71e9, 1.88e9)),
    "a band with units": (f"frequency: 1.71 GHz - 1.88 GHz\n{CUTS}", (1.71e9, 1.88e9)),
    "a comma": (f"FREQUENCY 0,9 GHz\n{CUTS}", (0.9e9, 0.9e9)),
    "none of a Planet file": (f"NAME for any frequency 5\n{CUTS}", None),
    "a report of HFSS": ("\"Theta [deg]\",\"dB(GainTotal) [] - Freq='24.125GHz' Phi='0deg'\"\n0,1\n", (24.125e9,) * 2),
    "a report without unit": ("\"Theta [deg]\",\"dB(G) - Freq='24' Phi='0deg'\"\n0,1\n", None),
    "a field of HFSS": ("0 180 181\n0 360 361\nFrequencies 1\nFrequency 2.4125e10\n0 0 0 0\n", (24.125e9,) * 2),
    "a source of CST": (SOURCE, (24.125e9,) * 2),
    "our own cuts": ("angle_deg,azimuth_db,elevation_db\n-1,0,0\n", None),
}


@pytest.mark.parametrize("case", TEXTS)
def test_the_stated_frequency_is_found(case):
    text, frequency_hz = TEXTS[case]
    assert stated_frequency_hz(text) == pytest.approx(frequency_hz)


@pytest.mark.parametrize("kind", ["MSI Planet", "report of HFSS by phi", "field of HFSS"])
def test_another_carrier_is_warned_of_with_both(kind, tmp_path):
    name, write = WRITERS[kind]
    path = write(make_antenna(4.0, 4.0), tmp_path / name)
    assert file_frequency_hz(path) == (77e9, 77e9)
    antenna = {"radar.antenna": {"kind": "pattern", "pattern": str(path)}, "platform.length_m": 6.0}
    (only,) = prepare(load_scenario("hills", antenna | {"radar.carrier_hz": 24e9})).warnings
    assert "states 77 GHz, and radar.carrier_hz is 24 GHz" in only
    for near_hz in (77e9, 79e9):
        assert prepare(load_scenario("hills", antenna | {"radar.carrier_hz": near_hz})).warnings == ()
