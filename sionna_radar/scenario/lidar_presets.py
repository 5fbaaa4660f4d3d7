"""Presets of published lidars (`lidar.preset`), with the sources and assumptions of their values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import radians
from types import MappingProxyType
from typing import Any


@dataclass(frozen=True, kw_only=True)
class LidarPreset:
    """A published lidar.

    summary: description. lidar: keys of `[lidar]`. sources: of its figures. assumed: figures without a source.
    """

    summary: str
    lidar: Mapping[str, Any]
    sources: tuple[str, ...]
    assumed: tuple[str, ...]


def _livox(**keys: Any) -> dict[str, Any]:
    """Return the keys of a scanner of Livox; both have the beam of an edge emitter, 0.03 by 0.28 deg."""
    return {
        "model": "as_built",
        "wavelength_nm": 905,
        "divergence_mrad": round(1e3 * radians(0.03), 3),
        "second_divergence_mrad": round(1e3 * radians(0.28), 3),
        "returns": "all",
        "range_noise_m": 0.02,
        **keys,
    }


_REST = (
    "energy and length of the pulse, receiver, filter, efficiency, noise factor: in no data sheet, those of [lidar]; "
    "the detector noise follows from the clear range"
)
_FLOOR = "the published 1-sigma error at 20 m as what remains of strong echoes at any range"

LIDAR_PRESETS: Mapping[str, LidarPreset] = MappingProxyType(
    {
        "livox_avia": LidarPreset(
            summary="Livox Avia, a lidar for mapping from drones, up to three returns",
            lidar=_livox(clear_range_m=190.0, near_range_m=1.0, max_returns=3),
            sources=(
                "190 m at 10 % and 100 klx, 2 cm (1 sigma) at 20 m, 0.28 deg (vertical) by 0.03 deg (horizontal), "
                "three returns, a blind zone of 1 m: livoxtech.com/avia/specs, as a public design document for a "
                "driving simulator restates it",
            ),
            assumed=("905 nm, as of the HAP", "a false-alarm probability of 1e-4, as of the HAP", _FLOOR, _REST),
        ),
        "livox_hap": LidarPreset(
            summary="Livox HAP, a lidar for cars",
            lidar=_livox(clear_range_m=150.0, near_range_m=0.5, max_returns=1, false_alarm_probability=1e-4),
            sources=(
                "905 nm, 150 m at 10 % and 100 klx, less than 2 cm (1 sigma) at 20 m and 80 %, 0.03 deg (horizontal) "
                "by 0.28 deg (vertical), a false-alarm ratio of 0.01 % at 100 klx, a blind zone of 0.5 m: Livox HAP "
                "(TX) user manual 2022, table 1.2.1",
            ),
            assumed=("one return a pulse, the strongest", "the false-alarm ratio as that of a pulse", _FLOOR, _REST),
        ),
    }
)
