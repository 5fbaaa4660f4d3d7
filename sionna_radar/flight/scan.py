"""Antenna scans: the pointing of the antenna at any time."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.scenario.bases import ScanParameters
from sionna_radar.scenario.parts import SCANS
from sionna_radar.scenario.registry import require

Builder = TypeVar("Builder", bound=Callable[..., "Scan"])


@dataclass(frozen=True)
class Pointing:
    """The antenna at some times, in the forward-right-down axes of its mount.

    R_mount_antenna: columns are boresight, left and up of the antenna.
    scan_rad: scan angle, zero in the middle of the sector.
    active: whether the radar transmits at that angle.
    scan_number: scan of the antenna, from 0; None for a continuous scan.
    beam: which beam of an array, of those that the scan steers it to (`beam_azimuth_rad`); None for an antenna whose
        pattern does not change.
    """

    R_mount_antenna: Float[np.ndarray, "n 3 3"]
    scan_rad: Float[np.ndarray, " n"]
    active: Bool[np.ndarray, " n"]
    scan_number: Int[np.ndarray, " n"] | None = None
    beam: Int[np.ndarray, " n"] | None = None


@runtime_checkable
class Scan(Protocol):
    """A scan: the antenna's axes against time."""

    @property
    def stabilised(self) -> bool:
        """Whether roll and pitch are removed from the pointing: the mount is level, not fixed to the body."""
        ...

    @property
    def incidence_rad(self) -> float:
        """Angle of the boresight from nadir in the middle of the scan: the reference of `radar.snr_db`."""
        ...

    def point(self, time_s: Float[np.ndarray, " n"]) -> Pointing:
        """Return the pointing at some times."""
        ...

    def spacing_m(self, height_m: float, speed_mps: float, chirp_rate_hz: float) -> float:
        """Return the largest distance between neighbouring beam centres on level ground: gaps to close in the DEM."""
        ...


def register_scan(name: str, parameters: type[ScanParameters]) -> Callable[[Builder], Builder]:
    """Register a scan, for `radar.scan.mode` in a scenario.

    Parameters
    ----------
    name:
        Its name in scenarios.
    parameters:
        Its table of parameters, `[radar.scan]`.

    Returns
    -------
    A decorator for a class or function that builds a `Scan`; it is called with the parameters.

    Raises
    ------
    PluginError
        The name is taken, or the parameters are not `ScanParameters`.

    Examples
    --------
    >>> import numpy as np
    >>> from sionna_radar.flight import Pointing, whisk_broom_from_antenna
    >>> from sionna_radar.scenario import ScanParameters
    >>> class Nodding(ScanParameters):
    ...     amplitude_deg: float = 20.0
    >>> @register_scan("nodding", Nodding)
    ... class NoddingScan:
    ...     stabilised, incidence_rad, period_s = True, float(np.deg2rad(45.0)), 0.5
    ...     def __init__(self, parameters):
    ...         self.amplitude_rad = np.deg2rad(parameters.amplitude_deg)
    ...     def point(self, time_s):
    ...         angle = self.amplitude_rad * np.sin(2 * np.pi * time_s / self.period_s)
    ...         axes = whisk_broom_from_antenna(self.incidence_rad, angle)
    ...         return Pointing(axes, angle, np.ones(len(time_s), dtype=bool))
    ...     def spacing_m(self, height_m, speed_mps, chirp_rate_hz):
    ...         return speed_mps * self.period_s
    >>> scan = {"mode": "nodding", "amplitude_deg": 10.0}
    >>> len(prepare(load_scenario("hills", {"radar.scan": scan, "platform.length_m": 10.0})))
    360

    """
    return SCANS.register(name, parameters)


def build_scan(table: ScanParameters) -> Scan:
    """Return the scan of a scenario."""
    scan: Scan = SCANS.entry(table.mode)(table)
    require(scan, Scan, str(SCANS.entry(table.mode)))
    return scan
