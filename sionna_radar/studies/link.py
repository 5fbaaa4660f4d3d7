"""The link budget of a radar: signal, noise and probability of detection against range, incidence, material and rain.

Level ground fills the beam. Its mean spectrum is worked out part by part of the beam (`plane_echo_parts`), with the
loss in the air, the window's response, and the echo of what fills the air in front of the ground, moved in range by its
own speed. The signal-to-noise ratio is that of the strongest range cell of the ground, and a cell of speckle is
detected with the probability of a Swerling 1 target. The same ground is then flown over: traced, synthesised, received
and detected by the chain that every survey uses, at a few ranges, and both are compared.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.signal import fftconvolve

from sionna_radar.detection.cfar import Cfar
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.errors import Problem, RadarError, ScenarioError
from sionna_radar.foundation.progress import Progress, Steps, silent
from sionna_radar.radar.equation import PlaneEcho, plane_echo_parts
from sionna_radar.scenario import Scenario, parse_scenario
from sionna_radar.scenario.weather import WeatherTable
from sionna_radar.studies.link_result import Link, LinkBudget, Simulated
from sionna_radar.surfaces.radar_material import as_radar_material
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.tracing.effects.atmosphere import build_atmosphere, build_weather
from sionna_radar.tracing.effects.volume_echo import VolumeEcho
from sionna_radar.weather.conditions import Weather
from sionna_radar.weather.path import two_way_attenuation
from sionna_radar.weather.volume import volume_of

INCIDENCES_DEG = (15.0, 45.0, 60.0, 75.0)
RAINS_MM_PER_H = (0.0, 10.0)
RANGES = 60
# Places of the simulated ranges, from the nearest to the farthest on a logarithmic scale.
SIMULATED = (0.45, 0.85)
PULSES, PULSES_AT_ONCE = 3000, 500
# Steps of the closed form in a bin of the spectrum, and how far the window's response is followed, in range cells.
STEPS_PER_BIN, FOLLOWED_CELLS = 4, 24
# Of the sampled ranges the nearest that is looked at; beyond the farthest lie the cells of the CFAR, and these.
NEAREST, SPARE_CELLS = 0.03, 8
# So slow that no echo is moved by its Doppler shift.
SPEED_MPS = 0.01
# Range at which the beam's direction is worked out, and speeds that stand for those of all drops.
NOMINAL_M, FALL_SPEEDS = 10.0, 32
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
        _Case(prepared=prepared, material=material, incidence_deg=incidence_deg, rain_mm_per_h=rain)
        for material in used
        for incidence_deg in incidences_deg
        for rain in rains_mm_per_h
    ]
    step = Steps(progress, "link", len(cases) * len(SIMULATED))
    detected = _detection(prepared.detector.cfar)
    return LinkBudget(
        scenario=scenario,
        noise_w=prepared.receiver.noise_power_w,
        transmit_power_w=prepared.receiver.transmit_power_w,
        links=tuple(case.link(detected, pulses, step) for case in cases),
    )


def _check(scenario: Scenario, incidences_deg: Sequence[float], rains_mm_per_h: Sequence[float]) -> None:
    problems = []
    if scenario.sensor != "radar":
        problems.append(Problem("sensor", f"{scenario.sensor!r} has no link budget; set sensor = 'radar'"))
    wrong = [f"{angle:g}" for angle in incidences_deg if not 0 <= angle <= 85]
    if wrong or not incidences_deg:
        problems.append(Problem("incidence", f"{', '.join(wrong) or 'none'} given; give angles from 0 to 85 deg"))
    wrong = [f"{rate:g}" for rate in rains_mm_per_h if not 0 <= rate <= 300]
    if wrong or not rains_mm_per_h:
        problems.append(Problem("rain", f"{', '.join(wrong) or 'none'} given; give rates from 0 to 300 mm/h"))
    if problems:
        raise ScenarioError(problems)


@dataclass(frozen=True, kw_only=True)
class _Case:
    """One material at one incidence in one rain."""

    prepared: Prepared
    material: str
    incidence_deg: float
    rain_mm_per_h: float

    def link(
        self, detected: Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]], pulses: int, step: Steps
    ) -> Link:
        """Return its link budget over range, with what was simulated."""
        chirp, training = self.prepared.receiver.chirp, self.prepared.detector.cfar
        beyond = training.guard + training.training + SPARE_CELLS
        farthest_m = chirp.max_range_m - beyond * chirp.range_resolution_m
        range_m = np.geomspace(min(NEAREST * chirp.max_range_m, farthest_m / 2), farthest_m, RANGES)
        expected = [self._expected(float(distance)) for distance in range_m]
        noise, cfar = self.noise_in_cell, self.prepared.detector.cfar
        echo, clutter = np.array([each.strongest for each in expected]).T
        link = Link(
            material=self.material,
            incidence_deg=self.incidence_deg,
            rain_mm_per_h=self.rain_mm_per_h,
            range_m=range_m,
            echo=echo / noise,
            clutter=clutter / noise,
            detection=detected(np.array([each.over_level(noise, cfar) for each in expected]) - 1),
            simulated=(),
        )
        return replace(
            link, simulated=tuple(self._simulated(link, share, detected, pulses, step) for share in SIMULATED)
        )

    @cached_property
    def noise_in_cell(self) -> float:
        """Mean power of noise in a bin of the calibrated spectrum, on the scale of the transmitted power."""
        analyser, receiver = self.prepared.detector.analyser, self.prepared.receiver
        # A real beat's positive frequencies carry half of its power, and the calibration makes up for it.
        both = 2.0 if receiver.chirp.sampling == "real" else 1.0
        return float(both * receiver.noise_power_w * np.sum(analyser.window**2))

    @cached_property
    def weather(self) -> WeatherTable:
        """The scenario's weather, with even rain of this case."""
        even = {"rain_rate_mm_per_h": self.rain_mm_per_h, "rain_field": None, "rain_cell": None}
        return self.prepared.local.weather.model_copy(update=even)

    @cached_property
    def _weather(self) -> Weather:
        return build_weather(self.weather, self.prepared.receiver.chirp.carrier_hz)

    @cached_property
    def _pose(self) -> Pose:
        """The radar over the plane."""
        plane = prepare(parse_scenario(_over_plane(self.prepared.scenario, self, NOMINAL_M, 2)))
        return plane.flight.pulses(np.zeros(1, dtype=np.int64)).true

    @cached_property
    def _loss_db_per_km(self) -> float:
        """One-way specific attenuation along the beam."""
        air = build_atmosphere(self.weather, self.prepared.antenna, self.prepared.receiver.chirp, 0)
        return float(air.attenuation_db_per_km(self._pose)[0])

    @cached_property
    def _from_one_metre(self) -> PlaneEcho:
        """The echo of the plane without the air, from a height of one metre."""
        given, backscatter = self.prepared, self.prepared.scene.scene.materials[self.material]
        wavelength_m, tilt_rad = given.receiver.chirp.wavelength_m, float(np.deg2rad(self.incidence_deg))
        return plane_echo_parts(given.antenna, as_radar_material(backscatter).co_polar, wavelength_m, 1.0, tilt_rad)

    def _expected(self, range_m: float) -> "_Expected":
        """Return the mean spectrum of ground at a range on the beam's axis, and of what is in the air before it."""
        given, analyser = self.prepared, self.prepared.detector.analyser
        # From a height h the ranges are h times those from one metre, and the powers over h^2.
        parts, height_m = self._from_one_metre, range_m * float(np.cos(np.deg2rad(self.incidence_deg)))
        part_m = parts.range_m * height_m
        passed = self._passed(part_m) * given.receiver.transmit_power_w / height_m**2
        step_m = analyser.bin_m / STEPS_PER_BIN
        steps = len(analyser.range_m) * STEPS_PER_BIN
        at = np.minimum(np.round(part_m / step_m).astype(np.int64), steps)
        ground = np.bincount(at, parts.power * passed, minlength=steps + 1)[:steps]
        met = np.cumsum(np.bincount(at, parts.beam_share, minlength=steps + 1)[:steps])
        air = self._in_air((np.arange(steps) + 0.5) * step_m, 1 - met) * given.receiver.transmit_power_w
        return _Expected(ground=self._in_bins(ground), clutter=self._in_bins(air))

    @cached_property
    def _volume(self) -> tuple[VolumeEcho, Float[np.ndarray, " speed"]] | None:
        """What fills the air, with speeds along the beam that stand for all of it; None for nothing."""
        volume = volume_of(self._weather)
        if volume is None:
            return None
        boresight, quantile = self._pose.boresight[0], (np.arange(FALL_SPEEDS) + 0.5) / FALL_SPEEDS
        fall_mps = volume.fall_mps(np.zeros((FALL_SPEEDS, 2)), quantile)
        receding_mps = -boresight[2] * fall_mps + boresight @ np.array(self._weather.wind_mps)
        return VolumeEcho(volume, self.prepared.antenna, self.prepared.receiver.chirp, 0), receding_mps

    @cached_property
    def _response(self) -> Float[np.ndarray, " step"]:
        """Response of the window in fine steps of range, one at its peak."""
        analyser = self.prepared.detector.analyser
        per_cell = analyser.zero_padding * STEPS_PER_BIN
        response = analyser.response(FOLLOWED_CELLS * per_cell, per_cell)
        return response / response.max()

    def _in_bins(self, fine: Float[np.ndarray, " step"]) -> Float[np.ndarray, " bin"]:
        """Return the mean spectrum of powers in fine steps of range: each leaves the window's response."""
        spectrum: Float[np.ndarray, " step"] = fftconvolve(fine, self._response, mode="same")
        return np.maximum(spectrum[::STEPS_PER_BIN], 0.0)

    def _in_air(
        self, range_m: Float[np.ndarray, " step"], open_share: Float[np.ndarray, " step"]
    ) -> Float[np.ndarray, " step"]:
        """Return the mean echo of rain, snow, fog or dust by range, as the sweep shows it: particles move.

        open_share: share of the beam that has met no ground up to each range.
        """
        step_m, shown = float(range_m[1] - range_m[0]), np.zeros(len(range_m))
        if self._volume is None:
            return shown
        echo, receding_mps = self._volume
        cell = np.minimum((range_m / echo.cell_m).astype(np.int64), len(echo.cell_power) - 1)
        power = echo.cell_power[cell] * (step_m / echo.cell_m) * open_share * self._passed(range_m)
        for shift in np.round(self.prepared.receiver.chirp.doppler_range_m(receding_mps) / step_m).astype(np.int64):
            first, last = max(shift, 0), min(len(shown) + shift, len(shown))
            shown[first:last] += power[first - shift : last - shift] / FALL_SPEEDS
        return shown

    def _passed(self, range_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the share of an echo's power that the air lets pass, both ways, and a wet radome."""
        if self._weather.clear:
            return np.ones(len(range_m))
        wet = 10 ** (-self._weather.wet_radome_loss_db(self.rain_mm_per_h) / 10)
        return wet * two_way_attenuation(range_m, self._loss_db_per_km)

    def _simulated(
        self,
        link: Link,
        share: float,
        detected: Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]],
        pulses: int,
        step: Steps,
    ) -> Simulated:
        """Return what the chain finds at one of the ranges, beside the closed form."""
        range_m = float(link.range_m[round(share * (RANGES - 1))])
        expected, noise = self._expected(range_m), self.noise_in_cell
        peak, near = expected.peak, expected.half_power
        total = expected.ground + expected.clutter
        try:
            power, of_cell, of_echo = self._flown(range_m, pulses, peak, near)
        except RadarError as error:
            step()
            return Simulated.impossible(range_m, str(error))
        # The echo's strength is fitted to all of its cells within 3 dB, which scatter less than the strongest alone.
        strength = float((power[near] - noise).sum() / total[near].sum())
        wanted = total[peak] / noise
        cells = max(1.0, len(near) / self.prepared.detector.analyser.zero_padding)
        step()
        return Simulated(
            range_m=range_m,
            expected=float(wanted),
            found=float(wanted * strength),
            spread_db=float(10 / np.log(10) * (1 + 1 / wanted) / np.sqrt(pulses * cells)),
            detection=float(detected(np.array([expected.over_level(noise, self.prepared.detector.cfar) - 1]))[0]),
            detected=of_cell,
            echo_detected=of_echo,
        )

    def _flown(
        self, range_m: float, pulses: int, peak: int, near: Int[np.ndarray, " near"]
    ) -> tuple[Float[np.ndarray, " bin"], float, float]:
        """Return the mean spectrum of simulated pulses, and the shares of them that detect a bin, and any of some."""
        prepared = prepare(parse_scenario(_over_plane(self.prepared.scenario, self, range_m, pulses)))
        receiver = replace(
            prepared.receiver,
            noise_power_w=self.prepared.receiver.noise_power_w,
            transmit_power_w=self.prepared.receiver.transmit_power_w,
        )
        tracer, detector = prepared.sensor_inputs().tracer(), prepared.detector
        total, of_cell, of_echo = np.zeros(len(detector.analyser.range_m)), 0, 0
        for first in range(0, pulses, PULSES_AT_ONCE):
            block = prepared.flight.pulses(np.arange(first, min(first + PULSES_AT_ONCE, pulses)))
            spectra = detector.spectra(receiver.beat(tracer.trace(block), block))
            total += spectra.power.sum(axis=0)
            above = spectra.power > spectra.threshold
            of_cell += int(above[:, peak].sum())
            of_echo += int(above[:, near].any(axis=1).sum())
        return total / pulses, of_cell / pulses, of_echo / pulses


@dataclass(frozen=True)
class _Expected:
    """Mean spectra of the ground, and of what is in the air before it."""

    ground: Float[np.ndarray, " bin"]
    clutter: Float[np.ndarray, " bin"]

    @property
    def peak(self) -> int:
        """The strongest bin of the ground."""
        return int(np.argmax(self.ground))

    @property
    def strongest(self) -> tuple[float, float]:
        """Power of ground and of clutter there."""
        return float(self.ground[self.peak]), float(self.clutter[self.peak])

    def over_level(self, noise: float, cfar: Cfar) -> float:
        """Return the strongest bin's mean power over the level that the CFAR reads around it, from all that is there.

        The level's own scatter is taken for that of noise.
        """
        mean = self.ground + self.clutter + noise
        level, _ = cfar.noise_level(mean[None])
        # In even noise the level of means is that noise, whatever the kind of CFAR.
        return float(mean[self.peak] / level[0, self.peak])

    @property
    def half_power(self) -> Int[np.ndarray, " bin"]:
        """The bins within 3 dB of the strongest."""
        return np.flatnonzero(self.ground > self.ground[self.peak] / 2)


def _detection(cfar: Cfar) -> Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, " n"]]:
    """Return what gives the probability of detection of ratios of signal to noise."""
    known = cfar.detection_probability(10 ** (RATIOS_DB / 10))
    return lambda ratio: np.interp(10 * np.log10(np.maximum(ratio, 1e-12)), RATIOS_DB, known)


def _over_plane(scenario: Scenario, case: _Case, range_m: float, pulses: int) -> dict[str, object]:
    """Return the scenario of a radar that all but hovers over level ground of a material."""
    kept = {"seed", "materials", "radar", "processing", "tracing"}
    document = scenario.model_dump(include=kept, exclude_unset=True)
    tilt, size_m = np.deg2rad(case.incidence_deg), 4 * range_m + 100
    radar = document["radar"]
    return {
        **document,
        "description": "link budget",
        "terrain": {"kind": "flat", "size_m": [size_m, size_m], "spacing_m": size_m / 20, "material": case.material},
        "platform": {
            "altitude_m": range_m * float(np.cos(tilt)),
            "speed_mps": SPEED_MPS,
            "length_m": SPEED_MPS * (pulses + 1) / scenario.radar.chirp_rate_hz,
        },
        "radar": {**radar, "scan": {"mode": "fixed", "incidence_deg": case.incidence_deg}},
        "weather": case.weather.model_dump(exclude_unset=True),
        "tracing": {**document.get("tracing", {}), "speckle": "per_pulse", "decorrelation_time_s": None},
        "dem": {"method": "linear"},
    }
