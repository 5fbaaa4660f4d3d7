"""The link budget of a radar: signal, noise and probability of detection against range, incidence, material and rain.

Level ground fills the beam; its mean spectrum is known in closed form (`link_spectra`), and so are the floors under it
(the same). The signal-to-noise ratio is that of the strongest range cell of the ground, and a cell of speckle is
detected with the probability of a Swerling 1 target. The same ground is then flown over: traced, synthesised, received
and detected by the chain that every survey uses, at a few ranges, and both are compared.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.ndimage import maximum_filter1d

from sionna_radar.detection.cfar import Cfar
from sionna_radar.execution.execution import Execution
from sionna_radar.foundation.errors import Problem, RadarError, ScenarioError
from sionna_radar.foundation.numerics import to_db
from sionna_radar.foundation.progress import advance, stage
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.radar import refuse_average
from sionna_radar.studies.link_spectra import STEPS_PER_BIN, Expected, GroundCase, phase_noise
from sionna_radar.survey.preparation import prepare

# Closed form and simulation agree within this; a simulated ratio that scatters by more than half of it says nothing.
TOLERANCE_DB = 0.3
SURE = 0.9


@dataclass(frozen=True, kw_only=True)
class GroundLink:
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
        """Return the values for tables and files, by name; not finite where there is no number."""
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
    ground: "GroundLink"
    found: float
    spread_db: float
    passed: float
    echo_passed: float
    reason: str = ""

    @classmethod
    def impossible(cls, range_m: float, ground: "GroundLink", reason: str) -> "Simulated":
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
    ground: tuple[GroundLink, ...]
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
        """Return the highest floor of each range interval, with the interval's ends, m, near to far."""
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


# Probabilities of detection of ratios of signal to noise.
Detected = Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]]

INCIDENCES_DEG = (15.0, 45.0, 60.0, 75.0)
RAINS_MM_PER_H = (0.0, 10.0)
RANGES = 60
# Places of the simulated ranges, from the nearest to the farthest on a logarithmic scale.
SIMULATED = (0.45, 0.85)
PULSES, PULSES_AT_ONCE = 3000, 500
# Of the sampled ranges the nearest that is looked at; beyond the farthest lie the cells of the CFAR, and these.
NEAREST, SPARE_CELLS = 0.03, 8
# Ratios between which probabilities of detection are interpolated, in decibels.
RATIOS_DB = np.linspace(-30.0, 60.0, 181)


def run_link_budget(
    scenario: Scenario,
    *,
    incidences_deg: Sequence[float] = INCIDENCES_DEG,
    rains_mm_per_h: Sequence[float] = RAINS_MM_PER_H,
    pulses: int = PULSES,
    execution: Execution | None = None,
) -> LinkBudget:
    """Return the link budget of a scenario's radar over each of the materials that its scene uses.

    An antenna's `receives` and polarization must be linear and co-polar.

    Parameters
    ----------
    scenario:
        The survey: its radar, processing, materials and weather count; terrain and flight only where the noise is given
        as `radar.snr_db`.
    incidences_deg:
        Angles of the beam from nadir.
    rains_mm_per_h:
        Rain rates; all else in the air is the scenario's.
    pulses:
        How many are simulated at each range.
    execution:
        As for `sionna_radar.run`.

    Raises
    ------
    ScenarioError
        The scenario cannot be flown, its sensor is no radar, or its antenna does not receive what it sends.

    Examples
    --------
    >>> budget = run_link_budget(load_scenario("hills"), incidences_deg=[45.0], rains_mm_per_h=[0.0], pulses=600)
    >>> budget.largest_difference_db < 1.0
    True

    """
    _check(scenario, incidences_deg, rains_mm_per_h)
    prepared = prepare(scenario)
    if prepared.antenna.circular or prepared.antenna.receives != "co":
        message = "the closed form knows linear co-polar echoes alone; set polarization = 'V'"
        raise ScenarioError([Problem("radar.antenna.polarization", message)])
    used = dict.fromkeys(surface.material for surface in prepared.scene.scene.surfaces)
    cases = [
        GroundCase(prepared=prepared, material=material, incidence_deg=incidence_deg, rain_mm_per_h=rain)
        for material in used
        for incidence_deg in incidences_deg
        for rain in rains_mm_per_h
    ]
    nominal = GroundCase(
        prepared=prepared,
        material=prepared.scene.scene.ground_material,
        incidence_deg=float(np.rad2deg(prepared.flight.scan.incidence_rad)),
        rain_mm_per_h=prepared.local.weather.rain_rate_mm_per_h,
    )
    detected = _detection(prepared.detector.cfar)
    with (execution or Execution()).reported(), stage("link", len(cases) * len(SIMULATED)):
        return LinkBudget(
            scenario=scenario,
            noise_w=prepared.receiver.noise_power_w,
            floors=_floors(nominal, pulses),
            transmit_power_w=prepared.receiver.transmit_power_w,
            links=tuple(_link(case, detected, pulses) for case in cases),
        )


def _check(scenario: Scenario, incidences_deg: Sequence[float], rains_mm_per_h: Sequence[float]) -> None:
    refuse_average(scenario.processing, "a link budget")
    problems = []
    if scenario.sensor != "radar":
        problems.append(Problem("sensor", f"{scenario.sensor!r} has no link budget; set sensor = 'radar'"))
    if scenario.tracing.engine == "path_solver":
        message = "'path_solver' sends too few of its rays into one beam; set 'sionna' or 'gamma'"
        problems.append(Problem("tracing.engine", message))
    wrong = [f"{angle:g}" for angle in incidences_deg if not 0 <= angle <= 85]
    if wrong or not incidences_deg:
        problems.append(Problem("incidence", f"{', '.join(wrong) or 'none'} given; give angles from 0 to 85 deg"))
    wrong = [f"{rate:g}" for rate in rains_mm_per_h if not 0 <= rate <= 300]
    if wrong or not rains_mm_per_h:
        problems.append(Problem("rain", f"{', '.join(wrong) or 'none'} given; give rates from 0 to 300 mm/h"))
    if problems:
        raise ScenarioError(problems)


def _link(case: GroundCase, detected: Detected, pulses: int) -> Link:
    """Return the link budget of a case over range, with what was simulated."""
    chirp, training = case.prepared.receiver.chirp, case.prepared.detector.cfar
    beyond = training.guard + training.training + SPARE_CELLS
    farthest_m = (chirp.max_range_m - beyond * chirp.range_resolution_m) / case.built.scale
    range_m = np.geomspace(min(NEAREST * chirp.max_range_m, farthest_m / 2), farthest_m, RANGES)
    link = Link(
        material=case.material,
        incidence_deg=case.incidence_deg,
        rain_mm_per_h=case.rain_mm_per_h,
        range_m=range_m,
        ground=tuple(_ground(case, case.expected(float(distance)), detected) for distance in range_m),
        simulated=(),
    )
    return replace(link, simulated=tuple(_simulated(case, link, share, detected, pulses) for share in SIMULATED))


def _ground(case: GroundCase, expected: Expected, detected: Detected) -> GroundLink:
    """Return the closed-form SNR, clutter and detection probabilities of the ground at one range."""
    (echo, clutter), noise, level = expected.strongest, case.floor[expected.peak], case.level(expected)
    beside = clutter + noise
    ratios = np.array([(echo + beside) / max(level, beside), beside / level, (echo + beside) / level])
    detection, false_alarm, passing = detected(ratios - 1)
    return GroundLink(
        snr=float(echo / noise),
        clutter=float(clutter / noise),
        detection=float(detection),
        false_alarm=float(false_alarm),
        passing=float(passing),
    )


def _floors(case: GroundCase, pulses: int) -> Floors:
    """Return the floors under the echo of this case from the survey's height, beside simulated pulses."""
    given = case.prepared
    range_m = float(given.flown.altitude_m / np.cos(np.deg2rad(case.incidence_deg)))
    expected, analyser = case.expected(range_m), given.detector.analyser
    terms = dict(case.terms)
    if given.local.radar.receiver.oscillator.levels_dbc_hz:
        # Of ground and air: the spectrum, thinned to as many tones as leave it.
        tones = expected.reaching / case.response[::STEPS_PER_BIN].sum()
        terms[ECHO_NOISE] = phase_noise(given.local.radar, case.built, tones)
    try:
        found = _flown(case, range_m, pulses, expected)[0]
    except RadarError:
        found = np.full(len(analyser.range_m), np.nan)
    return Floors(
        echo_m=range_m,
        range_m=analyser.range_m,
        ground=expected.ground,
        clutter=expected.clutter,
        terms=terms,
        found=found,
    )


def _simulated(case: GroundCase, link: Link, share: float, detected: Detected, pulses: int) -> Simulated:
    """Return the simulated echo of the ground at one of the ranges, beside the closed form."""
    range_m = float(link.range_m[round(share * (RANGES - 1))])
    expected, noise = case.expected(range_m), case.floor
    peak, near = expected.peak, expected.half_power
    total, ground = expected.ground + expected.clutter, _ground(case, expected, detected)
    try:
        power, of_cell, of_echo = _flown(case, range_m, pulses, expected)
    except RadarError as error:
        advance()
        return Simulated.impossible(range_m, ground, str(error))
    # The echo's strength is fitted to all of its cells within 3 dB, which scatter less than the strongest alone.
    strength = float((power[near] - noise[near]).sum() / total[near].sum())
    wanted = float(total[peak] / noise[peak])
    cells = max(1.0, len(near) / case.prepared.detector.analyser.zero_padding)
    advance()
    return Simulated(
        range_m=range_m,
        ground=ground,
        found=wanted * strength,
        spread_db=float(10 / np.log(10) * (1 + 1 / wanted) / np.sqrt(pulses * cells)),
        passed=of_cell,
        echo_passed=of_echo,
    )


def _flown(
    case: GroundCase, range_m: float, pulses: int, expected: Expected
) -> tuple[Float[np.ndarray, " bin"], float, float]:
    """Return the mean spectrum of simulated pulses, and the shares of them whose peak, and echo, passes."""
    prepared = case.over_plane(range_m, pulses)
    receiver = replace(
        prepared.receiver,
        noise_power_w=case.prepared.receiver.noise_power_w,
        transmit_power_w=case.prepared.receiver.transmit_power_w,
    )
    tracer, detector = prepared.sensor_inputs().tracer(), prepared.detector
    total, of_cell, of_echo = np.zeros(len(detector.analyser.range_m)), 0, 0
    for first in range(0, pulses, PULSES_AT_ONCE):
        block = prepared.flight.pulses(np.arange(first, min(first + PULSES_AT_ONCE, pulses)))
        beat = receiver.beat(tracer.trace(block), block)
        if case.prepared.local.processing.leakage == "subtract":
            beat = beat - beat.mean(axis=0)
        spectra = detector.spectra(beat)
        total += spectra.power.sum(axis=0)
        above = spectra.power > spectra.threshold
        of_cell += int(above[:, expected.peak].sum())
        of_echo += int(above[:, expected.half_power].any(axis=1).sum())
    return total / pulses, of_cell / pulses, of_echo / pulses


def _detection(cfar: Cfar) -> Detected:
    """Return the probability of detection as a function of the signal-to-noise ratio."""
    known = cfar.detection_probability(10 ** (RATIOS_DB / 10))
    return lambda ratio: np.interp(10 * np.log10(np.maximum(ratio, 1e-12)), RATIOS_DB, known)
