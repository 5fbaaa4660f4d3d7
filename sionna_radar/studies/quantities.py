"""Named quantities of a radar and its flight in closed form: aperture, data rate, swath, time in the air.

They cost nothing to compute, and stand beside the errors of a survey in requirements, objectives, costs and tables. All
are those of level ground `platform.altitude_m` under the flight. The scan and the antenna decide which are defined; an
undefined one is NaN.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeGuard

from scipy.constants import speed_of_light

from sionna_radar.foundation.errors import RadarError
from sionna_radar.radar.build import build_antenna
from sionna_radar.scenario import ScanParameters, Scenario
from sionna_radar.scenario.radar import AntennaTable, ArrayAntennaTable, ElectronicScanTable, ScanTable
from sionna_radar.studies.planning import lines_over

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


def _aperture_m(scenario: Scenario, area: Area | None) -> float:
    del area
    antenna, wavelength = scenario.radar.antenna, speed_of_light / scenario.radar.carrier_hz
    if isinstance(antenna, AntennaTable):
        return taylor_aperture_m(min(antenna.beamwidths_rad), antenna.side_lobe_db, wavelength)
    if isinstance(antenna, ArrayAntennaTable) and antenna.elements is not None:
        spacing = antenna.spacing_wavelengths
        spacings = spacing if isinstance(spacing, tuple) else (spacing, spacing)
        return max(n * d for n, d in zip(antenna.elements, spacings, strict=True)) * wavelength
    return NAN


def _beamwidths_rad(scenario: Scenario) -> tuple[float, float]:
    """Return the half-power beamwidths in azimuth and elevation."""
    antenna = scenario.radar.antenna
    if isinstance(antenna, AntennaTable):
        return antenna.beamwidths_rad
    try:
        return build_antenna(antenna).beamwidths_rad
    except RadarError:
        return NAN, NAN


def _duty(scenario: Scenario) -> float:
    """Return the share of time in which the radar transmits."""
    scan = scenario.radar.scan
    return scan.half_swath_deg / 180 if _turns(scan) else 1.0


def _turns(scan: ScanParameters) -> TypeGuard[ScanTable]:
    return isinstance(scan, ScanTable) and scan.mode in ("whisk_broom", "conical")


def _pulses_per_s(scenario: Scenario, area: Area | None) -> float:
    del area
    return scenario.radar.mean_rate_hz * (2 if scenario.radar.sweep == "triangular" else 1) * _duty(scenario)


def _samples_per_s(scenario: Scenario, area: Area | None) -> float:
    radar = scenario.radar
    parts = 2 if radar.sampling == "iq" else 1
    table = radar.second_receiver
    receivers = 1 if table is None else table.receivers or 2
    return _pulses_per_s(scenario, area) * radar.samples_per_chirp * parts * receivers


def _data_rate_mbps(scenario: Scenario, area: Area | None) -> float:
    bits = scenario.radar.receiver.converter.bits or STORED_BITS
    return 1e-6 * bits * _samples_per_s(scenario, area)


def _transmit_power_w(scenario: Scenario, area: Area | None) -> float:
    del area
    power_dbm = scenario.radar.transmit_power_dbm
    return NAN if power_dbm is None else 10 ** ((power_dbm - 30) / 10) * _duty(scenario)


def _flight(scenario: Scenario) -> tuple[float, float]:
    """Return height and speed of a planned flight; NaN for a log."""
    platform = scenario.platform
    if platform.altitude_m is None or platform.speed_mps is None:
        return NAN, NAN
    return platform.altitude_m, platform.speed_mps


def _swath_m(scenario: Scenario, area: Area | None) -> float:
    del area
    scan, (height, _) = scenario.radar.scan, _flight(scenario)
    if isinstance(scan, ElectronicScanTable):
        half = math.radians(scan.half_swath_deg)
        return 2 * height * math.tan(half) / math.cos(math.radians(scan.incidence_deg)) if _ahead(scan) else NAN
    if not isinstance(scan, ScanTable):
        return NAN
    incidence, half = math.radians(scan.incidence_deg), math.radians(scan.half_swath_deg)
    if scan.mode == "whisk_broom":
        return 2 * height * math.tan(half)
    if scan.mode == "conical":
        return 2 * height * math.tan(incidence) * math.sin(min(half, math.pi / 2))
    azimuth, elevation = _beamwidths_rad(scenario)
    if scan.mode == "fixed":
        return 2 * height / math.cos(incidence) * math.tan(azimuth / 2)
    far = incidence + elevation / 2
    return height * (math.tan(far) - math.tan(incidence - elevation / 2)) if far < math.pi / 2 else NAN


def _ahead(scan: ElectronicScanTable) -> bool:
    return scan.look == "forward"


def _area_per_hour_km2(scenario: Scenario, area: Area | None) -> float:
    return 3600e-6 * _swath_m(scenario, area) * _flight(scenario)[1]


def _line_gap_m(scenario: Scenario, area: Area | None) -> float:
    del area
    scan, (_, speed) = scenario.radar.scan, _flight(scenario)
    if isinstance(scan, ElectronicScanTable):
        return speed / scan.scans_per_s
    if not isinstance(scan, ScanTable):
        return NAN
    return speed * 60 / scan.rotation_rpm if _turns(scan) else speed / scenario.radar.mean_rate_hz


def _dwell_s(scenario: Scenario, area: Area | None) -> float:
    del area
    scan, (height, speed) = scenario.radar.scan, _flight(scenario)
    if isinstance(scan, ElectronicScanTable):
        return 1 / (scan.beams * scan.scans_per_s)
    if not isinstance(scan, ScanTable):
        return NAN
    azimuth, elevation = _beamwidths_rad(scenario)
    incidence = math.radians(scan.incidence_deg)
    if _turns(scan):
        arm = math.cos(incidence) if scan.mode == "whisk_broom" else math.sin(incidence)
        return azimuth / (2 * math.pi * scan.rotation_rpm / 60 * arm) if arm > 0 else NAN
    slant = height / math.cos(incidence)
    along = slant * azimuth if scan.mode == "side_looking" else slant / math.cos(incidence) * elevation
    return along / speed


def _lines(scenario: Scenario, area: Area | None) -> float:
    return _covering(scenario, area)[0]


def _flying_time_s(scenario: Scenario, area: Area | None) -> float:
    return _covering(scenario, area)[1]


def _covering(scenario: Scenario, area: Area | None) -> tuple[float, float]:
    """Return the number of lines and the time over an area; without one those of the scenario's own cruise."""
    platform, (height, speed) = scenario.platform, _flight(scenario)
    if area is not None:
        swath, scan = _swath_m(scenario, None), scenario.radar.scan
        if not swath > 0:
            return NAN, NAN
        incidence = math.radians(getattr(scan, "incidence_deg", 0.0))
        lines, length = lines_over(area.size_m, height, swath, incidence, area.overlap, _line_gap_m(scenario, None))
        return float(lines), length / speed
    if platform.lines is not None or platform.log is not None:
        return NAN, NAN
    corners = platform.waypoints_m
    length = sum(map(math.dist, corners[:-1], corners[1:])) if corners else platform.length_m
    return float(max(len(corners) - 1, 1)), length / speed


LOG = "of a flight log, which has no altitude_m and speed_mps"
SWATH = f"{LOG}; of scans of your own and electronic ones to a side"
QUANTITIES: dict[str, Quantity] = {
    "aperture_m": Quantity(
        unit="m",
        formula="longer side of the antenna: a Taylor line source of the narrower beamwidth; or elements times spacing",
        value=_aperture_m,
        undefined="the antenna is neither taylor nor an array given by its elements",
    ),
    "pulses_per_s": Quantity(
        unit="1/s",
        formula="sweeps a second, times the share of a turn in which the radar transmits (half_swath_deg / 180)",
        value=_pulses_per_s,
    ),
    "samples_per_s": Quantity(
        unit="1/s",
        formula="pulses_per_s x samples_per_chirp x 2 for I/Q x receivers",
        value=_samples_per_s,
    ),
    "data_rate_mbps": Quantity(
        unit="Mbit/s",
        formula=f"samples_per_s x converter.bits ({STORED_BITS} without) / 10^6: the raw samples, averaged over a turn",
        value=_data_rate_mbps,
    ),
    "transmit_power_w": Quantity(
        unit="W",
        formula="10^((transmit_power_dbm - 30) / 10) x the share of a turn in which the radar transmits",
        value=_transmit_power_w,
        undefined="radar.snr_db says nothing of power; give radar.transmit_power_dbm and noise_figure_db",
    ),
    "swath_m": Quantity(
        unit="m",
        formula="whisk_broom 2 h tan(half swath); conical 2 h tan(incidence) sin(half swath); electronic 2 h "
        "tan(half swath) / cos(incidence); fixed and side_looking: the half-power footprint across the track",
        value=_swath_m,
        undefined=SWATH,
    ),
    "area_per_hour_km2": Quantity(
        unit="km2/h",
        formula="swath_m x speed x 3600 s, along one line and without overlap",
        value=_area_per_hour_km2,
        undefined=SWATH,
    ),
    "lines": Quantity(
        unit="1",
        formula="flight lines over --area, side / (swath_m (1 - overlap)), as `plan` lays them; or of the own flight",
        value=_lines,
        undefined=SWATH,
    ),
    "flying_time_s": Quantity(
        unit="s",
        formula="length of the lines over --area and of the ways between them / speed; or of the scenario's own cruise",
        value=_flying_time_s,
        undefined=SWATH,
    ),
    "line_gap_m": Quantity(
        unit="m",
        formula="way flown from one scan line to the next: speed x 60 / rotation_rpm, or over scans or chirps a second",
        value=_line_gap_m,
        undefined=f"{LOG}; of scans of your own",
    ),
    "dwell_s": Quantity(
        unit="s",
        formula="time in which the beam moves by its half-power width: azimuth width / (2 pi rpm / 60 cos(incidence)) "
        "of whisk_broom, sin of conical; fixed and side_looking: footprint / speed; electronic: one beam's time",
        value=_dwell_s,
        undefined=f"{LOG}; of scans of your own",
    ),
}
