"""The step in which the converter of a radar rounds."""

from sionna_radar.scenario.bases import StageParameters
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.signal.converter import build_converter
from sionna_radar.signal.receiver import Receiver
from sionna_radar.signal.stages import StageInputs


def rounding_step(radar: RadarTable, receiver: Receiver) -> float | None:
    """Return the step of the converter on the scale of the antenna; None for one without a fixed step."""
    if "converter" in radar.receiver.stages:
        return None
    given = StageInputs(radar=radar, sweeps=receiver.sweeps, high_pass=receiver.high_pass)
    converter = build_converter(StageParameters(stage="converter"), given)
    return converter.step(receiver.noise_power_w, receiver.chirp)


def rounding_over_noise(radar: RadarTable, receiver: Receiver) -> float | None:
    """Return the power of the rounding of a sample over that of its thermal noise; None without a fixed step."""
    step = rounding_step(radar, receiver)
    if step is None or receiver.noise_power_w == 0:
        return None
    parts = 1 if receiver.chirp.sampling == "real" else 2
    return parts * step**2 / 12 / receiver.noise_power_w
