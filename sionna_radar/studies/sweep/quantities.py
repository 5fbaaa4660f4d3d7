"""Named quantities of a radar and its flight in closed form.

Quantities cost nothing to compute, and stand beside the errors of a survey in requirements, objectives, costs and
tables. All are those of level ground `platform.altitude_m` under the flight. The scan and the antenna decide which are
defined; an undefined one is NaN.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeGuard

import numpy as np
from scipy.constants import speed_of_light

from sionna_radar.flight.build import plan_route
from sionna_radar.flight.covering_lines import covering_lines
from sionna_radar.foundation.errors import RadarError
from sionna_radar.foundation.numerics import is_number
from sionna_radar.radar.build import build_antenna
from sionna_radar.scenario import ScanParameters, Scenario
from sionna_radar.scenario.overrides import value_at
from sionna_radar.scenario.radar import AntennaTable, ArrayAntennaTable, ElectronicScanTable, ScanTable
from sionna_radar.scenario.receiver import ArrayTable
from sionna_radar.studies.sweep.settings import refuse

NAN = float("nan")
# Bits of a sample without `radar.receiver.converter.bits`: the word in which samples are stored.
STORED_BITS = 16


@dataclass(frozen=True, kw_only=True)
class Area:
    """An area to be mapped: its sides, and the share of a swath that the next line covers again."""

    size_m: tuple[float, float]
    overlap: float = 0.2


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """A named quantity: its unit, its formula, and its value for a scenario and an area (None: the scenario's flight).

    undefined: when it is NaN.
    """

    unit: str
    formula: str
    value: Callable[[Scenario, Area | None], float]
    undefined: str = ""


def quantities_of(scenario: Scenario, area: Area | None = None, names: Iterable[str] | None = None) -> dict[str, float]:
    """Return some or all of `QUANTITIES` by name; NaN where the scenario leaves one undefined."""
    return {name: QUANTITIES[name].value(scenario, area) for name in (QUANTITIES if names is None else names)}


def key_value(scenario: Scenario, key: str) -> float:
    """Return the number under a dotted key; raises ScenarioError for anything but a number."""
    if not is_number(value := value_at(scenario, key)):
        refuse(f"{value!r} is no number here, and cannot be part of an expression", key)
    return float(value)


def taylor_aperture_m(beamwidth_rad: float, side_lobe_db: float, wavelength_m: float) -> float:
    """Return the length of a line source with a Taylor taper for a half-power beamwidth.

    HPBW = 2 asin(sigma wavelength / (pi L) sqrt(acosh(R)^2 - acosh(R / sqrt 2)^2)) with the voltage ratio R of main to
    side lobe, A = acosh(R) / pi, nbar >= 2 A^2 + 1/2 and sigma = nbar / sqrt(A^2 + (nbar - 1/2)^2) (Taylor 1955,
    "Design of line-source antennas for narrow beamwidth and low side lobes").
    """
    ratio = 10 ** (-side_lobe_db / 20)
    a = math.acosh(ratio) / math.pi
    nbar = max(2, math.ceil(2 * a**2 + 0.5))
    sigma = nbar / math.hypot(a, nbar - 0.5)
    width = math.sqrt(math.acosh(ratio) ** 2 - math.acosh(ratio / math.sqrt(2)) ** 2)
    return sigma * wavelength_m * width / (math.pi * math.sin(beamwidth_rad / 2))


def _array(scenario: Scenario) -> ArrayTable | None:
    """Return the array of a module that maps without turning; None for other sensors."""
    return scenario.radar.array if scenario.sensor == "mimo" else None


def _aperture_m(scenario: Scenario, _area: Area | None = None) -> float:
    antenna, wavelength = scenario.radar.antenna, speed_of_light / scenario.radar.carrier_hz
    if scenario.sensor == "lidar":
        return NAN
    if (array := _array(scenario)) is not None:
        places = np.array([*array.transmitters_wavelengths, *array.receivers_wavelengths])
        return float(np.ptp(places, axis=0).max()) * wavelength
    if isinstance(antenna, AntennaTable):
        return taylor_aperture_m(min(antenna.beamwidths_rad), antenna.side_lobe_db, wavelength)
    if isinstance(antenna, ArrayAntennaTable) and antenna.elements is not None:
        spacing = antenna.spacing_wavelengths
        spacings = spacing if isinstance(spacing, tuple) else (spacing, spacing)
        return max(n * d for n, d in zip(antenna.elements, spacings, strict=True)) * wavelength
    return NAN


def _beamwidths_rad(scenario: Scenario) -> tuple[float, float]:
    """Return the half-power beamwidths in azimuth and elevation; of an array its whole view, NaN of a lidar."""
    antenna = scenario.radar.antenna
    if scenario.sensor == "lidar":
        return NAN, NAN
    if (array := _array(scenario)) is not None:
        return 2 * math.radians(array.half_view_deg), 2 * math.radians(array.half_view_deg)
    if isinstance(antenna, AntennaTable):
        return antenna.beamwidths_rad
    try:
        return build_antenna(antenna).beamwidths_rad
    except RadarError:
        return NAN, NAN


def _duty(scenario: Scenario) -> float:
    """Return the share of time in which the radar transmits."""
    radar, array = scenario.radar, _array(scenario)
    if array is not None:
        return array.chirps_per_frame * array.frame_rate_hz / radar.chirp_rate_hz
    return radar.scan.half_swath_deg / 180 if _turns(radar.scan) else 1.0


def _turns(scan: ScanParameters) -> TypeGuard[ScanTable]:
    return isinstance(scan, ScanTable) and scan.mode in ("whisk_broom", "conical")


def _pulses_per_s(scenario: Scenario, _area: Area | None = None) -> float:
    return scenario.radar.mean_rate_hz * (2 if scenario.radar.sweep == "triangular" else 1) * _duty(scenario)


def _samples_per_s(scenario: Scenario, _area: Area | None = None) -> float:
    radar = scenario.radar
    parts = 2 if radar.sampling == "iq" else 1
    table = radar.second_receiver
    receivers = 1 if table is None else table.receivers or 2
    if (array := _array(scenario)) is not None:
        receivers = len(array.receivers_wavelengths)
    if scenario.sensor == "lidar":
        return NAN
    return _pulses_per_s(scenario) * radar.samples_per_chirp * parts * receivers


def _transmit_power_w(scenario: Scenario, _area: Area | None = None) -> float:
    power_dbm, array = scenario.radar.transmit_power_dbm, _array(scenario)
    if power_dbm is None or scenario.sensor == "lidar":
        return NAN
    at_once = 1 if array is None or array.multiplexing == "tdm" else len(array.transmitters_wavelengths)
    return 10 ** ((power_dbm - 30) / 10) * at_once * _duty(scenario)


def _flight(scenario: Scenario) -> tuple[float, float]:
    """Return height and speed of a planned flight; NaN for a log."""
    platform = scenario.platform
    if platform.altitude_m is None or platform.speed_mps is None:
        return NAN, NAN
    return platform.altitude_m, platform.speed_mps


def _swath_m(scenario: Scenario, _area: Area | None = None) -> float:
    scan, (height, _) = scenario.radar.scan, _flight(scenario)
    if not isinstance(scan, ScanTable | ElectronicScanTable):
        return NAN
    incidence, half = math.radians(scan.incidence_deg), math.radians(scan.half_swath_deg)
    azimuth, elevation = _beamwidths_rad(scenario)
    if _looks_aside(scan):
        # An array's beams to a side follow each other along the track: across it they are one beam wide.
        near, far = incidence - elevation / 2, incidence + elevation / 2
        return height * (math.tan(far) - math.tan(near)) if far < math.pi / 2 else NAN
    if scan.mode == "whisk_broom":
        return 2 * height * math.tan(half)
    if scan.mode == "conical":
        return 2 * height * math.tan(incidence) * math.sin(min(half, math.pi / 2)) or NAN
    side = half if scan.mode == "electronic" else azimuth / 2
    return 2 * height / math.cos(incidence) * math.tan(side)


def _looks_aside(scan: ScanParameters) -> bool:
    """Return True if the beam looks to a side of the track in the middle of the scan."""
    return scan.look != "forward" if isinstance(scan, ElectronicScanTable) else scan.mode == "side_looking"


def _line_gap_m(scenario: Scenario, _area: Area | None = None) -> float:
    scan, (_, speed) = scenario.radar.scan, _flight(scenario)
    if isinstance(scan, ElectronicScanTable):
        return speed / scan.scans_per_s
    if not isinstance(scan, ScanTable):
        return NAN
    if (array := _array(scenario)) is not None:
        return speed / array.frame_rate_hz
    return speed * 60 / scan.rotation_rpm if _turns(scan) else speed / scenario.radar.mean_rate_hz


def _dwell_s(scenario: Scenario, _area: Area | None = None) -> float:
    scan, (height, speed) = scenario.radar.scan, _flight(scenario)
    if isinstance(scan, ElectronicScanTable):
        return 1 / (scan.beams * scan.scans_per_s)
    if not isinstance(scan, ScanTable):
        return NAN
    if (array := _array(scenario)) is not None:
        return array.chirps_per_frame / scenario.radar.chirp_rate_hz
    azimuth, elevation = _beamwidths_rad(scenario)
    incidence = math.radians(scan.incidence_deg)
    if _turns(scan):
        arm = math.cos(incidence) if scan.mode == "whisk_broom" else math.sin(incidence)
        return azimuth / (2 * math.pi * scan.rotation_rpm / 60 * arm) if arm > 0 else NAN
    slant = height / math.cos(incidence)
    along = slant * azimuth if scan.mode == "side_looking" else slant / math.cos(incidence) * elevation
    return along / speed


def _covering(scenario: Scenario, area: Area | None) -> tuple[float, float]:
    """Return the number of lines and the time over an area, else of the scenario's own cruise; NaN for a log."""
    platform, (height, speed) = scenario.platform, _flight(scenario)
    if area is not None:
        swath, scan = _swath_m(scenario), scenario.radar.scan
        if not swath > 0:
            return NAN, NAN
        incidence = 0.0 if _looks_aside(scan) else math.radians(getattr(scan, "incidence_deg", 0.0))
        half_swath = math.atan(swath / (2 * height))
        track = covering_lines(area.size_m, _line_gap_m(scenario), height, incidence, half_swath, area.overlap)
        return float(track.count), track.length_m / speed
    if platform.log is not None:
        return NAN, NAN
    lines = max(len(platform.waypoints_m) - 1, 1)
    if platform.lines is not None:
        lines = platform.lines.count * (2 if platform.lines.crossing else 1)
    try:
        return float(lines), plan_route(platform, lambda: None).duration_s
    except RadarError:
        return NAN, NAN


LOG = "of a flight log, which has no altitude_m and speed_mps"
SWATH = f"{LOG}; of scans of your own, a conical one at incidence 0, and of beams that reach the horizon"
LIDAR = "of a lidar"
QUANTITIES: dict[str, Quantity] = {
    "aperture_m": Quantity(
        unit="m",
        formula="longer side of the antenna: a Taylor line source of the narrower beamwidth; elements times spacing; "
        "or of the box around all elements of radar.array",
        value=_aperture_m,
        undefined=f"{LIDAR}, and of an antenna that is neither taylor nor an array given by its elements",
    ),
    "pulses_per_s": Quantity(
        unit="1/s",
        formula="sweeps a second, times the share of a turn in which the radar transmits (half_swath_deg / 180); of "
        "radar.array the chirps of its frames",
        value=_pulses_per_s,
    ),
    "samples_per_s": Quantity(
        unit="1/s",
        formula="pulses_per_s x samples_per_chirp x 2 for I/Q x receivers",
        value=_samples_per_s,
        undefined=LIDAR,
    ),
    "data_rate_mbps": Quantity(
        unit="Mbit/s",
        formula=f"samples_per_s x converter.bits ({STORED_BITS} without) / 10^6: the raw samples, averaged over a turn",
        value=lambda scenario, _: (
            1e-6 * (scenario.radar.receiver.converter.bits or STORED_BITS) * _samples_per_s(scenario)
        ),
        undefined=LIDAR,
    ),
    "transmit_power_w": Quantity(
        unit="W",
        formula="10^((transmit_power_dbm - 30) / 10) x the share of a turn (of radar.array: of the time) in which the "
        "radar transmits x transmitters at once",
        value=_transmit_power_w,
        undefined=f"{LIDAR}, and with radar.snr_db, which says nothing of power; give radar.transmit_power_dbm and "
        "noise_figure_db",
    ),
    "swath_m": Quantity(
        unit="m",
        formula="whisk_broom 2 h tan(half swath); conical 2 h tan(incidence) sin(half swath); electronic 2 h "
        "tan(half swath) / cos(incidence), or to a side, and fixed and side_looking: the half-power footprint across "
        "the track; of radar.array that of its view, half_view_deg",
        value=_swath_m,
        undefined=SWATH,
    ),
    "area_per_hour_km2": Quantity(
        unit="km2/h",
        formula="swath_m x speed x 3600 s, along one line and without overlap",
        value=lambda scenario, _: 3600e-6 * _swath_m(scenario) * _flight(scenario)[1],
        undefined=SWATH,
    ),
    "lines": Quantity(
        unit="1",
        formula="flight lines over --area, side / (swath_m (1 - overlap)), as `plan` lays them; or of the own flight",
        value=lambda scenario, area: _covering(scenario, area)[0],
        undefined=SWATH,
    ),
    "flying_time_s": Quantity(
        unit="s",
        formula="length of the lines over --area and of the ways between them / speed; or of the scenario's own cruise",
        value=lambda scenario, area: _covering(scenario, area)[1],
        undefined=SWATH,
    ),
    "line_gap_m": Quantity(
        unit="m",
        formula="way flown from one scan line to the next: speed x 60 / rotation_rpm, or over scans, frames or chirps "
        "a second",
        value=_line_gap_m,
        undefined=f"{LOG}; of scans of your own",
    ),
    "dwell_s": Quantity(
        unit="s",
        formula="time in which the beam moves by its half-power width: azimuth width / (2 pi rpm / 60 cos(incidence)) "
        "of whisk_broom, sin of conical; fixed and side_looking: footprint / speed; electronic: one beam's "
        "time; radar.array: a frame's chirps",
        value=_dwell_s,
        undefined=f"{LOG}; {LIDAR}; of scans of your own",
    ),
}
