"""Mean spectra in closed form: level ground under a radar, the floors under its echo, and the receiver as built.

The ground has one material, incidence and rain rate. The beam's parts over the plane (`plane_echo_contributions`) are
each at a range; volume clutter before them is shifted in range by its own speed; each power is spread by the window's
response.

The floors under an echo are the powers of noise, leakage, oscillator and converter in each range cell. All are mean
powers in bins of the calibrated spectrum, on the scale of the transmitted power. A one-sided power density S (W/Hz)
gives S f_s sum w^2 in a bin, w the weights of the window with a sum of one: that is the noise bandwidth of a cell. A
tone of power P and delay tau has the phase noise 4 sin^2(pi f tau) L(f) P at the offset f from its beat. Leakage has a
beat near zero, and a fixed phase: in a real signal the two side bands of the oscillator's noise overlap in the same
cells, and noise in phase with the leakage cancels. So its noise waves are summed coherently.

A receiver as built changes mean spectra by its reference, its anti-alias filter and I/Q imbalance. A reference offset
scales all ranges. Sampling folds every frequency that is a whole number of sampling rates from a bin's onto the bin,
and the anti-alias filter weights each by its response; the calibration divides by the high-pass in the bin, whatever
its response to them. I/Q imbalance leaves an image of each beat f at f_s - f. Stages of a plug-in are assumed ideal.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.constants import speed_of_light
from scipy.signal import fftconvolve

from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.flight.pulses import Pose
from sionna_radar.radar.equation import PlaneEcho, plane_echo_contributions
from sionna_radar.scenario import parse_scenario
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.scenario.receiver import LeakageTable
from sionna_radar.scenario.weather import WeatherTable
from sionna_radar.signal.analog_filters import AntiAlias, Filters
from sionna_radar.signal.beat import phase_polynomial
from sionna_radar.signal.build import rounding_step
from sionna_radar.signal.converter import Converter, Imbalance
from sionna_radar.signal.mixer import Mixer
from sionna_radar.signal.oscillator import PhaseNoise
from sionna_radar.signal.receiver import Receiver
from sionna_radar.surfaces.radar_material import as_radar_material
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.tracing.build import build_atmosphere, build_weather
from sionna_radar.tracing.effects.volume_echo import VolumeEcho
from sionna_radar.weather.conditions import Weather, volume_of
from sionna_radar.weather.path import two_way_attenuation

# Powers at frequencies, in bins.
Spectrum = Callable[[Int[np.ndarray, " bin"]], Float[np.ndarray, " bin"]]
# Minimum power response of the high-pass in a bin, by which the calibration divides.
MIN_PASSED = 1e-12


@dataclass(frozen=True)
class Alias:
    """Frequencies folded onto the bins, counted in bins, and the fraction of their power read there."""

    number: Int[np.ndarray, " bin"]
    passed: Float[np.ndarray, " bin"]


@dataclass(frozen=True)
class BuiltReceiver:
    """A receiver in closed form, with the spectrum analyser of its samples."""

    receiver: Receiver
    analyser: SpectrumAnalyser

    @property
    def scale(self) -> float:
        """Ratio of measured to true ranges."""
        return next((stage.oscillator.scale for stage in self._stages if isinstance(stage, Mixer)), 1.0)

    @cached_property
    def aliases(self) -> tuple[Alias, ...]:
        """The bins' own frequencies, and those folded onto them; real signals have both signs of each."""
        analyser, bins = self.analyser, np.arange(len(self.analyser.range_m))
        chain, anti_alias = self.receiver.chain, self._anti_alias
        if chain is None or anti_alias is None:
            return (Alias(bins, np.ones(len(bins))),)
        chirp, high_pass = analyser.chirp, analyser.high_pass
        (lowest_hz, end_hz), period = chain.grid(chirp).band_hz, chirp.samples * analyser.zero_padding
        aliases, max_turn = [], chain.oversampling // 2
        for turn in range(-max_turn, max_turn + 1):
            number = bins + turn * period
            beat_hz = number * (chirp.sampling_rate_hz / period)
            passed = np.where(
                (beat_hz >= lowest_hz) & (beat_hz < end_hz), np.abs(anti_alias.response(beat_hz)) ** 2, 0.0
            )
            if turn and high_pass is not None:
                passed *= high_pass.power_response(beat_hz) / np.maximum(analyser.passed_power, MIN_PASSED)
            aliases.append(Alias(np.abs(number) if chirp.sampling == "real" else number, passed))
        return tuple(aliases)

    @property
    def reach(self) -> int:
        """Number of bins from zero on, beyond the sampled band too, with any power read."""
        return 1 + max(int(alias.number[alias.passed > 0].max(initial=-1)) for alias in self.aliases)

    def sampled(self, power: Spectrum) -> Float[np.ndarray, " bin"]:
        """Return the measured spectrum of one in front of the filters, at frequencies in bins."""
        spectrum = np.zeros(len(self.analyser.range_m))
        for alias in self.aliases:
            spectrum += alias.passed * power(alias.number)
        if self.imbalance is None:
            return spectrum
        passed = np.maximum(self.analyser.passed_power, MIN_PASSED)
        # The image of the n-th bin is the n-th from the end of the band; the end is equivalent to zero.
        image = np.roll((spectrum * passed)[::-1], 1) / passed
        return abs(self.imbalance.tone_gain) ** 2 * spectrum + abs(self.imbalance.image_gain) ** 2 * image

    def tones(self, beat_hz: Float[np.ndarray, " tone"]) -> Complex[np.ndarray, " tone"]:
        """Return the response of all filters to beats."""
        response = np.ones(len(beat_hz), dtype=np.complex128)
        for stage in (self.analyser.high_pass, self._anti_alias):
            response = response if stage is None else response * stage.response(beat_hz)
        return response

    @property
    def imbalance(self) -> Imbalance | None:
        """I/Q imbalance; None for a balanced converter."""
        return next((stage.imbalance for stage in self._stages if isinstance(stage, Converter)), None)

    @property
    def _anti_alias(self) -> AntiAlias | None:
        return next((stage.anti_alias for stage in self._stages if isinstance(stage, Filters)), None)

    @property
    def _stages(self) -> tuple[object, ...]:
        return () if self.receiver.chain is None else self.receiver.chain.stages


THERMAL, ROUNDING = "thermal noise", "rounding of the converter"
# Half-length of the window's response around a tone, in range cells.
NEAR_CELLS = 32
# Power relative to the greatest tone below which a tone's phase noise is neglected.
NO_TONE = 1e-6
LEAKAGE, LEAKAGE_NOISE = "leakage", "phase noise of the leakage"


def floors_of(
    radar: RadarTable, receiver: Receiver, analyser: SpectrumAnalyser
) -> dict[str, Float[np.ndarray, " bin"]]:
    """Return the floors of a radar without echoes, by name; absent ones are left out.

    Rounding is modelled as white noise, valid where signal or noise exceed a step; that of a gain control is left out,
    since it depends on the received signal. Stages of a plug-in are assumed ideal.
    """
    built = BuiltReceiver(receiver, analyser)
    noise_w = receiver.noise_power_w * in_cell(analyser)
    floors = {THERMAL: built.sampled(lambda number: np.full(len(number), noise_w))}
    step = rounding_step(radar, receiver)
    if step is not None:
        channels = 1 if receiver.chirp.sampling == "real" else 2
        # Rounding follows the high-pass, whose response the calibration divides out.
        floors[ROUNDING] = channels * step**2 / 12 * in_cell(analyser) / np.maximum(analyser.passed_power, MIN_PASSED)
    leakages = radar.receiver.leakage
    if leakages and "leakage" not in radar.receiver.stages:
        floors[LEAKAGE] = _still(leakages, radar, built)
        if radar.receiver.oscillator.levels_dbc_hz:
            floors[LEAKAGE_NOISE] = _leakage_noise(leakages, radar, built)
    return floors


def in_cell(analyser: SpectrumAnalyser) -> float:
    """Return the power in a bin over that of white noise in a sample."""
    # A real beat's positive frequencies carry half of its power, which the calibration compensates.
    gain = 2.0 if analyser.chirp.sampling == "real" else 1.0
    return float(gain * np.sum(analyser.window**2))


def phase_noise(
    radar: RadarTable, built: BuiltReceiver, power_w: Float[np.ndarray, " reach"]
) -> Float[np.ndarray, " bin"]:
    """Return the mean phase-noise power in all bins, of tones at the ranges of bins, beyond the band too."""
    levels, analyser = radar.receiver.oscillator.levels_dbc_hz, built.analyser
    chirp = analyser.chirp
    if not levels:
        return np.zeros(len(analyser.range_m))
    noise, tone_m = PhaseNoise(levels), np.arange(len(power_w)) * analyser.bin_m
    tone_hz, tones = tone_m * chirp.beat_per_metre_hz, np.flatnonzero(power_w > NO_TONE * power_w.max())

    def density(number: Int[np.ndarray, " bin"]) -> Float[np.ndarray, " bin"]:
        """Return the density of the phase noise of all tones in range bins, W/Hz."""
        beat_hz, total = number * analyser.bin_m * chirp.beat_per_metre_hz, np.zeros(len(number))
        for tone in tones:
            delay_s = 2 * tone_m[tone] / speed_of_light
            # A real beat's negative frequencies are folded onto positive ones.
            for sign in (-1, 1) if chirp.sampling == "real" else (-1,):
                offset_hz = np.abs(beat_hz + sign * tone_hz[tone])
                total += power_w[tone] * 4 * np.sin(np.pi * offset_hz * delay_s) ** 2 * noise.density(offset_hz)
        return total

    return built.sampled(density) * chirp.sampling_rate_hz * float(np.sum(analyser.window**2))


def _still(leakages: tuple[LeakageTable, ...], radar: RadarTable, built: BuiltReceiver) -> Float[np.ndarray, " bin"]:
    """Return the spectrum of the leakage without phase noise: the same in every chirp."""
    analyser, (delay_s, tone) = built.analyser, _tones(leakages, radar, built.receiver, built.analyser)
    beat_hz = phase_polynomial(delay_s, np.zeros(len(leakages)), analyser.chirp).frequency_hz
    beat = (tone * built.tones(beat_hz)[:, None]).sum(axis=0, keepdims=True)
    if built.imbalance is not None:
        beat = built.imbalance(beat)
    return analyser.power(beat if analyser.chirp.sampling == "iq" else np.sqrt(2) * beat.real)[0]


def _tones(
    leakages: tuple[LeakageTable, ...], radar: RadarTable, receiver: Receiver, analyser: SpectrumAnalyser
) -> tuple[Float[np.ndarray, " leakage"], Complex[np.ndarray, "leakage sample"]]:
    """Return the measured delay of each leakage path, and its tone, sqrt(W)."""
    chirp, level_db = analyser.chirp, np.array([leakage.level_db for leakage in leakages])
    delay_s = radar.receiver.oscillator.scale * 1e-9 * np.array([leakage.delay_ns for leakage in leakages])
    phase = phase_polynomial(delay_s, np.zeros(len(leakages)), chirp)
    turns = phase.constant[:, None] + phase.frequency_hz[:, None] * chirp.sample_time_s
    return delay_s, np.sqrt(receiver.transmit_power_w * 10 ** (level_db[:, None] / 10)) * np.exp(2j * np.pi * turns)


def _leakage_noise(
    leakages: tuple[LeakageTable, ...], radar: RadarTable, built: BuiltReceiver
) -> Float[np.ndarray, " bin"]:
    """Return the mean phase-noise power of the leakage in each bin.

    A phase-noise wave at the offset f changes the tone of each path by j (1 - exp(-2 pi j f tau)) times the wave, and
    the spectrum by that times the tone's spectrum, shifted by f; waves of different offsets add up in power.
    """
    analyser = built.analyser
    chirp, levels = analyser.chirp, radar.receiver.oscillator.levels_dbc_hz
    delay_s, tone = _tones(leakages, radar, built.receiver, analyser)
    # A real beat is the cosine of its phase; the calibration compensates its negative frequencies.
    change = 1j * tone if chirp.sampling == "iq" else -2 * tone.imag
    step_hz = chirp.sampling_rate_hz / (chirp.samples * analyser.zero_padding)
    reach = int(np.ceil(np.max(np.abs(delay_s)) * abs(chirp.slope_hz_s) / step_hz)) + NEAR_CELLS * analyser.zero_padding
    shift = np.arange(-reach, reach + 1)
    waves = np.exp(-2j * np.pi * np.outer(shift * step_hz, chirp.sample_time_s)) * analyser.window
    tone_spectrum = np.einsum("ws,ms->wm", change, waves)
    bins = max(int(np.abs(alias.number).max()) + 1 for alias in built.aliases)
    number = np.arange(-bins - 2 * reach, bins + 2 * reach + 1)
    offset_hz = number * step_hz
    density = PhaseNoise(levels).density(np.abs(offset_hz)) * step_hz
    transfer = 1 - np.exp(-2j * np.pi * delay_s[:, None] * offset_hz)
    spectrum = np.zeros(len(number) + len(shift) - 1)
    for a in range(len(leakages)):
        for b in range(len(leakages)):
            spectrum += fftconvolve(
                density * transfer[a] * np.conj(transfer[b]), tone_spectrum[a] * np.conj(tone_spectrum[b])
            ).real
    return built.sampled(lambda number: np.maximum(spectrum[number + (bins + 3 * reach)], 0.0))


# Steps of the closed form per bin of the spectrum, and half-length of the window's response, in range cells.
STEPS_PER_BIN, FOLLOWED_CELLS = 4, 24
# Slow enough for a negligible Doppler shift.
SPEED_MPS = 0.01
# Range at which the beam's direction is evaluated, and number of speeds that represent all drops.
NOMINAL_M, FALL_SPEEDS = 10.0, 32


@dataclass(frozen=True, kw_only=True)
class GroundCase:
    """One material, incidence and rain rate.

    prepared: the survey of the radar.
    """

    prepared: Prepared
    material: str
    incidence_deg: float
    rain_mm_per_h: float

    @cached_property
    def terms(self) -> dict[str, Float[np.ndarray, " bin"]]:
        """Mean powers in the bins of the calibrated spectrum without any echo, by source."""
        prepared = self.prepared
        floors = floors_of(prepared.local.radar, prepared.receiver, prepared.instrument.detector.analyser)
        if prepared.local.processing.leakage == "subtract":
            floors.pop(LEAKAGE, None)
        return floors

    @cached_property
    def floor(self) -> Float[np.ndarray, " bin"]:
        """Sum of all terms."""
        return np.sum(list(self.terms.values()), axis=0)

    @cached_property
    def weather(self) -> WeatherTable:
        """The scenario's weather, with uniform rain of this rate."""
        even = {"rain_rate_mm_per_h": self.rain_mm_per_h, "rain_field": None, "rain_cell": None}
        return self.prepared.local.weather.model_copy(update=even)

    @cached_property
    def _weather(self) -> Weather:
        return build_weather(self.weather, self.prepared.receiver.chirp.carrier_hz)

    @cached_property
    def _pose(self) -> Pose:
        """Pose of the radar over the plane."""
        return self.over_plane(NOMINAL_M, 2).flight.pulses(np.zeros(1, dtype=np.int64)).true

    @cached_property
    def _loss_db_per_km(self) -> float:
        """One-way specific attenuation along the beam."""
        air = build_atmosphere(self.weather, self.prepared.instrument.antenna, self.prepared.receiver.chirp, 0)
        return float(air.attenuation_db_per_km(self._pose)[0])

    @cached_property
    def _from_one_metre(self) -> PlaneEcho:
        """The echo of the plane without attenuation, from a height of one metre."""
        prepared, backscatter = self.prepared, self.prepared.world.scene.materials[self.material]
        wavelength_m, tilt_rad = prepared.receiver.chirp.wavelength_m, float(np.deg2rad(self.incidence_deg))
        return plane_echo_contributions(
            prepared.instrument.antenna, as_radar_material(backscatter).co_polar, wavelength_m, 1.0, tilt_rad
        )

    def expected(self, range_m: float) -> "Expected":
        """Return the mean spectrum of ground at a range on the beam's axis, and of the volume clutter before it."""
        prepared, analyser = self.prepared, self.prepared.instrument.detector.analyser
        # From a height h the ranges are h times those from one metre, and the powers over h^2.
        echo, height_m = self._from_one_metre, range_m * float(np.cos(np.deg2rad(self.incidence_deg)))
        part_m = echo.range_m * height_m
        passed = self._passed(part_m) * prepared.receiver.transmit_power_w / height_m**2
        step_m, steps, scale = analyser.bin_m / STEPS_PER_BIN, self.built.reach * STEPS_PER_BIN, self.built.scale
        at = np.minimum(np.round(part_m * scale / step_m).astype(np.int64), steps)
        ground = np.bincount(at, echo.power * passed, minlength=steps + 1)[:steps]
        met = np.cumsum(np.bincount(at, echo.beam_fraction, minlength=steps + 1)[:steps])
        air = self._in_air((np.arange(steps) + 0.5) * step_m / scale, 1 - met) * prepared.receiver.transmit_power_w
        reaching, airborne = self._in_bins(ground), self._in_bins(air)
        return Expected(ground=self._sampled(reaching), clutter=self._sampled(airborne), reaching=reaching + airborne)

    @cached_property
    def built(self) -> BuiltReceiver:
        """The receiver."""
        return BuiltReceiver(self.prepared.receiver, self.prepared.instrument.detector.analyser)

    def _sampled(self, power: Float[np.ndarray, " reach"]) -> Float[np.ndarray, " bin"]:
        """Return the measured spectrum of echoes, which have no beats below zero."""
        padded = np.append(power, 0.0)
        return self.built.sampled(lambda number: padded[np.where((number >= 0) & (number < len(power)), number, -1)])

    @cached_property
    def _volume(self) -> tuple[VolumeEcho, Float[np.ndarray, " speed"]] | None:
        """Volume clutter, with representative speeds along the beam; None in clear air."""
        volume = volume_of(self._weather)
        if volume is None:
            return None
        boresight, quantile = self._pose.boresight[0], (np.arange(FALL_SPEEDS) + 0.5) / FALL_SPEEDS
        fall_mps = volume.fall_mps(np.zeros((FALL_SPEEDS, 2)), quantile)
        receding_mps = -boresight[2] * fall_mps + boresight @ np.array(self._weather.wind_mps)
        return VolumeEcho(volume, self.prepared.instrument.antenna, self.prepared.receiver.chirp, 0), receding_mps

    @cached_property
    def response(self) -> Float[np.ndarray, " step"]:
        """Response of the window in fine steps of range, with unit peak."""
        analyser = self.prepared.instrument.detector.analyser
        per_cell = analyser.zero_padding * STEPS_PER_BIN
        response = analyser.response(FOLLOWED_CELLS * per_cell, per_cell)
        return response / response.max()

    def _in_bins(self, fine: Float[np.ndarray, " step"]) -> Float[np.ndarray, " bin"]:
        """Return the mean spectrum of powers in fine steps of range, each spread by the window's response."""
        spectrum: Float[np.ndarray, " step"] = fftconvolve(fine, self.response, mode="same")
        return np.maximum(spectrum[::STEPS_PER_BIN], 0.0)

    def _in_air(
        self, range_m: Float[np.ndarray, " step"], open_fraction: Float[np.ndarray, " step"]
    ) -> Float[np.ndarray, " step"]:
        """Return the mean echo of rain, snow, fog or dust by measured range, shifted by the particles' motion.

        open_fraction: share of the beam without ground up to each range.
        """
        step_m, spectrum = float(range_m[1] - range_m[0]), np.zeros(len(range_m))
        if self._volume is None:
            return spectrum
        echo, receding_mps = self._volume
        cell = np.minimum((range_m / echo.cell_m).astype(np.int64), len(echo.cell_power) - 1)
        # Volume clutter is not traced beyond the greatest range.
        traced = range_m < len(echo.cell_power) * echo.cell_m
        power = traced * echo.cell_power[cell] * (step_m / echo.cell_m) * open_fraction * self._passed(range_m)
        for shift in np.round(self.prepared.receiver.chirp.doppler_range_m(receding_mps) / step_m).astype(np.int64):
            start, stop = max(shift, 0), min(len(spectrum) + shift, len(spectrum))
            spectrum[start:stop] += power[start - shift : stop - shift] / FALL_SPEEDS
        return spectrum

    def _passed(self, range_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the two-way power transmission of the air and a wet radome."""
        if self._weather.clear:
            return np.ones(len(range_m))
        wet = 10 ** (-self._weather.wet_radome_loss_db(self.rain_mm_per_h) / 10)
        return wet * two_way_attenuation(range_m, self._loss_db_per_km)

    def level(self, expected: "Expected") -> float:
        """Return the CFAR's level around the strongest bin, from ground, clutter and floors.

        Its scatter is assumed to be that of noise; in uniform noise the level of means is that noise, for each kind of
        CFAR.
        """
        detector = self.prepared.instrument.detector
        power, rise = expected.ground + expected.clutter + self.floor, detector.analyser.noise_rise
        level, _ = detector.cfar.noise_level(detector.over_floor(power[None]))
        here = level[0, expected.peak] * (1.0 if rise is None else rise[expected.peak])
        return float(max(here, np.finfo(float).tiny))

    def over_plane(self, range_m: float, pulses: int) -> Prepared:
        """Return a survey by the radar, nearly hovering over level ground of the material."""
        scenario = self.prepared.scenario
        included = {"seed", "materials", "radar", "processing", "tracing"}
        document = scenario.model_dump(include=included, exclude_unset=True)
        tilt, size_m = np.deg2rad(self.incidence_deg), 4 * range_m + 100
        radar = document["radar"]
        plane = {
            **document,
            "description": "link budget",
            "terrain": {
                "kind": "flat",
                "size_m": [size_m, size_m],
                "spacing_m": size_m / 20,
                "material": self.material,
            },
            "platform": {
                "altitude_m": range_m * float(np.cos(tilt)),
                "speed_mps": SPEED_MPS,
                "length_m": SPEED_MPS * (pulses + 1) / scenario.radar.mean_rate_hz,
            },
            "radar": {**radar, "scan": {"mode": "fixed", "incidence_deg": self.incidence_deg}},
            "weather": self.weather.model_dump(exclude_unset=True),
            "tracing": {**document.get("tracing", {}), "speckle": "per_pulse", "decorrelation_time_s": None},
            "dem": {"method": "linear"},
        }
        return prepare(parse_scenario(plane))


@dataclass(frozen=True)
class Expected:
    """Mean spectra of the ground, and of the volume clutter before it.

    reaching: sum of both in front of the filters, beyond the sampled band too.
    """

    ground: Float[np.ndarray, " bin"]
    clutter: Float[np.ndarray, " bin"]
    reaching: Float[np.ndarray, " reach"]

    @property
    def peak(self) -> int:
        """The strongest bin of the ground."""
        return int(np.argmax(self.ground))

    @property
    def strongest(self) -> tuple[float, float]:
        """Power of ground and of clutter in that bin."""
        return float(self.ground[self.peak]), float(self.clutter[self.peak])

    @property
    def half_power(self) -> Int[np.ndarray, " bin"]:
        """The bins within 3 dB of the strongest."""
        return np.flatnonzero(self.ground > self.ground[self.peak] / 2)
