"""Conditions of `processing.angle` on the rest of a scenario."""

from sionna_radar.scenario.processing import ProcessingTable
from sionna_radar.scenario.radar import ElectronicScanTable, RadarTable
from sionna_radar.scenario.table import refuse
from sionna_radar.scenario.weather import WeatherTable

NEEDED = {"interferometric": "interferometer", "monopulse": "monopulse", "row": "row"}


def check_angle(
    processing: ProcessingTable, radar: RadarTable, weather: WeatherTable, sensor: str, whole_echoes: str | None
) -> None:
    """Reject an angle of arrival that conflicts with the rest of a scenario.

    Parameters
    ----------
    processing, radar, weather, sensor:
        Of the scenario.
    whole_echoes:
        Its DEM method, if that models whole echoes.

    """
    angle = processing.angle
    if angle == "off":
        return
    problem: tuple[str, str] | None = None
    if sensor != "radar":
        problem = "processing.angle", f"{angle!r} needs sensor = 'radar', not {sensor!r}; set 'off'"
    elif radar.second_receiver is None or radar.second_receiver.kind != NEEDED[angle]:
        problem = "processing.angle", f"{angle!r} needs radar.second_receiver with kind = {NEEDED[angle]!r}; add it"
    elif radar.sweep == "triangular":
        problem = "processing.angle", f"{angle!r} is not for pairs of sweeps; set radar.sweep = 'up'"
    elif isinstance(radar.scan, ElectronicScanTable):
        problem = "processing.angle", f"{angle!r} is not for beams steered electronically; set another radar.scan.mode"
    elif weather.falling or weather.dust_visibility_m is not None:
        problem = "processing.angle", f"{angle!r} does not tell rain, snow or dust from ground; remove the weather"
    elif whole_echoes is not None:
        message = f"{whole_echoes!r} models whole echoes, and processing.angle = {angle!r} gives points; "
        problem = "dem.method", message + "set 'linear' or 'smooth'"
    if problem is not None:
        raise refuse(*problem)
