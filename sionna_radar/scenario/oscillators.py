"""Published phase noise by name: `radar.receiver.oscillator.phase_noise_preset`."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True, kw_only=True)
class PhaseNoiseLevels:
    """Published phase noise.

    levels: offsets from the carrier in Hz, and levels of one sideband in dBc/Hz.
    source: of its figures. assumed: what no source gives.
    """

    levels: tuple[tuple[float, float], ...]
    source: str
    assumed: str


_SHAPE = "a loop 1 MHz wide: level within it, 20 dB a decade beyond; the data sheet gives the figure at 1 MHz alone"


def _synthesiser(level_dbc_hz: float, source: str) -> PhaseNoiseLevels:
    levels = ((1e3, level_dbc_hz), (1e6, level_dbc_hz), (1e7, level_dbc_hz - 20))
    return PhaseNoiseLevels(levels=levels, source=source, assumed=_SHAPE)


PHASE_NOISE: Mapping[str, PhaseNoiseLevels] = MappingProxyType(
    {
        "ti_awr1243_76ghz": _synthesiser(-95.0, "76 to 77 GHz, -95 dBc/Hz at 1 MHz: AWR1243 data sheet, SWRS188"),
        "ti_awr1243_77ghz": _synthesiser(-93.0, "77 to 81 GHz, -93 dBc/Hz at 1 MHz: AWR1243 data sheet, SWRS188"),
        "ti_awr2243_76ghz": _synthesiser(-96.0, "76 to 77 GHz, -96 dBc/Hz at 1 MHz: AWR2243 data sheet, SWRS223"),
        "ti_awr2243_77ghz": _synthesiser(-94.0, "77 to 81 GHz, -94 dBc/Hz at 1 MHz: AWR2243 data sheet, SWRS223"),
    }
)
