"""The pulses that a radar transmits, one after another without an end: their times and numbers.

A pulse is a chirp, several chirps in succession that are averaged, or the frame of an array.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.flight.pulses import CHIRPS_AT_ONCE, burst_middles_s, chirp_times_s
from sionna_radar.flight.scan import Scan
from sionna_radar.foundation.threads import chunks


@dataclass(kw_only=True)
class PulseClock:
    """Counts the pulses of a schedule.

    start_s, rate_hz, stagger: of the chirps, or frames; see `schedule_pulses`.
    scan: where the antenna points, and whether it transmits there.
    averaged: chirps of a pulse.
    half_s: half the duration of a pulse, from its middle to its first and last chirp.
    """

    start_s: float
    rate_hz: float
    stagger: float
    scan: Scan
    averaged: int
    half_s: float
    _chirp: int = 0
    _pulse: int = 0
    _begun_s: Float[np.ndarray, " chirp"] = field(default_factory=lambda: np.zeros(0))

    def begin(self, time_s: float) -> None:
        """Leave out what was transmitted before a time."""
        first = max(0, int(np.floor((time_s - self.start_s) * self.rate_hz / (1 + self.stagger / 2) - 0.5)) - 2)
        chirp = np.arange(first, first + 6)
        due = self._times_s(chirp) >= time_s + (self.half_s if self.averaged == 1 else 0.0)
        self._chirp, self._begun_s = int(chirp[due][0]), np.zeros(0)

    def until(self, time_s: float) -> tuple[Int[np.ndarray, " pulse"], Float[np.ndarray, " pulse"]]:
        """Return the numbers and middle times of the next pulses, as far as they end by a time."""
        end_s = time_s - (self.half_s if self.averaged == 1 else 0.0)
        last = max(self._chirp, int(np.floor((end_s - self.start_s) * self.rate_hz)) + 1)
        times = [self._begun_s]
        for low, high in chunks(last - self._chirp, CHIRPS_AT_ONCE):
            at_s = self._times_s(self._chirp + np.arange(high - low))
            at_s = at_s[at_s <= end_s]
            self._chirp += len(at_s)
            times.append(at_s[self.scan.point(at_s).active])
        middle_s = np.concatenate(times)
        if self.averaged > 1 and len(middle_s):
            chirp_s = middle_s
            middle_s, left = burst_middles_s(chirp_s, self.scan.point(chirp_s).scan_number, self.averaged, self.rate_hz)
            self._begun_s = chirp_s[len(chirp_s) - left :]
        index = self._pulse + np.arange(len(middle_s))
        self._pulse += len(middle_s)
        return index, middle_s

    def next_scan(self) -> tuple[int, int | None]:
        """Return the number of the next pulse, and the scan of the antenna that its first chirp belongs to."""
        chirp, count = self._chirp, 64
        while True:
            at_s = self._times_s(chirp + np.arange(count))
            pointing = self.scan.point(at_s)
            if pointing.active.any():
                scan = pointing.scan_number
                return self._pulse, None if scan is None else int(scan[pointing.active][0])
            chirp, count = chirp + count, min(2 * count, CHIRPS_AT_ONCE)

    def _times_s(self, chirp: Int[np.ndarray, " chirp"]) -> Float[np.ndarray, " chirp"]:
        return chirp_times_s(chirp, self.start_s, self.rate_hz, self.stagger)
