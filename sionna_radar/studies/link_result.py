"""What a link budget finds."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import maximum_filter1d

from sionna_radar.foundation.decibel import to_db
from sionna_radar.scenario import Scenario

# Closed form and simulation agree within this; a simulated ratio that scatters by more than half of it says nothing.
TOLERANCE_DB = 0.3
SURE = 0.9


@dataclass(frozen=True, kw_only=True)
class Ground:
    """The strongest range cell of the ground at one range, in closed form.

    snr, clutter: mean power of the ground, and of what is in the air there, over all the floors there: noise, leakage,
        rounding.
    detection: probability of detecting the ground in one pulse against noise and clutter: that the cell passes the
        CFAR's multiple of what the CFAR reads around it, or of noise and clutter in the cell where that is more.
    false_alarm: probability that the cell passes the CFAR without the ground, by clutter and noise.
    passing: probability that it passes with all of them.
    """

    snr: float
    clutter: float
    detection: float
    false_alarm: float
    passing: float

    def numbers(self) -> dict[str, float]:
        """Return what tables and files say, by name; not finite where there is no number."""
        return {
            "snr_db": to_db(self.snr),
            "signal_to_clutter_db": to_db(self.snr / self.clutter) if self.clutter > 0 else float("nan"),
            "detection_probability": self.detection,
            "false_alarm_probability": self.false_alarm,
            "passing_probability": self.passing,
        }


@dataclass(frozen=True, kw_only=True)
class Simulated:
    """One range at which the chain was run.

    ground: the closed form there.
    found: ground and clutter over the noise in the strongest range cell, simulated.
    spread_db: standard deviation of what was found, from the number of looks.
    passed: share of pulses in which that cell passes the CFAR.
    echo_passed: share of pulses in which any cell within 3 dB of it does.
    reason: why nothing was simulated, if so.
    """

    range_m: float
    ground: "Ground"
    found: float
    spread_db: float
    passed: float
    echo_passed: float
    reason: str = ""

    @classmethod
    def impossible(cls, range_m: float, ground: "Ground", reason: str) -> "Simulated":
        """Return a range that could not be simulated."""
        nothing = float("nan")
        return cls(
            range_m=range_m,
            ground=ground,
            found=nothing,
            spread_db=nothing,
            passed=nothing,
            echo_passed=nothing,
            reason=reason,
        )

    @property
    def difference_db(self) -> float:
        """Simulated over closed form; not finite where nothing was found, or simulated."""
        return to_db(self.found / (self.ground.snr + self.ground.clutter))

    @property
    def compared(self) -> bool:
        """Whether enough was simulated to compare."""
        return self.spread_db <= TOLERANCE_DB / 2


@dataclass(frozen=True, kw_only=True)
class Link:
    """One material at one incidence in one rain, over range."""

    material: str
    incidence_deg: float
    rain_mm_per_h: float
    range_m: Float[np.ndarray, " range"]
    ground: tuple[Ground, ...]
    simulated: tuple[Simulated, ...]

    def of_ground(self, name: str) -> Float[np.ndarray, " range"]:
        """Return a number of the ground over range, by its name in `Ground`."""
        return np.array([getattr(one, name) for one in self.ground])

    @property
    def reach_m(self) -> float:
        """Farthest range up to which the cell passes in nine pulses of ten, and more of it is ground than clutter.

        Zero for none.
        """
        passing = self.of_ground("passing")
        lost = np.flatnonzero((passing < SURE) | (self.of_ground("snr") < self.of_ground("clutter")))
        if len(lost) == 0:
            return float(self.range_m[-1])
        if lost[0] == 0:
            return 0.0
        before, after = lost[0] - 1, lost[0]
        if passing[after] >= SURE:
            return float(self.range_m[before])
        return float(np.interp(SURE, passing[[after, before]], self.range_m[[after, before]]))

    @property
    def reaches_the_end(self) -> bool:
        """Whether the sampled ranges end before the reach does."""
        return self.reach_m == float(self.range_m[-1])


ECHO_NOISE = "phase noise of the echo"
# From one side lobe of a window to the next, at up to two bins a cell.
LOBE_BINS = 5


@dataclass(frozen=True, kw_only=True)
class Floors:
    """Mean powers in the bins of the calibrated spectrum, on the scale of the transmitted power.

    echo_m: range of the ground on the beam's axis: from the survey's height at its scan's incidence.
    ground, clutter: its echo, and that of what is in the air before it; terms: of everything else, by its name.
    found: the simulated mean spectrum.
    """

    echo_m: float
    range_m: Float[np.ndarray, " bin"]
    ground: Float[np.ndarray, " bin"]
    clutter: Float[np.ndarray, " bin"]
    terms: dict[str, Float[np.ndarray, " bin"]]
    found: Float[np.ndarray, " bin"]

    @property
    def envelopes(self) -> dict[str, Float[np.ndarray, " bin"]]:
        """The terms without the zeros between the side lobes of the window."""
        return {name: maximum_filter1d(power, LOBE_BINS) for name, power in self.terms.items()}

    def rulers(self) -> list[tuple[str, float, float]]:
        """Return which floor is the highest from which range to which, near to far."""
        names, envelopes = list(self.terms), self.envelopes
        best = np.argmax([envelopes[name] for name in names], axis=0)
        start = np.concatenate([[0], np.flatnonzero(np.diff(best)) + 1])
        stop = np.append(start[1:], len(best)) - 1
        return [
            (names[best[a]], float(self.range_m[a]), float(self.range_m[b])) for a, b in zip(start, stop, strict=True)
        ]


@dataclass(frozen=True, kw_only=True)
class LinkBudget:
    """The links of a scenario's radar.

    floors: under the echo that the survey itself has.
    noise_w, transmit_power_w: of a sample; relative to the transmitted power if that is 1.
    """

    scenario: Scenario
    noise_w: float
    transmit_power_w: float
    floors: Floors
    links: tuple[Link, ...]

    @property
    def physical(self) -> bool:
        """Whether powers are in watts, and not relative to the transmitted one."""
        return self.scenario.radar.transmit_power_dbm is not None

    @property
    def largest_difference_db(self) -> float:
        """Largest difference between simulation and closed form, of what was simulated enough to compare."""
        found = [abs(one.difference_db) for link in self.links for one in link.simulated if one.compared]
        return max(found, default=float("nan"))

    @property
    def agrees(self) -> bool:
        """Whether no compared range differs by more than the tolerance."""
        return not self.largest_difference_db > TOLERANCE_DB

    @property
    def dynamic_range_db(self) -> float:
        """Strongest echo over the weakest that is detected with certainty enough (`SURE`), over all links."""
        found = np.array([one.snr for link in self.links for one in link.ground if one.detection >= SURE])
        return to_db(float(found.max() / found.min())) if len(found) else 0.0
