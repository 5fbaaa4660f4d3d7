"""What the reference paper reports for flights like this one: Rouveure et al. 2017, Table 3 and Fig. 14."""

from dataclasses import dataclass

import numpy as np

from sionna_radar.survey.preparation import Prepared

CITATION = (
    'Rouveure, Tourrette, Jaud, Faure, Monod, "Design of lightweight airborne MMW radar for DEM generation. Simulation '
    'results", Robotics and Autonomous Systems 96 (2017) 26-40'
)
# Beamwidth (deg): least, greatest, standard deviation, mean, RMS (m).
TABLE_3 = {
    1.0: (-1.24, 1.04, 0.18, -0.12, 0.22),
    2.0: (-2.65, 2.24, 0.25, -0.15, 0.29),
    4.0: (-6.52, 5.19, 0.64, -0.24, 0.69),
    8.0: (-16.28, 10.73, 1.93, -0.66, 2.04),
}
BUILDINGS_RMS_M, OFF_EDGES_RMS_M, BUILDINGS_BEAM_DEG = 1.51, 0.19, 2.0
# A flight is like the paper's if it is within this share of its height, speed, tilt, and of each number of its radar.
ALIKE = 0.1


@dataclass(frozen=True, kw_only=True)
class Reported:
    """A row of the paper: what of, and its errors in metres by the names of `DemError`; NaN where it has none."""

    name: str
    rms_m: float
    mean_m: float = np.nan
    std_m: float = np.nan
    min_m: float = np.nan
    max_m: float = np.nan


@dataclass(frozen=True, kw_only=True)
class Reference:
    """The comparable rows, if there are any, and under which conditions the paper got them; "" for none."""

    rows: tuple[Reported, ...]
    conditions: str


def reference_for(prepared: Prepared) -> Reference:
    """Return what the paper reports for a survey flown as its examples were."""
    if not _flown_alike(prepared):
        return Reference(rows=(), conditions="")
    scenario = prepared.scenario
    beam = float(np.rad2deg(np.mean(prepared.antenna.beamwidths_rad)))
    over_buildings = scenario.buildings and scenario.terrain.kind == "flat"
    if over_buildings and abs(beam - BUILDINGS_BEAM_DEG) < 0.05 * BUILDINGS_BEAM_DEG:
        rows = (
            Reported(name="Paper, Fig. 14: buildings on flat ground", rms_m=BUILDINGS_RMS_M),
            Reported(name="Paper, Fig. 14, points near edges left out", rms_m=OFF_EDGES_RMS_M),
        )
        return Reference(rows=rows, conditions=_conditions("boxes on flat ground, a beam of 2 deg"))
    width = next((w for w in TABLE_3 if abs(beam - w) < 0.05 * w), None)
    if scenario.terrain.kind == "hills" and width is not None:
        least, most, std, mean, rms = TABLE_3[width]
        row = Reported(
            name=f"Paper, Table 3: {width:g} deg", rms_m=rms, mean_m=mean, std_m=std, min_m=least, max_m=most
        )
        return Reference(rows=(row,), conditions=_conditions(f"rolling hills, a beam of {width:g} deg"))
    return Reference(rows=(), conditions="")


def _flown_alike(prepared: Prepared) -> bool:
    """Whether a radar like the paper's scans clear air from its height, at its speed and tilt, and knows its pose."""
    scenario, radar, scan = prepared.scenario, prepared.scenario.radar, prepared.scenario.radar.scan
    tilt_deg = float(np.rad2deg(prepared.flight.scan.incidence_rad))
    flown = {
        (prepared.flown.altitude_m, 50.0),
        (prepared.flown.speed_mps, 10.0),
        (tilt_deg, 45.0),
        (radar.carrier_hz, 77e9),
        (radar.bandwidth_hz, 500e6),
        (radar.chirp_rate_hz, 360.0),
        (getattr(scan, "rotation_rpm", 0.0), 120.0),
        (radar.snr_db or 0.0, 30.0),
    }
    alike = all(abs(value - wanted) <= ALIKE * wanted for value, wanted in flown)
    replaced = prepared.custom.described()
    return (
        alike
        and scenario.sensor == "radar"
        and scan.mode == "whisk_broom"
        and not scenario.weather.falling
        and scenario.radar.sweep != "triangular"
        and prepared.flight.navigation is None
        and not replaced
    )


def _conditions(what: str) -> str:
    return (
        f"The paper ({CITATION}) flew {what}: 77 GHz, 500 MHz of sweep, 360 chirps/s, 120 rpm, from 50 m at 10 m/s, "
        "tilted by 45 deg, 30 dB SNR, pose known exactly, each echo at the strongest bin of the spectrum and on the "
        "beam axis, linear interpolation. Its ground is not published: sizes and trends compare, single numbers do not."
    )
