"""What `processing.average` needs of the rest of a scenario."""

from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.scenario.processing import ProcessingTable
from sionna_radar.scenario.radar import ElectronicScanTable, RadarTable
from sionna_radar.scenario.table import refuse
from sionna_radar.scenario.tracing import TracingTable
from sionna_radar.scenario.weather import WeatherTable


def check_average(
    processing: ProcessingTable,
    radar: RadarTable,
    weather: WeatherTable,
    tracing: TracingTable,
    sensor: str,
    whole_echoes: str | None,
) -> None:
    """Refuse an average of chirps that the rest of a scenario does not allow.

    Parameters
    ----------
    processing, radar, weather, tracing, sensor:
        Of the scenario.
    whole_echoes:
        Its DEM method, if that models whole echoes.

    """
    average = processing.average
    if average.chirps == 1:
        return
    key, problem = "processing.average.chirps", ""
    if sensor != "radar":
        problem = f"{average.chirps} needs sensor = 'radar', not {sensor!r}; set 1"
    elif radar.sweep == "triangular":
        problem = f"{average.chirps} is not for pairs of sweeps; set 1, or radar.sweep = 'up'"
    elif radar.stagger > 0:
        problem = f"{average.chirps} needs even intervals; set 1, or radar.stagger = 0"
    elif isinstance(radar.scan, ElectronicScanTable):
        problem = f"{average.chirps} is not for a beam that is steered anew for each chirp; set 1"
    elif weather.falling or weather.dust_visibility_m is not None:
        problem = f"{average.chirps} does not tell rain, snow or dust from ground; set 1, or remove the weather"
    elif average.mode == "coherent" and tracing.speckle == "per_pulse":
        key = "processing.average.mode"
        problem = "'coherent' needs the same scatterers in all chirps; set tracing.speckle = 'persistent'"
    elif average.mode == "incoherent":
        key, problem = _of_powers(processing, whole_echoes)
    if problem:
        raise refuse(key, problem)


def _of_powers(processing: ProcessingTable, whole_echoes: str | None) -> tuple[str, str]:
    """Return the key and the problem of an average of powers; empty for none."""
    kind = processing.cfar.kind
    if kind != "CA":
        message = f"{kind!r} has no false-alarm rate in closed form over averaged powers; set 'CA'"
        return "processing.cfar.kind", message
    if processing.angle != "off":
        return "processing.average.mode", "an angle needs phases, which averaged powers have lost; set 'coherent'"
    if whole_echoes is not None:
        message = f"{whole_echoes!r} knows the likelihood of single chirps alone; set 'linear'"
        return "dem.method", f"{message}, or processing.average.mode = 'coherent'"
    return "", ""


def speckle_looks(processing: ProcessingTable, tracing: TracingTable) -> int:
    """Return the averaged powers of a pulse that have speckle of their own; that of still ground is taken for one."""
    return processing.average.powers if tracing.speckle == "per_pulse" else 1


def refuse_average(processing: ProcessingTable, what: str) -> None:
    """Refuse averaged chirps where single ones are looked at, with ScenarioError; `what` is made of them."""
    if processing.average.chirps > 1:
        message = f"{processing.average.chirps}: {what} knows single chirps alone; set 1"
        raise ScenarioError([Problem("processing.average.chirps", message)])
