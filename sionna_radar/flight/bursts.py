"""Bursts of chirps: what is averaged is one pulse of the survey, in the middle of its chirps."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.pulses import Pulses, PulseSchedule

# Chirps farther apart than so many periods have a pause of the scan between them.
PAUSE_PERIODS = 1.5


@dataclass(frozen=True, kw_only=True)
class Bursts:
    """The chirps of the pulses of a schedule.

    schedule: of the pulses. chirps: of each. period_s: from one chirp to the next.
    """

    schedule: PulseSchedule
    chirps: int
    period_s: float

    @property
    def offset_s(self) -> Float[np.ndarray, " chirp"]:
        """Time of each chirp from the middle of its burst."""
        return (np.arange(self.chirps) - (self.chirps - 1) / 2) * self.period_s

    def chirps_of(self, pulses: Pulses) -> Pulses:
        """Return the chirps of pulses, each with an index of its own: the key of its random numbers.

        What is measured of the motion is measured once in a burst.
        """
        index = (pulses.index[:, None] * self.chirps + np.arange(self.chirps)).ravel()
        time_s = (pulses.time_s[:, None] + self.offset_s).ravel()
        own = self.schedule.at(index, time_s)
        return replace(own, measured=pulses.measured.rows(np.repeat(np.arange(len(pulses)), self.chirps)))


def in_bursts(schedule: PulseSchedule, chirps: int, rate_hz: float) -> Bursts | None:
    """Return the bursts of a schedule's chirps: consecutive ones of one scan; those left over are not sent.

    None for bursts of a single chirp.

    Parameters
    ----------
    schedule:
        Of single chirps.
    chirps:
        Of each burst.
    rate_hz:
        Chirps a second.

    """
    if chirps == 1:
        return None
    time_s, scan_number = schedule.time_s, schedule.scan_numbers
    if len(time_s) == 0:
        return Bursts(schedule=schedule, chirps=chirps, period_s=1 / rate_hz)
    parted = np.diff(time_s) > PAUSE_PERIODS / rate_hz
    if scan_number is not None:
        parted |= np.diff(scan_number) != 0
    first = np.concatenate([[0], np.flatnonzero(parted) + 1])
    length = np.diff(np.append(first, len(time_s)))
    place = np.arange(len(time_s)) - np.repeat(first, length)
    used = place < np.repeat(length - length % chirps, length)
    middle_s = time_s[used].reshape(-1, chirps).mean(axis=1)
    return Bursts(schedule=replace(schedule, time_s=middle_s), chirps=chirps, period_s=1 / rate_hz)
