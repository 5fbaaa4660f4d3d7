"""Presets of published radars (`radar.preset`), with the sources and assumptions of their values."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Preset:
    """A published radar.

    summary: description. radar: keys of `[radar]`. sources: of its figures. assumed: figures without a source.
    scenario: other tables that a scenario with it begins with (`sionna-radar init`).
    """

    summary: str
    radar: Mapping[str, Any]
    sources: tuple[str, ...]
    assumed: tuple[str, ...]
    scenario: Mapping[str, Any] = field(default_factory=dict)


# Sensor of the boards with arrays, and processing of altimeters.
_MODULE: Mapping[str, Any] = {"sensor": "mimo"}
_ALTIMETER: Mapping[str, Any] = {"processing": {"ranging": "tracker"}}


def _places(left: Sequence[int], up: Sequence[int] | None = None) -> tuple[tuple[float, float], ...]:
    """Return the places of elements in wavelengths about their middle, by numbers of half wavelengths."""
    middle = (max(left) + min(left)) / 2
    return tuple((0.5 * (x - middle), 0.5 * y) for x, y in zip(left, up or (0,) * len(left), strict=True))


# What the boards of Texas Instruments' 77 GHz chips share here.
_TI_BOARD: Mapping[str, Any] = {
    "carrier_hz": 77e9,
    "bandwidth_hz": 400e6,
    "samples_per_chirp": 256,
    "sampling": "iq",
    "antenna": {"kind": "array", "elements": (1, 4), "spacing_wavelengths": (0.5, 0.45), "element_exponent": 2.4},
    "scan": {"mode": "fixed", "incidence_deg": 0.0},
}

# How a vehicle with a panoramic radar drives, and how it is traced.
_ON_WHEELS: Mapping[str, Any] = {
    "platform": {"height": "ground", "altitude_m": 2.0, "speed_mps": 5.0, "length_m": 100.0},
    "tracing": {"speckle": "per_pulse", "paths_per_pulse": 1024},
    "processing": {"echoes": "all"},
}

PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        "rouveure_2017": Preset(
            summary="the 77 GHz pencil beam of the reference paper",
            radar={
                "carrier_hz": 77e9,
                "bandwidth_hz": 500e6,
                "chirp_rate_hz": 360.0,
                "samples_per_chirp": 1024,
                "snr_db": 30.0,
                "antenna": {"kind": "taylor", "beamwidth_deg": 2.0, "side_lobe_db": -20.0},
                "scan": {"mode": "whisk_broom", "incidence_deg": 45.0, "half_swath_deg": 50.0, "rotation_rpm": 120.0},
            },
            sources=("Rouveure et al. 2017, doi 10.1016/j.robot.2017.07.002, Table 2 and Fig. 5, 12",),
            assumed=("a Taylor taper in both planes",),
        ),
        "avtis2": Preset(
            summary="AVTIS2, a 94 GHz real-aperture FMCW imager of volcanoes and glaciers, 7 km of range",
            radar={
                "carrier_hz": 94e9,
                "bandwidth_hz": 200e6,
                "chirp_rate_hz": 100.0,
                "samples_per_chirp": 32768,
                "transmit_power_dbm": 18.0,
                "noise_figure_db": 8.0,
                "antenna": {"kind": "taylor", "beamwidth_deg": 0.35, "side_lobe_db": -25.0},
                "scan": {"mode": "whisk_broom", "incidence_deg": 45.0, "half_swath_deg": 50.0, "rotation_rpm": 20.0},
            },
            sources=(
                "94 GHz, FMCW, mechanically scanned, about 7 km of range, range resolution below a metre: Macfarlane, "
                "Robertson, Middleton 2006, 'A 94 GHz real aperture 3D imaging radar', 3rd European Radar Conference",
                "in use on glaciers: Harcourt et al. 2023, Annals of Glaciology, doi 10.1017/aog.2023.30, and "
                "Geophysical Research Letters 50, e2023GL104721",
            ),
            assumed=(
                "200 MHz, for 0.75 m of range resolution",
                "the beam of 0.35 deg, its side lobes, 18 dBm and 8 dB of noise figure: not in the sources at hand",
                "sweeps of 10 ms, and a scan from the air: the original turns on a tripod",
            ),
        ),
        "pelican": Preset(
            summary="PELICAN, a 24 GHz panoramic FMCW radar of vehicles and small boats, 5 to 100 m",
            radar={
                "carrier_hz": 24.125e9,
                "bandwidth_hz": 250e6,
                "chirp_rate_hz": 400.0,
                "samples_per_chirp": 512,
                "transmit_power_dbm": 20.0,
                "noise_figure_db": 10.0,
                "antenna": {"kind": "taylor", "beamwidth_deg": (4.0, 20.0), "side_lobe_db": -20.0},
                "scan": {"mode": "panoramic", "rotation_rpm": 60.0},
            },
            scenario=_ON_WHEELS,
            sources=(
                "K band, FMCW, a planar patch array that turns at 60 rpm in the horizontal plane, 5 to 100 m of range, "
                "a beam narrow in azimuth and wide in elevation: Rouveure, Faure, Monod 2016, 'PELICAN: panoramic "
                "millimeter-wave radar for perception in mobile robotics applications, Part 1', Robotics and "
                "Autonomous Systems 81, and Rouveure et al. 2017, doi 10.1016/j.robot.2017.07.002, section 1",
            ),
            assumed=(
                "250 MHz, that of the band of 24.0 to 24.25 GHz; 400 sweeps of 512 samples a turn, for 153 m of range",
                "the beam of 4 by 20 deg with a Taylor taper, 20 dBm and 10 dB of noise figure",
            ),
        ),
        "navtech_cts350": Preset(
            summary="a 76 GHz panoramic FMCW radar of research cars and mines, 163 m, four turns a second",
            radar={
                "carrier_hz": 76.5e9,
                "bandwidth_hz": 600e6,
                "chirp_rate_hz": 1600.0,
                "samples_per_chirp": 1312,
                "transmit_power_dbm": 15.0,
                "noise_figure_db": 12.0,
                "antenna": {"kind": "taylor", "beamwidth_deg": (1.8, 10.0), "side_lobe_db": -25.0},
                "scan": {"mode": "panoramic", "rotation_rpm": 240.0},
            },
            scenario=_ON_WHEELS,
            sources=(
                "76 to 77 GHz, FMCW, 4 Hz, 400 azimuths a turn, 1.8 deg between half-power points, 163 m: Barnes et "
                "al. 2020, 'The Oxford Radar RobotCar Dataset', ICRA, of the Navtech CTS350-X",
                "15 dBm and 600 MHz, of a 77 GHz radar by the same maker: Ge, Lewis (eds.) 2006, 'Autonomous Mobile "
                "Robots', section 2.3",
            ),
            assumed=(
                "10 deg of elevation and a Taylor taper: the original's beam follows a squared cosecant below the axis",
                "12 dB of noise figure, and a sweep as long as the interval between azimuths",
            ),
        ),
        "ti_awr1843": Preset(
            summary="a 77 GHz single-chip module of Texas Instruments on its evaluation board, one transmitter",
            radar={
                "carrier_hz": 77e9,
                "bandwidth_hz": 300e6,
                "chirp_rate_hz": 1000.0,
                "samples_per_chirp": 512,
                "sampling": "iq",
                "transmit_power_dbm": 12.0,
                "noise_figure_db": 15.0,
                "antenna": {"kind": "taylor", "beamwidth_deg": (56.0, 28.0), "side_lobe_db": -20.0},
                "scan": {"mode": "whisk_broom", "incidence_deg": 20.0, "half_swath_deg": 30.0, "rotation_rpm": 60.0},
            },
            sources=(
                "12 dBm, noise figure 14 dB at 76 to 77 GHz and 15 dB at 77 to 81 GHz, complex sampling: AWR1843 "
                "data sheet, SWRS222",
                "half-power beam of +-28 by +-14 deg: xWR1843 evaluation module user's guide, SPRUIM4",
            ),
            assumed=(
                "300 MHz in 512 samples, for 256 m of range: the chip sweeps up to 4 GHz, for centimetres over metres",
                "no gain from averaging the chirps of a frame",
                "the receiver's antenna equal to the transmitter's, and a Taylor taper",
                "a scan from the air: the board itself has none, and a fixed beam maps no more than a line",
            ),
        ),
        "ti_awr1843_array": Preset(
            summary="the same board with all 3 transmitters and 4 receivers, looking down: sensor = 'mimo'",
            radar={
                **_TI_BOARD,
                "chirp_rate_hz": 16e3,
                "transmit_power_dbm": 12.0,
                "noise_figure_db": 15.0,
                "array": {
                    "transmitters_wavelengths": _places((0, 2, 4), (0, 1, 0)),
                    "receivers_wavelengths": _places((0, 1, 2, 3)),
                    "multiplexing": "tdm",
                },
            },
            scenario=_MODULE,
            sources=(
                "12 dBm, noise figure 14 dB at 76 to 77 GHz and 15 dB at 77 to 81 GHz, complex sampling: AWR1843 "
                "data sheet, SWRS222",
                "transmitters a wavelength apart, the middle one raised by half a wavelength, receivers half a "
                "wavelength apart: xWR1843 evaluation module user's guide, SPRUIM4, as public repositories quote it",
                "a two-way pattern of -2 to -4 dB at 30 deg in azimuth and -12 to -16 dB at 60 deg, and half-power at "
                "+-14 deg in elevation: SPRUIM4; the cosine to the power of 2.4 has -3.0 and -14.4 dB",
            ),
            assumed=(
                "400 MHz in 256 samples, 16,000 chirps a second: 96 m of range, 5.2 m/s of range rate",
                "four patches along the track, 0.45 of a wavelength apart, which have that half-power width; without "
                "loss 12.3 dBi; public repositories quote more than 10.5 dBi from the guide, and one takes 7",
                "the board's left along the platform's left, and half a wavelength at the carrier",
            ),
        ),
        "ti_awr2243_cascade": Preset(
            summary="a cascade of four 77 GHz chips, 12 transmitters and 16 receivers, looking down: sensor = 'mimo'",
            radar={
                **_TI_BOARD,
                "chirp_rate_hz": 32e3,
                "transmit_power_dbm": 13.0,
                "noise_figure_db": 13.0,
                "array": {
                    "transmitters_wavelengths": _places(
                        (11, 10, 9, 32, 28, 24, 20, 16, 12, 8, 4, 0), (6, 4, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0)
                    ),
                    "receivers_wavelengths": _places((11, 12, 13, 14, 50, 51, 52, 53, 46, 47, 48, 49, 0, 1, 2, 3)),
                    "multiplexing": "ddm",
                },
            },
            scenario=_MODULE,
            sources=(
                "places of the antennas in half wavelengths: the 4-chip cascade board of TIDEP-01012, as the "
                "configuration files of its examples give them in many public repositories; its guide, TIDUEN5A, has "
                "the same 2, 4 and 16 wavelengths between transmitters and groups of receivers, and 86 places across",
                "13 dBm, noise figure 13 dB at 77 GHz: AWR2243 data sheet, SWRS223, as public repositories quote it; "
                "two chips reported 12.7 to 15.5 dB at 78 GHz (TI E2E forum, thread 1423480)",
            ),
            assumed=(
                "the pattern of each antenna that of `ti_awr1843_array`",
                "half a wavelength at the carrier; the board is made for 76.8 GHz",
                "400 MHz in 256 samples, 32,000 chirps a second: 96 m of range, 2.6 m/s of range rate",
                "Doppler multiplexing of all transmitters at once; the board can turn each one's phase",
            ),
        ),
        "uw_scat_ku": Preset(
            summary="UW-Scat, a 17.2 GHz FMCW scatterometer for snow and ice",
            radar={
                "carrier_hz": 17.2e9,
                "bandwidth_hz": 500e6,
                "chirp_rate_hz": 100.0,
                "samples_per_chirp": 1024,
                "snr_db": 30.0,
                "antenna": {"kind": "taylor", "beamwidth_deg": 5.6, "side_lobe_db": -20.0},
                "scan": {"mode": "whisk_broom", "incidence_deg": 40.0, "half_swath_deg": 40.0, "rotation_rpm": 20.0},
            },
            sources=(
                "17.2 GHz, beam of 5.6 deg, range resolution 30 cm: King et al. 2013, IEEE Geoscience and Remote "
                "Sensing Letters, doi 10.1109/LGRS.2012.2212177; NASA's catalogue of airborne instruments",
            ),
            assumed=(
                "500 MHz, which has that resolution",
                "the signal-to-noise ratio, the side lobes, the sweep's rate, and a scan from the air",
            ),
        ),
        "alt_4300": Preset(
            summary="a 4.3 GHz radio altimeter of aircraft, after the first one of Recommendation ITU-R M.2059",
            radar={
                "carrier_hz": 4.3e9,
                "bandwidth_hz": 150e6,
                "chirp_rate_hz": 143.0,
                "samples_per_chirp": 2048,
                "transmit_power_dbm": 26.0,
                "noise_figure_db": 8.0,
                "antenna": {"kind": "taylor", "beamwidth_deg": 40.0, "side_lobe_db": -20.0},
                "scan": {"mode": "fixed", "incidence_deg": 0.0, "stabilised": False},
            },
            scenario=_ALTIMETER,
            sources=(
                "4.3 GHz, 150 MHz, 143 Hz, 0.4 W, beam of 40 deg: first altimeter of Table 2 of Recommendation ITU-R "
                "M.2059, as MathWorks quotes it in 'FMCW Radar Altimeter Simulation'",
            ),
            assumed=(
                "2048 samples, for 1 km of range, where the source asks for 1.7 km",
                "8 dB of noise figure, the side lobes, and a Taylor taper in both planes",
                "a rising sweep that lasts its whole period",
            ),
        ),
        "alt_24000": Preset(
            summary="a 24 GHz altimeter of drones and light aircraft, after the Ainstein LR-D1",
            radar={
                "carrier_hz": 24.125e9,
                "bandwidth_hz": 250e6,
                "chirp_rate_hz": 1000.0,
                "samples_per_chirp": 2048,
                "transmit_power_dbm": 10.0,
                "noise_figure_db": 12.0,
                "antenna": {"kind": "taylor", "beamwidth_deg": (43.0, 30.0), "side_lobe_db": -20.0},
                "scan": {"mode": "fixed", "incidence_deg": 0.0, "stabilised": False},
            },
            scenario=_ALTIMETER,
            sources=("24 GHz, 250 MHz, 43 by 30 deg, 1.4 to 500 m, 40 readings a second: user manual of the LR-D1",),
            assumed=(
                "43 by 30 deg, the manual's range of detection, as the half-power beam",
                "1000 sweeps a second, of which 25 make a reading",
                "10 dBm, 12 dB of noise figure, the side lobes, and a Taylor taper in both planes",
            ),
        ),
        "alt_77000": Preset(
            summary="a 77 GHz altimeter of one transmitter and one receiver of `ti_awr1843`, looking down",
            radar={
                "carrier_hz": 77e9,
                "bandwidth_hz": 1e9,
                "chirp_rate_hz": 1000.0,
                "samples_per_chirp": 1024,
                "sampling": "iq",
                "transmit_power_dbm": 12.0,
                "noise_figure_db": 15.0,
                "antenna": {"kind": "taylor", "beamwidth_deg": (56.0, 28.0), "side_lobe_db": -20.0},
                "scan": {"mode": "fixed", "incidence_deg": 0.0, "stabilised": False},
            },
            scenario=_ALTIMETER,
            sources=("those of `ti_awr1843`",),
            assumed=(
                "1 GHz in 1024 samples, for 153 m of range, and 1000 sweeps a second",
                "the receiver's antenna equal to the transmitter's, and a Taylor taper",
            ),
        ),
    }
)

# Alternative descriptions of the noise: one of the user's replaces the preset's other.
NOISE = ({"snr_db"}, {"transmit_power_dbm", "noise_figure_db"})
# A table of another kind than the preset's is not merged with it.
KINDS = {"antenna": "kind", "scan": "mode"}


def filled_in(values: Mapping[str, Any], implied: Mapping[str, str]) -> dict[str, Any]:
    """Return keys of `[radar]`, completed from its preset.

    implied: kinds of antenna by the key that implies them.
    """
    preset = copy.deepcopy(dict(PRESETS[values["preset"]].radar))
    for noise_keys, other_keys in (NOISE, NOISE[::-1]):
        if any(values.get(key) is not None for key in noise_keys):
            preset = {key: value for key, value in preset.items() if key not in other_keys}
    receiver = values.get("receiver")
    if isinstance(receiver, Mapping) and receiver.get("amplifiers"):
        preset.pop("noise_figure_db", None)
    merged = {**preset, **{key: value for key, value in values.items() if value is not None}}
    if isinstance(values.get("array"), Mapping) and "array" in preset:
        merged["array"] = {**preset["array"], **values["array"]}
    for table, tag in KINDS.items():
        table_values, preset_table = values.get(table), preset[table]
        if isinstance(table_values, Mapping):
            default_kind = next((kind for key, kind in implied.items() if key in table_values), preset_table[tag])
            same_kind = table_values.get(tag, default_kind) == preset_table[tag]
            merged[table] = {**preset_table, **table_values} if same_kind else dict(table_values)
    return merged
