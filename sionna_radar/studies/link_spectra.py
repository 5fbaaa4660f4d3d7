"""Mean spectra in closed form: level ground under a radar, the floors under its echo, and the receiver as built.

The ground has one material at one incidence in one rain. The beam's parts over the plane (`plane_echo_parts`) are each
at a range; what fills the air before them is moved in range by its own speed; the window leaves its response of each.

The floors under an echo are what noise, leakage, oscillator and converter leave in each range cell. All are mean powers
in bins of the calibrated spectrum, on the scale of the transmitted power. A power density S (of one side, W/Hz) leaves
S f_s sum w^2 in a bin, w the weights of the window with a sum of one: that is the noise bandwidth of a cell. A tone of
power P and delay tau leaves, beside itself, 4 sin^2(pi f tau) L(f) P at the offset f from its beat. What leaks has
nearly no beat, and a phase of its own: of a real signal the two side bands of the oscillator's noise meet in the same
cells, and what is in phase with the leakage does not change it. So its waves are followed one by one.

A receiver as built changes mean spectra by its reference, its anti-alias filter and unlike parts of I/Q samples. A
reference that is off scales all ranges. Sampling reads every frequency that is a whole number of sampling rates from a
bin's as the bin's own, and the anti-alias filter weighs each by its response; the calibration divides by the high-pass
in the bin, whatever it let pass of them. Parts of I/Q samples that differ leave an image of each beat f at f_s - f.
Stages of a plug-in are taken for ideal ones.
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
from sionna_radar.radar.equation import PlaneEcho, plane_echo_parts
from sionna_radar.scenario import parse_scenario
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.scenario.receiver import LeakageTable
from sionna_radar.scenario.weather import WeatherTable
from sionna_radar.signal.analog_filters import AntiAlias
from sionna_radar.signal.beat import phase_polynomial
from sionna_radar.signal.converter import Converter, Imbalance, rounding_step
from sionna_radar.signal.filters import Filters
from sionna_radar.signal.mixer import Mixer
from sionna_radar.signal.oscillator import PhaseNoise
from sionna_radar.signal.receiver import Receiver
from sionna_radar.surfaces.radar_material import as_radar_material
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.tracing.effects.atmosphere import build_atmosphere, build_weather
from sionna_radar.tracing.effects.volume_echo import VolumeEcho
from sionna_radar.weather.conditions import Weather
from sionna_radar.weather.path import two_way_attenuation
from sionna_radar.weather.volume import volume_of

# Powers at frequencies, which are counted in bins.
Spectrum = Callable[[Int[np.ndarray, " bin"]], Float[np.ndarray, " bin"]]
# Of what the high-pass leaves in a bin, by which the calibration divides.
MIN_PASSED = 1e-12


@dataclass(frozen=True)
class Alias:
    """Frequencies that are read as those of the bins, counted in bins, and what of their power is read there."""

    number: Int[np.ndarray, " bin"]
    share: Float[np.ndarray, " bin"]


@dataclass(frozen=True)
class BuiltReceiver:
    """A receiver in closed form, and what makes spectra of its samples."""

    receiver: Receiver
    analyser: SpectrumAnalyser

    @property
    def scale(self) -> float:
        """Ranges that are read over true ones."""
        return next((stage.oscillator.scale for stage in self._stages if isinstance(stage, Mixer)), 1.0)

    @cached_property
    def aliases(self) -> tuple[Alias, ...]:
        """The bins' own frequencies, and those that fold onto them; real signals have both signs of each."""
        analyser, own = self.analyser, np.arange(len(self.analyser.range_m))
        chain, anti_alias = self.receiver.chain, self._anti_alias
        if chain is None or anti_alias is None:
            return (Alias(own, np.ones(len(own))),)
        chirp, high_pass = analyser.chirp, analyser.high_pass
        (lowest_hz, end_hz), period = chain.grid(chirp).band_hz, chirp.samples * analyser.zero_padding
        found, most = [], chain.oversampling // 2
        for turn in range(-most, most + 1):
            number = own + turn * period
            beat_hz = number * (chirp.sampling_rate_hz / period)
            share = np.where(
                (beat_hz >= lowest_hz) & (beat_hz < end_hz), np.abs(anti_alias.response(beat_hz)) ** 2, 0.0
            )
            if turn and high_pass is not None:
                share *= high_pass.power_response(beat_hz) / np.maximum(analyser.passed_power, MIN_PASSED)
            found.append(Alias(np.abs(number) if chirp.sampling == "real" else number, share))
        return tuple(found)

    @property
    def reach(self) -> int:
        """Bins from zero on, those beyond the sampled band too, of which anything is read."""
        return 1 + max(int(alias.number[alias.share > 0].max(initial=-1)) for alias in self.aliases)

    def sampled(self, power: Spectrum) -> Float[np.ndarray, " bin"]:
        """Return the spectrum that is read of one in front of the filters, given at frequencies in bins."""
        read = np.zeros(len(self.analyser.range_m))
        for alias in self.aliases:
            read += alias.share * power(alias.number)
        if self.imbalance is None:
            return read
        passed = np.maximum(self.analyser.passed_power, MIN_PASSED)
        # The image of the n-th bin is the n-th from the end of the band, which is that of zero.
        image = np.roll((read * passed)[::-1], 1) / passed
        return abs(self.imbalance.own) ** 2 * read + abs(self.imbalance.image) ** 2 * image

    def tones(self, beat_hz: Float[np.ndarray, " tone"]) -> Complex[np.ndarray, " tone"]:
        """Return the response of all filters to beats."""
        response = np.ones(len(beat_hz), dtype=np.complex128)
        for each in (self.analyser.high_pass, self._anti_alias):
            response = response if each is None else response * each.response(beat_hz)
        return response

    @property
    def imbalance(self) -> Imbalance | None:
        """Of the parts of I/Q samples; None for like ones."""
        return next((stage.imbalance for stage in self._stages if isinstance(stage, Converter)), None)

    @property
    def _anti_alias(self) -> AntiAlias | None:
        return next((stage.anti_alias for stage in self._stages if isinstance(stage, Filters)), None)

    @property
    def _stages(self) -> tuple[object, ...]:
        return () if self.receiver.chain is None else self.receiver.chain.stages


THERMAL, ROUNDING = "thermal noise", "rounding of the converter"
# Of the window around a tone, in range cells.
NEAR_CELLS = 32
# Powers over the greatest one below which a tone's phase noise is left out.
NO_TONE = 1e-6
LEAKAGE, LEAKAGE_NOISE = "leakage", "phase noise of the leakage"


def floors_of(
    radar: RadarTable, receiver: Receiver, analyser: SpectrumAnalyser
) -> dict[str, Float[np.ndarray, " bin"]]:
    """Return the floors of a radar that hears no echo, by their names; those that it does not have are left out.

    Rounding is taken for white noise, which it is where signal or noise exceed a step; that of a gain control is left
    out, since it depends on what is received. Stages of a plug-in are taken for ideal ones.
    """
    built = BuiltReceiver(receiver, analyser)
    noise_w = receiver.noise_power_w * in_cell(analyser)
    found = {THERMAL: built.sampled(lambda number: np.full(len(number), noise_w))}
    step = rounding_step(radar, receiver)
    if step is not None:
        parts = 1 if receiver.chirp.sampling == "real" else 2
        # It comes behind the high-pass, whose response the calibration divides out.
        found[ROUNDING] = parts * step**2 / 12 * in_cell(analyser) / np.maximum(analyser.passed_power, MIN_PASSED)
    ways = radar.receiver.leakage
    if ways and "leakage" not in radar.receiver.stages:
        found[LEAKAGE] = _still(ways, radar, built)
        if radar.receiver.oscillator.levels_dbc_hz:
            found[LEAKAGE_NOISE] = _leakage_noise(ways, radar, built)
    return found


def in_cell(analyser: SpectrumAnalyser) -> float:
    """Return the power in a bin over that of white noise in a sample."""
    # A real beat's positive frequencies carry half of its power, and the calibration makes up for it.
    both = 2.0 if analyser.chirp.sampling == "real" else 1.0
    return float(both * np.sum(analyser.window**2))


def phase_noise(
    radar: RadarTable, built: BuiltReceiver, power_w: Float[np.ndarray, " reach"]
) -> Float[np.ndarray, " bin"]:
    """Return the mean phase-noise power in all bins, of tones at the ranges of bins, those beyond the band too."""
    levels, analyser = radar.receiver.oscillator.levels_dbc_hz, built.analyser
    chirp = analyser.chirp
    if not levels:
        return np.zeros(len(analyser.range_m))
    noise, tone_m = PhaseNoise(levels), np.arange(len(power_w)) * analyser.bin_m
    tone_hz, own = tone_m * chirp.beat_per_metre_hz, np.flatnonzero(power_w > NO_TONE * power_w.max())

    def density(number: Int[np.ndarray, " bin"]) -> Float[np.ndarray, " bin"]:
        beat_hz, left = number * analyser.bin_m * chirp.beat_per_metre_hz, np.zeros(len(number))
        for tone in own:
            delay_s = 2 * tone_m[tone] / speed_of_light
            # A real beat's negative frequencies are folded onto positive ones.
            for sign in (-1, 1) if chirp.sampling == "real" else (-1,):
                offset_hz = np.abs(beat_hz + sign * tone_hz[tone])
                left += power_w[tone] * 4 * np.sin(np.pi * offset_hz * delay_s) ** 2 * noise.density(offset_hz)
        return left

    return built.sampled(density) * chirp.sampling_rate_hz * float(np.sum(analyser.window**2))


def _still(ways: tuple[LeakageTable, ...], radar: RadarTable, built: BuiltReceiver) -> Float[np.ndarray, " bin"]:
    """Return the spectrum of what leaks through an oscillator without phase noise: the same in every chirp."""
    analyser, (delay_s, tone) = built.analyser, _tones(ways, radar, built.receiver, built.analyser)
    beat_hz = phase_polynomial(delay_s, np.zeros(len(ways)), analyser.chirp).frequency_hz
    beat = (tone * built.tones(beat_hz)[:, None]).sum(axis=0, keepdims=True)
    if built.imbalance is not None:
        beat = built.imbalance(beat)
    return analyser.power(beat if analyser.chirp.sampling == "iq" else np.sqrt(2) * beat.real)[0]


def _tones(
    ways: tuple[LeakageTable, ...], radar: RadarTable, receiver: Receiver, analyser: SpectrumAnalyser
) -> tuple[Float[np.ndarray, " way"], Complex[np.ndarray, "way sample"]]:
    """Return the delay of each way, as it is read, and its tone: of magnitude sqrt(W)."""
    chirp, level_db = analyser.chirp, np.array([way.level_db for way in ways])
    delay_s = radar.receiver.oscillator.scale * 1e-9 * np.array([way.delay_ns for way in ways])
    phase = phase_polynomial(delay_s, np.zeros(len(ways)), chirp)
    turns = phase.constant[:, None] + phase.frequency_hz[:, None] * chirp.sample_time_s
    return delay_s, np.sqrt(receiver.transmit_power_w * 10 ** (level_db[:, None] / 10)) * np.exp(2j * np.pi * turns)


def _leakage_noise(
    ways: tuple[LeakageTable, ...], radar: RadarTable, built: BuiltReceiver
) -> Float[np.ndarray, " bin"]:
    """Return the mean phase-noise power of the leakage in each bin.

    A wave of its phase at the offset f changes the tone of each way by j (1 - exp(-2 pi j f tau)) times the wave, and
    the spectrum by that times the tone's own, moved by f; waves of different offsets add up in power.
    """
    analyser = built.analyser
    chirp, levels = analyser.chirp, radar.receiver.oscillator.levels_dbc_hz
    delay_s, tone = _tones(ways, radar, built.receiver, analyser)
    # A real beat is the cosine of its phase; the calibration makes up for its negative frequencies.
    change = 1j * tone if chirp.sampling == "iq" else -2 * tone.imag
    step_hz = chirp.sampling_rate_hz / (chirp.samples * analyser.zero_padding)
    reach = int(np.ceil(np.max(np.abs(delay_s)) * abs(chirp.slope_hz_s) / step_hz)) + NEAR_CELLS * analyser.zero_padding
    moved = np.arange(-reach, reach + 1)
    waves = np.exp(-2j * np.pi * np.outer(moved * step_hz, chirp.sample_time_s)) * analyser.window
    own = np.einsum("ws,ms->wm", change, waves)
    bins = max(int(np.abs(alias.number).max()) + 1 for alias in built.aliases)
    number = np.arange(-bins - 2 * reach, bins + 2 * reach + 1)
    offset_hz = number * step_hz
    density = PhaseNoise(levels).density(np.abs(offset_hz)) * step_hz
    gone = 1 - np.exp(-2j * np.pi * delay_s[:, None] * offset_hz)
    left = np.zeros(len(number) + len(moved) - 1)
    for a in range(len(ways)):
        for b in range(len(ways)):
            left += fftconvolve(density * gone[a] * np.conj(gone[b]), own[a] * np.conj(own[b])).real
    return built.sampled(lambda number: np.maximum(left[number + (bins + 3 * reach)], 0.0))


# Steps of the closed form in a bin of the spectrum, and how far the window's response is followed, in range cells.
STEPS_PER_BIN, FOLLOWED_CELLS = 4, 24
# So slow that no echo is moved by its Doppler shift.
SPEED_MPS = 0.01
# Range at which the beam's direction is worked out, and speeds that stand for those of all drops.
NOMINAL_M, FALL_SPEEDS = 10.0, 32


@dataclass(frozen=True, kw_only=True)
class GroundCase:
    """One material at one incidence in one rain.

    prepared: the survey whose radar it is.
    """

    prepared: Prepared
    material: str
    incidence_deg: float
    rain_mm_per_h: float

    @cached_property
    def terms(self) -> dict[str, Float[np.ndarray, " bin"]]:
        """Mean powers in the bins of the calibrated spectrum without any echo, by what they come from."""
        given = self.prepared
        found = floors_of(given.local.radar, given.receiver, given.detector.analyser)
        if given.local.processing.leakage == "subtract":
            found.pop(LEAKAGE, None)
        return found

    @cached_property
    def floor(self) -> Float[np.ndarray, " bin"]:
        """All of them together."""
        return np.sum(list(self.terms.values()), axis=0)

    @cached_property
    def weather(self) -> WeatherTable:
        """The scenario's weather, with even rain of this rate."""
        even = {"rain_rate_mm_per_h": self.rain_mm_per_h, "rain_field": None, "rain_cell": None}
        return self.prepared.local.weather.model_copy(update=even)

    @cached_property
    def _weather(self) -> Weather:
        return build_weather(self.weather, self.prepared.receiver.chirp.carrier_hz)

    @cached_property
    def _pose(self) -> Pose:
        """The radar over the plane."""
        return self.over_plane(NOMINAL_M, 2).flight.pulses(np.zeros(1, dtype=np.int64)).true

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

    def expected(self, range_m: float) -> "Expected":
        """Return the mean spectrum of ground at a range on the beam's axis, and of what is in the air before it."""
        given, analyser = self.prepared, self.prepared.detector.analyser
        # From a height h the ranges are h times those from one metre, and the powers over h^2.
        parts, height_m = self._from_one_metre, range_m * float(np.cos(np.deg2rad(self.incidence_deg)))
        part_m = parts.range_m * height_m
        passed = self._passed(part_m) * given.receiver.transmit_power_w / height_m**2
        step_m, steps, scale = analyser.bin_m / STEPS_PER_BIN, self.built.reach * STEPS_PER_BIN, self.built.scale
        at = np.minimum(np.round(part_m * scale / step_m).astype(np.int64), steps)
        ground = np.bincount(at, parts.power * passed, minlength=steps + 1)[:steps]
        met = np.cumsum(np.bincount(at, parts.beam_share, minlength=steps + 1)[:steps])
        air = self._in_air((np.arange(steps) + 0.5) * step_m / scale, 1 - met) * given.receiver.transmit_power_w
        reaching, floating = self._in_bins(ground), self._in_bins(air)
        return Expected(ground=self._sampled(reaching), clutter=self._sampled(floating), reaching=reaching + floating)

    @cached_property
    def built(self) -> BuiltReceiver:
        """The receiver."""
        return BuiltReceiver(self.prepared.receiver, self.prepared.detector.analyser)

    def _sampled(self, power: Float[np.ndarray, " reach"]) -> Float[np.ndarray, " bin"]:
        """Return the spectrum that is read of echoes, which have no beats below zero."""
        held = np.append(power, 0.0)
        return self.built.sampled(lambda number: held[np.where((number >= 0) & (number < len(power)), number, -1)])

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
    def response(self) -> Float[np.ndarray, " step"]:
        """Response of the window in fine steps of range, one at its peak."""
        analyser = self.prepared.detector.analyser
        per_cell = analyser.zero_padding * STEPS_PER_BIN
        response = analyser.response(FOLLOWED_CELLS * per_cell, per_cell)
        return response / response.max()

    def _in_bins(self, fine: Float[np.ndarray, " step"]) -> Float[np.ndarray, " bin"]:
        """Return the mean spectrum of powers in fine steps of range: each leaves the window's response."""
        spectrum: Float[np.ndarray, " step"] = fftconvolve(fine, self.response, mode="same")
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
        # Nothing in the air is traced beyond the greatest range.
        traced = range_m < len(echo.cell_power) * echo.cell_m
        power = traced * echo.cell_power[cell] * (step_m / echo.cell_m) * open_share * self._passed(range_m)
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

    def level(self, expected: "Expected") -> float:
        """Return the level that the CFAR reads around the strongest bin, from all that is there.

        Its own scatter is taken for that of noise; in even noise the level of means is that noise, for each kind of
        CFAR.
        """
        level, _ = self.prepared.detector.cfar.noise_level((expected.ground + expected.clutter + self.floor)[None])
        return float(max(level[0, expected.peak], np.finfo(float).tiny))

    def over_plane(self, range_m: float, pulses: int) -> Prepared:
        """Return a survey by the radar that all but hovers over level ground of the material."""
        scenario = self.prepared.scenario
        kept = {"seed", "materials", "radar", "processing", "tracing"}
        document = scenario.model_dump(include=kept, exclude_unset=True)
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
    """Mean spectra of the ground, and of what is in the air before it.

    reaching: both together in front of the filters, beyond the sampled band too.
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
        """Power of ground and of clutter there."""
        return float(self.ground[self.peak]), float(self.clutter[self.peak])

    @property
    def half_power(self) -> Int[np.ndarray, " bin"]:
        """The bins within 3 dB of the strongest."""
        return np.flatnonzero(self.ground > self.ground[self.peak] / 2)
