"""The link budget of a radar: signal, noise and probability of detection against range, incidence, material and rain.

Level ground fills the beam; its mean spectrum and the floors under it have a closed form (`spectra`). The
signal-to-noise ratio is that of the strongest range cell of the ground, and a cell of speckle is detected with the
probability of a Swerling 1 target. The same ground is then simulated at a few ranges, traced, synthesised, received
and detected by the chain of every survey: for comparison, and for what the survey's own detector finds.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Inexact
from scipy.ndimage import maximum_filter1d

from sionna_radar.detection.cfar import Cfar
from sionna_radar.execution.execution import Execution
from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.decibels import to_db
from sionna_radar.foundation.errors import Problem, RadarError, ScenarioError
from sionna_radar.foundation.progress import advance, stage
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.radar import refuse_average, refuse_gate, refuse_squint
from sionna_radar.scenario.table import SMALLEST
from sionna_radar.studies.link.spectra import STEPS_PER_BIN, Expected, GroundCase, phase_noise
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.survey.sensors.sweeps import SweepDetector

# Tolerance of simulation against closed form; a simulated ratio that scatters by more than half of it is not compared.
TOLERANCE_DB = 0.3
SURE = 0.9


@dataclass(frozen=True, kw_only=True)
class GroundLink:
    """The strongest range cell of the ground at one range, in closed form.

    snr, clutter: mean power of the ground, and of the volume clutter in its cell, over all floors there: noise,
        leakage, rounding.
    detection: probability of detecting the ground in one pulse against noise and clutter: that the cell exceeds the
        CFAR's multiple of the level around it, or of noise and clutter in the cell where these are higher.
    false_alarm: probability that clutter and noise in the cell exceed the CFAR's threshold without the ground.
    passing: probability that all of them exceed it.
    """

    snr: float
    clutter: float
    detection: float
    false_alarm: float
    passing: float

    def numbers(self) -> dict[str, float]:
        """Return the values for tables and files, by name; not finite where undefined."""
        return {
            "ground_snr_db": to_db(self.snr),
            "signal_to_clutter_db": to_db(self.snr / self.clutter) if self.clutter > 0 else float("nan"),
            "detection_probability": self.detection,
            "false_alarm_probability": self.false_alarm,
            "passing_probability": self.passing,
        }


@dataclass(frozen=True, kw_only=True)
class Simulated:
    """One simulated range; not a number where it could not be simulated.

    ground: its closed form.
    found: simulated ratio of ground and clutter to the noise in the strongest range cell.
    spread_db: standard deviation of that ratio, from the number of looks.
    passed: share of pulses in which that cell passes the CFAR.
    echo_passed: share of pulses in which any cell within 3 dB of it does.
    survey_detection: share of pulses in which the survey's own detector finds the ground.
    reason: reason for a missing simulation; empty otherwise.
    """

    range_m: float
    ground: GroundLink
    found: float = float("nan")
    spread_db: float = float("nan")
    passed: float = float("nan")
    echo_passed: float = float("nan")
    survey_detection: float = float("nan")
    reason: str = ""

    @property
    def difference_db(self) -> float:
        """Simulated ratio over closed form; not finite without a simulation, or an echo in it."""
        return to_db(self.found / (self.ground.snr + self.ground.clutter))

    @property
    def compared(self) -> bool:
        """True if the simulated ratio is precise enough to compare."""
        return self.spread_db <= TOLERANCE_DB / 2


@dataclass(frozen=True, kw_only=True)
class Link:
    """Link over range for one material, incidence and rain rate.

    Two detectors are compared. One tests the ground's strongest range cell alone, in closed form. The other is the
    survey's, simulated: in clear air the CFAR over all cells of the echo, behind rain the end of the rain's echo,
    followed from pulse to pulse, so that it finds ground that no cell's power tells from rain.

    survey_reach_m: farthest sampled range up to which the survey's detector finds the ground with `SURE`; not a number
        if it could not be simulated.
    """

    material: str
    incidence_deg: float
    rain_mm_per_h: float
    range_m: Float[np.ndarray, " range"]
    ground: tuple[GroundLink, ...]
    simulated: tuple[Simulated, ...]
    survey_reach_m: float = float("nan")

    def of_ground(self, name: str) -> Float[np.ndarray, " range"]:
        """Return a number of the ground over range, by its name in `GroundLink`."""
        return np.array([getattr(ground, name) for ground in self.ground])

    @property
    def cell_reach_m(self) -> float:
        """Farthest range up to which a range cell alone detects the ground with `SURE`; zero for none."""
        detection = self.of_ground("detection")
        lost = np.flatnonzero(detection < SURE)
        if len(lost) == 0:
            return float(self.range_m[-1])
        if lost[0] == 0:
            return 0.0
        ends = [lost[0], lost[0] - 1]
        return float(np.interp(SURE, detection[ends], self.range_m[ends]))

    @property
    def reaches_the_end(self) -> bool:
        """True if one of the reaches extends to the last sampled range."""
        return float(self.range_m[-1]) in (self.cell_reach_m, self.survey_reach_m)


ECHO_NOISE = "phase noise of the echo"
# Spacing of a window's side lobes, at up to two bins per cell.
LOBE_BINS = 5


@dataclass(frozen=True, kw_only=True)
class Floors:
    """Mean powers in the bins of the calibrated spectrum, on the scale of the transmitted power.

    echo_m: range of the ground on the beam's axis, from the survey's height at its scan's incidence.
    ground, clutter: its echo, and the volume clutter before it; terms: all other powers, by name.
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
        """Envelopes of the terms, without the nulls between the side lobes of the window."""
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

    floors: under the echo of the survey itself.
    noise_w, transmit_power_w: of a sample; relative to the transmitted power if that is 1.
    """

    scenario: Scenario
    noise_w: float
    transmit_power_w: float
    floors: Floors
    links: tuple[Link, ...]

    @property
    def physical(self) -> bool:
        """True for powers in watts, False for powers relative to the transmitted one."""
        return self.scenario.radar.transmit_power_dbm is not None

    @property
    def largest_difference_db(self) -> float:
        """Largest difference between simulation and closed form over the compared ranges."""
        differences_db = [
            abs(simulated.difference_db) for link in self.links for simulated in link.simulated if simulated.compared
        ]
        return max(differences_db, default=float("nan"))

    @property
    def agrees(self) -> bool:
        """True if no compared range differs by more than the tolerance."""
        return not self.largest_difference_db > TOLERANCE_DB

    @property
    def dynamic_range_db(self) -> float:
        """Ratio of the strongest to the weakest echo detected with probability `SURE` or more, over all links."""
        snr = np.array([ground.snr for link in self.links for ground in link.ground if ground.detection >= SURE])
        return to_db(float(snr.max() / snr.min())) if len(snr) else 0.0


# Beat signals of pulses.
Beating = Callable[[Pulses], Inexact[np.ndarray, "pulse sample"]]
# Detection probability as a function of the signal-to-noise ratio.
Detected = Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]]

INCIDENCES_DEG = (15.0, 45.0, 60.0, 75.0)
RAINS_MM_PER_H = (0.0, 10.0)
RANGES = 60
# Positions of the simulated ranges between nearest and farthest, on a logarithmic scale.
SIMULATED = (0.45, 0.85)
PULSES, PULSES_AT_ONCE = 3000, 500
# Pulses in which the survey's detector is tried: a share of 0.9 has a standard deviation of 0.02.
SURVEY_PULSES = 200
# Nearest range as a share of the sampled ones, and spare cells between the farthest range and those of the CFAR.
NEAREST, SPARE_CELLS = 0.03, 8
# Ratios at which detection probabilities are tabulated, in decibels.
RATIOS_DB = np.linspace(-30.0, 60.0, 181)


def link_budget(
    scenario: Scenario,
    *,
    incidences_deg: Sequence[float] = INCIDENCES_DEG,
    rains_mm_per_h: Sequence[float] = RAINS_MM_PER_H,
    pulses: int = PULSES,
    execution: Execution | None = None,
) -> LinkBudget:
    """Return the link budget of a scenario's radar over each material of its scene.

    An antenna's `receives` and polarization must be linear and co-polar.

    Parameters
    ----------
    scenario:
        The survey: its radar, processing, materials and weather matter; terrain and flight only if the noise is given
        as `radar.snr_db`.
    incidences_deg:
        Angles of the beam from nadir.
    rains_mm_per_h:
        Rain rates; other weather is the scenario's.
    pulses:
        Number of simulated pulses at each range.
    execution:
        As for `sionna_radar.run`.

    Returns
    -------
    A link for each material, and the powers of a sample: in watts, or relative to the transmitted power.

    Raises
    ------
    ScenarioError
        The scenario cannot be flown, its sensor is no radar, or its antenna does not receive what it sends.

    Examples
    --------
    >>> budget = link_budget(load_scenario("hills"), incidences_deg=[45.0], rains_mm_per_h=[0.0], pulses=600)
    >>> budget.largest_difference_db < 1.0
    True
    """
    _check(scenario, incidences_deg, rains_mm_per_h)
    prepared = prepare(scenario)
    if prepared.instrument.antenna.circular or prepared.instrument.antenna.receives != "co":
        message = "the closed form covers linear co-polar echoes only; set polarization = 'V'"
        raise ScenarioError.of("radar.antenna.polarization", message)
    materials = dict.fromkeys(surface.material for surface in prepared.world.scene.surfaces)
    cases = [
        GroundCase(prepared=prepared, material=material, incidence_deg=incidence_deg, rain_mm_per_h=rain)
        for material in materials
        for incidence_deg in incidences_deg
        for rain in rains_mm_per_h
    ]
    nominal = GroundCase(
        prepared=prepared,
        material=prepared.world.scene.ground_material,
        incidence_deg=float(np.rad2deg(prepared.flight.scan.incidence_rad)),
        rain_mm_per_h=prepared.local.weather.rain_rate_mm_per_h,
    )
    detected = _detection(prepared.instrument.detector.cfar)
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
    refuse_gate(scenario.radar, "a link budget")
    refuse_squint(scenario.radar, "a link budget")
    problems = []
    if scenario.sensor != "radar":
        problems.append(Problem("sensor", f"{scenario.sensor!r} has no link budget; set sensor = 'radar'"))
    if scenario.tracing.engine == "path_solver":
        message = "'path_solver' sends too few of its rays into one beam; set 'sionna' or 'gamma'"
        problems.append(Problem("tracing.engine", message))
    invalid = [f"{angle:g}" for angle in incidences_deg if not 0 <= angle <= 85]
    if invalid or not incidences_deg:
        problems.append(Problem("incidence", f"{', '.join(invalid) or 'none'} given; give angles from 0 to 85 deg"))
    invalid = [f"{rate:g}" for rate in rains_mm_per_h if rate and not SMALLEST <= rate <= 300]
    if invalid or not rains_mm_per_h:
        problems.append(
            Problem("rain", f"{', '.join(invalid) or 'none'} given; give 0, or rates from {SMALLEST:g} to 300 mm/h")
        )
    if problems:
        raise ScenarioError(problems)


def _link(case: GroundCase, detected: Detected, pulses: int) -> Link:
    """Return the link budget of a case over range, with its simulations."""
    chirp, training = case.prepared.receiver.chirp, case.prepared.instrument.detector.cfar
    margin_cells = training.guard + training.training + SPARE_CELLS
    farthest_m = (chirp.max_range_m - margin_cells * chirp.range_resolution_m) / case.built.scale
    range_m = np.geomspace(min(NEAREST * chirp.max_range_m, farthest_m / 2), farthest_m, RANGES)
    simulated_at = [round(share * (RANGES - 1)) for share in SIMULATED]
    simulated = tuple(_simulated(case, float(range_m[index]), detected, pulses) for index in simulated_at)
    return Link(
        material=case.material,
        incidence_deg=case.incidence_deg,
        rain_mm_per_h=case.rain_mm_per_h,
        range_m=range_m,
        ground=tuple(_ground(case, case.expected(float(distance)), detected) for distance in range_m),
        simulated=simulated,
        survey_reach_m=_survey_reach_m(
            range_m,
            {index: one.survey_detection for index, one in zip(simulated_at, simulated, strict=True)},
            lambda distance_m: _survey_detection(case, distance_m, pulses),
        ),
    )


def _survey_reach_m(
    range_m: Float[np.ndarray, " range"], known: dict[int, float], detection: Callable[[float], float]
) -> float:
    """Return the farthest sampled range up to which the survey's detector finds the ground with `SURE`, by bisection.

    known: its detection probabilities by index of the range; `detection` simulates a further one.
    """
    last = len(range_m) - 1
    lost = next((index for index in sorted(known) if not known[index] >= SURE), None)
    if lost is not None and np.isnan(known[lost]):
        return float("nan")
    if lost is None and detection(float(range_m[last])) >= SURE:
        return float(range_m[last])
    lost = last if lost is None else lost
    sure = max((index for index in known if index < lost), default=-1)
    while lost - sure > 1:
        middle = (sure + lost) // 2
        sure, lost = (middle, lost) if detection(float(range_m[middle])) >= SURE else (sure, middle)
    return float(range_m[sure]) if sure >= 0 else 0.0


def _ground(case: GroundCase, expected: Expected, detected: Detected) -> GroundLink:
    """Return the closed-form SNR, clutter and detection probabilities of the ground at one range."""
    (echo, clutter), noise, level = expected.strongest, case.floor[expected.peak], case.level(expected)
    background = clutter + noise
    ratios = np.array([(echo + background) / max(level, background), background / level, (echo + background) / level])
    detection, false_alarm, passing = detected(ratios - 1)
    return GroundLink(
        snr=float(echo / noise),
        clutter=float(clutter / noise),
        detection=float(detection),
        false_alarm=float(false_alarm),
        passing=float(passing),
    )


def _floors(case: GroundCase, pulses: int) -> Floors:
    """Return the floors under the echo of this case from the survey's height, with a simulated spectrum."""
    prepared = case.prepared
    range_m = float(prepared.plan.flown.altitude_m / np.cos(np.deg2rad(case.incidence_deg)))
    expected, analyser = case.expected(range_m), prepared.instrument.detector.analyser
    terms = dict(case.terms)
    if prepared.local.radar.receiver.oscillator.levels_dbc_hz:
        # Tones of ground and air: their spectrum, normalised by the window's response.
        tones = expected.reaching / case.response[::STEPS_PER_BIN].sum()
        terms[ECHO_NOISE] = phase_noise(prepared.local.radar, case.built, tones)
    try:
        simulated = _flown(case, range_m, pulses, expected)[0]
    except RadarError:
        simulated = np.full(len(analyser.range_m), np.nan)
    return Floors(
        echo_m=range_m,
        range_m=analyser.range_m,
        ground=expected.ground,
        clutter=expected.clutter,
        terms=terms,
        found=simulated,
    )


def _simulated(case: GroundCase, range_m: float, detected: Detected, pulses: int) -> Simulated:
    """Return the simulated echo of the ground at one of the ranges, beside the closed form."""
    expected, noise = case.expected(range_m), case.floor
    peak, echo_bins = expected.peak, expected.half_power
    total, ground = expected.ground + expected.clutter, _ground(case, expected, detected)
    try:
        power, cell_passed, echo_passed = _flown(case, range_m, pulses, expected)
        survey_detection = _survey_detection(case, range_m, pulses)
    except RadarError as error:
        advance()
        return Simulated(range_m=range_m, ground=ground, reason=str(error))
    # Fit the echo's strength to all of its cells within 3 dB, which scatter less than the strongest alone.
    strength = float((power[echo_bins] - noise[echo_bins]).sum() / total[echo_bins].sum())
    expected_ratio = float(total[peak] / noise[peak])
    cells = max(1.0, len(echo_bins) / case.prepared.instrument.detector.analyser.zero_padding)
    advance()
    return Simulated(
        range_m=range_m,
        ground=ground,
        found=expected_ratio * strength,
        spread_db=float(10 / np.log(10) * (1 + 1 / expected_ratio) / np.sqrt(pulses * cells)),
        passed=cell_passed,
        echo_passed=echo_passed,
        survey_detection=survey_detection,
    )


def _flown(
    case: GroundCase, range_m: float, pulses: int, expected: Expected
) -> tuple[Float[np.ndarray, " bin"], float, float]:
    """Return the mean spectrum of simulated pulses, and the shares with a passing peak and a passing echo."""
    prepared, beat_of = _hovering(case, range_m, pulses)
    detector = prepared.instrument.detector
    total, cell_passes, echo_passes = np.zeros(len(detector.analyser.range_m)), 0, 0
    for start in range(0, pulses, PULSES_AT_ONCE):
        block = prepared.flight.pulses(np.arange(start, min(start + PULSES_AT_ONCE, pulses)))
        beat = beat_of(block)
        if case.prepared.local.processing.leakage == "subtract":
            beat = beat - beat.mean(axis=0)
        spectra = detector.spectra(beat)
        total += spectra.power.sum(axis=0)
        passing = spectra.power > spectra.threshold
        cell_passes += int(passing[:, expected.peak].sum())
        echo_passes += int(passing[:, expected.half_power].any(axis=1).sum())
    return total / pulses, cell_passes / pulses, echo_passes / pulses


def _hovering(case: GroundCase, range_m: float, pulses: int) -> tuple[Prepared, Beating]:
    """Return a survey that hovers over level ground at a range, and what returns the beat signals of its pulses."""
    prepared = case.over_plane(range_m, pulses)
    receiver = replace(
        prepared.receiver,
        noise_power_w=case.prepared.receiver.noise_power_w,
        transmit_power_w=case.prepared.receiver.transmit_power_w,
    )
    tracer = prepared.sensor_inputs().tracer()
    return prepared, lambda block: receiver.beat(tracer.trace(block), block)


def _survey_detection(case: GroundCase, range_m: float, pulses: int) -> float:
    """Return the share of pulses in which the survey's detector finds the ground.

    An echo is the ground's if its range is that of the ground in its direction, within half of the echo's width and
    three of its stated standard deviations, of at least a range cell together.
    """
    count = min(pulses, SURVEY_PULSES)
    prepared, beat_of = _hovering(case, range_m, count)
    sweeps = SweepDetector(
        detector=prepared.instrument.detector,
        sweeps=(prepared.receiver.chirp,),
        schedule=prepared.flight,
        expected_ground=None,
        beats=lambda pulses: [beat_of(pulses)],
    )
    block = prepared.flight.pulses(np.arange(count))
    echoes = sweeps.correct(sweeps.detect([beat_of(block)], block).echoes, block.index, block.measured)
    row, pose = block.row_of(echoes.pulse), block.true
    toward = pose.boresight[row]
    if echoes.direction is not None:
        toward = np.einsum("eij,ej->ei", pose.R_world_antenna[row], echoes.direction)
    ground_m = case.built.scale * pose.position_m[row, 2] / np.maximum(-toward[:, 2], SMALLEST)
    width_m = prepared.instrument.detector.analyser.bin_m * np.ptp(case.expected(range_m).half_power)
    around_m = np.maximum(3 * echoes.range_sigma_m, prepared.receiver.chirp.range_resolution_m)
    own = np.abs(echoes.range_m - ground_m) <= width_m / 2 + around_m
    return len(np.unique(row[own])) / count


def _detection(cfar: Cfar) -> Detected:
    """Return the probability of detection as a function of the signal-to-noise ratio."""
    probability = cfar.detection_probability(10 ** (RATIOS_DB / 10))
    return lambda ratio: np.interp(10 * np.log10(np.maximum(ratio, 1e-12)), RATIOS_DB, probability)
