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


_SHAPE = "a loop 1 MHz wide: level within it, 20 dB a decade beyond; the source gives the figure at 1 MHz alone"
# The data sheets themselves were not at hand.
_AWR1843AOP = "at 1 MHz, from the AWR1843AOP data sheet SWRS236C as a public repository of component data quotes it"
_AWR2243 = "at 1 MHz, from the AWR2243 data sheet SWRS223D as the fact check of a public repository quotes it"


def _synthesiser(level_dbc_hz: float, band: str, source: str) -> PhaseNoiseLevels:
    levels = ((1e3, level_dbc_hz), (1e6, level_dbc_hz), (1e7, level_dbc_hz - 20))
    return PhaseNoiseLevels(levels=levels, source=f"{band}, {level_dbc_hz:g} dBc/Hz {source}", assumed=_SHAPE)


PHASE_NOISE: Mapping[str, PhaseNoiseLevels] = MappingProxyType(
    {
        "ti_awr1843aop_76ghz": _synthesiser(-95.0, "the first of two figures, for 76 to 77 GHz", _AWR1843AOP),
        "ti_awr1843aop_77ghz": _synthesiser(-93.0, "the second of two figures, for 77 to 81 GHz", _AWR1843AOP),
        "ti_awr2243_76ghz": _synthesiser(-96.0, "76 to 77 GHz (VCO1)", _AWR2243),
        "ti_awr2243_77ghz": _synthesiser(-94.0, "77 to 81 GHz (VCO2)", _AWR2243),
    }
)
