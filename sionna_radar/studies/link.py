"""The link budget of a radar: signal, noise and probability of detection against range, incidence, material and rain.

Level ground fills the beam; its mean spectrum is known in closed form (`link_case`), and so are the floors under it
(`link_floors`). The signal-to-noise ratio is that of the strongest range cell of the ground, and a cell of speckle is
detected with the probability of a Swerling 1 target. The same ground is then flown over: traced, synthesised, received
and detected by the chain that every survey uses, at a few ranges, and both are compared.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from sionna_radar.detection.cfar import Cfar
from sionna_radar.foundation.errors import Problem, RadarError, ScenarioError
from sionna_radar.foundation.progress import Progress, Steps, silent
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.averaging import refuse_average
from sionna_radar.studies.link_case import STEPS_PER_BIN, Expected, GroundCase
from sionna_radar.studies.link_floors import phase_noise
from sionna_radar.studies.link_result import ECHO_NOISE, Floors, Ground, Link, LinkBudget, Simulated
from sionna_radar.survey.preparation import prepare

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


def link_budget(
    scenario: Scenario,
    *,
    incidences_deg: Sequence[float] = INCIDENCES_DEG,
    rains_mm_per_h: Sequence[float] = RAINS_MM_PER_H,
    pulses: int = PULSES,
    progress: Progress = silent,
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
    progress:
        Called with the stage "link".

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
    step = Steps(progress, "link", len(cases) * len(SIMULATED))
    detected = _detection(prepared.detector.cfar)
    return LinkBudget(
        scenario=scenario,
        noise_w=prepared.receiver.noise_power_w,
        floors=_floors(nominal, pulses),
        transmit_power_w=prepared.receiver.transmit_power_w,
        links=tuple(_link(case, detected, pulses, step) for case in cases),
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


def _link(case: GroundCase, detected: Detected, pulses: int, step: Steps) -> Link:
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
    return replace(link, simulated=tuple(_simulated(case, link, share, detected, pulses, step) for share in SIMULATED))


def _ground(case: GroundCase, expected: Expected, detected: Detected) -> Ground:
    """Return what the closed form says of the ground at one range."""
    (echo, clutter), noise, level = expected.strongest, case.floor[expected.peak], case.level(expected)
    beside = clutter + noise
    ratios = np.array([(echo + beside) / max(level, beside), beside / level, (echo + beside) / level])
    detection, false_alarm, passing = detected(ratios - 1)
    return Ground(
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


def _simulated(case: GroundCase, link: Link, share: float, detected: Detected, pulses: int, step: Steps) -> Simulated:
    """Return what the chain finds at one of the ranges, beside the closed form."""
    range_m = float(link.range_m[round(share * (RANGES - 1))])
    expected, noise = case.expected(range_m), case.floor
    peak, near = expected.peak, expected.half_power
    total, ground = expected.ground + expected.clutter, _ground(case, expected, detected)
    try:
        power, of_cell, of_echo = _flown(case, range_m, pulses, expected)
    except RadarError as error:
        step()
        return Simulated.impossible(range_m, ground, str(error))
    # The echo's strength is fitted to all of its cells within 3 dB, which scatter less than the strongest alone.
    strength = float((power[near] - noise[near]).sum() / total[near].sum())
    wanted = float(total[peak] / noise[peak])
    cells = max(1.0, len(near) / case.prepared.detector.analyser.zero_padding)
    step()
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
    """Return what gives the probability of detection of ratios of signal to noise."""
    known = cfar.detection_probability(10 ** (RATIOS_DB / 10))
    return lambda ratio: np.interp(10 * np.log10(np.maximum(ratio, 1e-12)), RATIOS_DB, known)
