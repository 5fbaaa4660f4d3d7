"""Builder of the receiver (stages, filters, powers, noise) and of the lidar receiver from a scenario."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.constants import Boltzmann

from sionna_radar.foundation.decibels import from_db
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario.bases import StageParameters
from sionna_radar.scenario.lidar import LidarTable
from sionna_radar.scenario.parts import RECEIVER_STAGES
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.scenario.receiver import Interferer, OscillatorTable, Place, ReceiverTable
from sionna_radar.scenario.registry import Builder, registers
from sionna_radar.scenario.weather import WeatherTable
from sionna_radar.signal.analog_filters import AntiAlias, Filters, HighPass, RangeGain, SampledNoise
from sionna_radar.signal.converter import Converter, Imbalance
from sionna_radar.signal.lidar import LidarReceiver
from sionna_radar.signal.lidar_waveform import WaveformReceiver
from sionna_radar.signal.mixer import Interference, Leakage, Mixer, OtherRadar
from sionna_radar.signal.oscillator import Oscillator, PhaseNoise, SweepError, read_sweep_error
from sionna_radar.signal.receiver import Receiver, noisy
from sionna_radar.signal.stages import Chain, ReceiverStage
from sionna_radar.weather.optical import OpticalAir, optical_air

# In the order of the signal path.
ORDER: tuple[Place, ...] = ("leakage", "mixer", "interference", "noise", "filters", "converter")


@dataclass(frozen=True, kw_only=True)
class StageInputs:
    """Inputs to the builder of a stage.

    radar: the radar of the scenario.
    sweeps: of a pulse.
    high_pass, anti_alias: of the receiver; None if it has none.
    interference: adds what other radars radiate; None if there are none.
    """

    radar: RadarTable
    sweeps: tuple[Chirp, ...]
    high_pass: HighPass | None
    anti_alias: AntiAlias | None = None
    interference: ReceiverStage | None = None


@registers(RECEIVER_STAGES, "[radar.receiver.stages.NAME]")
def register_receiver_stage(name: str, parameters: type[StageParameters]) -> Callable[[Builder], Builder]:
    """Register a stage of the receiver, for `radar.receiver.stages` in a scenario.

    It decorates a class or function that builds a `ReceiverStage`; it is called with the parameters, and with
    `StageInputs`.

    Examples
    --------
    >>> import dataclasses
    >>> from sionna_radar.scenario import StageParameters
    >>> @register_receiver_stage("deaf", StageParameters)
    ... def deaf(parameters, inputs):
    ...     return lambda received: dataclasses.replace(received, noise=0.0 * received.samples)
    >>> load_scenario("hills", {"radar.receiver.stages.noise": "deaf"}).radar.receiver.stages["noise"].stage
    'deaf'
    """
    return RECEIVER_STAGES.register(name, parameters)


# Samples over which a signal fades in and out; residual of a filter's transient when sampling begins.
FADE_SAMPLES, SETTLED = 64, 1e-4
# Largest guard, in sweeps.
LONGEST_GUARD = 2
# Points per sample before an anti-alias filter, and its largest power response at the edge of their band.
OVERSAMPLINGS, PASSED = (2, 4, 8), 1e-4
# Points per sample with interference of other radars.
CROSSING = 4
# Samples of a lidar's waveform: at 5 ns 32 km.
MOST_SAMPLES = 100_000


def build_chain(
    radar: RadarTable,
    sweeps: tuple[Chirp, ...],
    high_pass: HighPass | None,
    interference: ReceiverStage | None = None,
) -> Chain | None:
    """Return the stages of a scenario's receiver; None for an ideal one with only noise and a high-pass."""
    anti_alias = build_anti_alias(radar.receiver, sweeps[0])
    inputs = StageInputs(
        radar=radar, sweeps=sweeps, high_pass=high_pass, anti_alias=anti_alias, interference=interference
    )
    if not _real(inputs):
        return None
    stages = []
    for slot in ORDER:
        chosen = radar.receiver.stages.get(slot) or StageParameters(stage=slot)
        stages.append(RECEIVER_STAGES.build(chosen.stage, ReceiverStage, chosen, inputs))
    oversampling = _oversampling(inputs)
    return Chain(
        stages=tuple(stages),
        oversampling=oversampling,
        guard=_guard(high_pass, anti_alias, sweeps[0], oversampling),
        noise_points=1 if anti_alias is None else oversampling,
    )


def _real(inputs: StageInputs) -> bool:
    """Return True if a receiver has other effects than noise and a high-pass."""
    receiver = inputs.radar.receiver
    oscillator, converter = receiver.oscillator, receiver.converter
    effects = (
        oscillator.bent,
        oscillator.levels_dbc_hz,
        oscillator.scale != 1,
        converter.limited,
        converter.imbalanced,
    )
    return any((*effects, receiver.leakage, receiver.stages, inputs.anti_alias, inputs.interference))


def _oversampling(inputs: StageInputs) -> int:
    """Return the points per sample required by the effects of a receiver."""
    oscillator, anti_alias = inputs.radar.receiver.oscillator, inputs.anti_alias
    # Twice the sampling rate covers every sideband of an in-band echo that an ideal filter passes.

    minimum = 2 if oscillator.bent or oscillator.levels_dbc_hz else 1
    # Bursts are cut off at the ends of the grid's band, far from what is sampled.
    minimum = CROSSING if inputs.interference is not None else minimum
    if anti_alias is None:
        return minimum
    sufficient = (n for n in OVERSAMPLINGS if n >= minimum and anti_alias.left(n) < PASSED)
    return next(sufficient, OVERSAMPLINGS[-1])


def _guard(high_pass: HighPass | None, anti_alias: AntiAlias | None, chirp: Chirp, oversampling: int) -> int:
    """Return the samples before the first one: half of them to fade in, half for filters to settle."""
    rates = [filter_.slowest_rad_s for filter_ in (high_pass, anti_alias) if filter_ is not None]
    if not rates:
        return 0 if oversampling == 1 else 2 * FADE_SAMPLES
    settling = int(np.ceil(-np.log(SETTLED) / min(rates) * chirp.sampling_rate_hz))
    return min(2 * max(FADE_SAMPLES, settling), LONGEST_GUARD * chirp.samples)


def transmit_power_w(radar: RadarTable) -> float:
    """Return the transmitted power; 1 if the scenario gives a signal-to-noise ratio instead."""
    return 1.0 if radar.transmit_power_dbm is None else 1e-3 * from_db(radar.transmit_power_dbm)


def noise_power(radar: RadarTable, chirp: Chirp, reference_echo: float) -> float:
    """Return the noise power of a sample.

    With a noise figure it is k T F times the sampled bandwidth. With `snr_db` it is that much below the
    reference echo, and constant over the survey like receiver noise.

    radar, chirp: the radar and its sweep.
    reference_echo: received over transmitted power of the echo that `snr_db` refers to.
    """
    if radar.snr_db is not None:
        return reference_echo / from_db(radar.snr_db)
    figure_db = radar.system_noise_figure_db
    assert figure_db is not None
    bandwidth = chirp.sampling_rate_hz / (1 if chirp.sampling == "iq" else 2)
    return Boltzmann * radar.temperature_k * from_db(figure_db) * bandwidth


def build_noise_stage(_: StageParameters, inputs: StageInputs) -> ReceiverStage:
    """Return the stage that adds thermal noise: the same as without other stages."""
    return noisy


def build_leakage(_: StageParameters, inputs: StageInputs) -> Leakage:
    """Return the leakage of a scenario's radar."""
    table = inputs.radar.receiver.leakage
    return Leakage(
        delay_s=np.array([1e-9 * entry.delay_ns for entry in table]),
        power=10.0 ** (np.array([entry.level_db for entry in table]) / 10),
    )


# Largest frequency error of a sweep, relative to its bandwidth.
MAX_SHIFTED = 0.1


def build_mixer(_: StageParameters, inputs: StageInputs) -> Mixer:
    """Return the mixer of a scenario's radar.

    Raises ScenarioError for frequency errors that are large against the bandwidth.
    """
    radar, chirp = inputs.radar, inputs.sweeps[0]
    first, last = radar.used_samples
    whole = radar.samples_per_chirp
    middle = first + (last - first) // 2 - whole // 2
    rate_hz = chirp.sampling_rate_hz
    oscillator = build_oscillator(radar.receiver.oscillator, whole / rate_hz, middle / rate_hz)
    shift_hz = oscillator.shift_hz(chirp)
    if shift_hz > MAX_SHIFTED * radar.bandwidth_hz:
        message = (
            f"shifts the frequency by {shift_hz:.3g} Hz, more than {MAX_SHIFTED:g} of radar.bandwidth_hz; lower the "
            "errors of its sweep, or its phase noise"
        )
        raise ScenarioError.of("radar.receiver.oscillator", message)
    return Mixer(oscillator)


def build_filters(_: StageParameters, inputs: StageInputs) -> Filters:
    """Return the filters of a scenario's receiver."""
    return Filters(high_pass=inputs.high_pass, anti_alias=inputs.anti_alias)


def build_converter(_: StageParameters, inputs: StageInputs) -> Converter:
    """Return the converter of a scenario's radar."""
    receiver = inputs.radar.receiver
    table = receiver.converter
    gain = from_db(receiver.amplifier_gain_db + table.gain_db)
    return Converter(
        bits=table.bits,
        full_scale_w=None if table.full_scale_dbm is None else 1e-3 * from_db(table.full_scale_dbm) / gain,
        over_noise=None if table.full_scale_over_noise_db is None else from_db(table.full_scale_over_noise_db),
        headroom=None if table.agc_headroom_db is None else from_db(-table.agc_headroom_db / 2),
        offset=0.0 if table.dc_offset_db is None else from_db(table.dc_offset_db / 2),
        imbalance=Imbalance(gain=from_db(table.iq_gain_db / 2), lag_rad=float(np.deg2rad(table.iq_phase_deg)))
        if table.imbalanced
        else None,
    )


def rounding_step(radar: RadarTable, receiver: Receiver) -> float | None:
    """Return the step of the converter on the scale of the antenna; None for one without a fixed step."""
    return _step(radar, receiver.sweeps, receiver.noise_power_w)


def _step(radar: RadarTable, sweeps: tuple[Chirp, ...], noise_power_w: float) -> float | None:
    if "converter" in radar.receiver.stages:
        return None
    inputs = StageInputs(radar=radar, sweeps=sweeps, high_pass=build_high_pass(radar.receiver))
    converter = build_converter(StageParameters(stage="converter"), inputs)
    return converter.step(noise_power_w, sweeps[0])


def build_sampled_noise(radar: RadarTable, sweeps: tuple[Chirp, ...]) -> SampledNoise | None:
    """Return the spectrum of the noise behind a scenario's high-pass; None without one.

    Rounding is left out with a gain control, whose steps differ from sweep to sweep, and stages of a plug-in are taken
    for ours.
    """
    receiver, chirp = radar.receiver, sweeps[0]
    high_pass, anti_alias = build_high_pass(receiver), build_anti_alias(receiver, chirp)
    if high_pass is None:
        return None
    # A step that counts from the thermal noise is the same for any; with `snr_db` no other is possible.
    noise_w = 1.0 if radar.snr_db is not None else noise_power(radar, chirp, 0.0)
    step = _step(radar, sweeps, noise_w)
    return SampledNoise(
        filters=Filters(high_pass=high_pass, anti_alias=anti_alias),
        chirp=chirp,
        points=_oversampling(StageInputs(radar=radar, sweeps=sweeps, high_pass=high_pass, anti_alias=anti_alias)),
        rounding=0.0 if step is None else _rounding_w(step, chirp) / noise_w,
    )


def rounding_over_noise(radar: RadarTable, receiver: Receiver) -> float | None:
    """Return the power of the rounding of a sample over that of its thermal noise; None without a fixed step."""
    step = rounding_step(radar, receiver)
    if step is None or receiver.noise_power_w == 0:
        return None
    return _rounding_w(step, receiver.chirp) / receiver.noise_power_w


def _rounding_w(step: float, chirp: Chirp) -> float:
    """Return the power of the rounding of a sample to steps."""
    return (1 if chirp.sampling == "real" else 2) * step**2 / 12


def build_interference_stage(_: StageParameters, inputs: StageInputs) -> ReceiverStage:
    """Return the stage that adds the interference of other radars."""
    return inputs.interference or Interference()


def build_interference(
    interferers: Sequence[Interferer],
    ground_m: Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]],
    antennas: tuple[Antenna, ...],
) -> Interference | None:
    """Return the other radars of a scenario, whose positions are local; None for none.

    Raises ScenarioError for one beyond the terrain, which is the reference of its height.
    """
    if not interferers:
        return None
    positions = np.array([table.position_m for table in interferers])
    ground = ground_m(positions)
    off_terrain: Int[np.ndarray, " n"] = np.flatnonzero(~np.isfinite(ground))
    if len(off_terrain):
        text = "lies beyond the terrain, from which its height counts; move it, or enlarge the terrain"
        raise ScenarioError(
            [Problem(f"interferers.{n}.position_m", f"{interferers[n].position_m} {text}") for n in off_terrain]
        )
    return Interference(
        radars=tuple(
            _radar(table, np.array([*position, base + table.height_m]))
            for table, position, base in zip(interferers, positions, ground, strict=True)
        ),
        antennas=antennas,
    )


def _radar(table: Interferer, position_m: Float[np.ndarray, "3"]) -> OtherRadar:
    radiated_w = 1e-3 * from_db(table.power_dbm + table.antenna_gain_db)
    if table.bandwidth_hz is None or table.chirp_rate_hz is None:
        return OtherRadar(position_m=position_m, radiated_w=radiated_w, carrier_hz=table.carrier_hz)
    return OtherRadar(
        position_m=position_m,
        radiated_w=radiated_w,
        carrier_hz=table.carrier_hz,
        slope_hz_s=table.bandwidth_hz * table.chirp_rate_hz * (1 if table.sweep == "up" else -1),
        period_s=1 / table.chirp_rate_hz,
        start_s=table.offset_s,
    )


def lidar_receiver(
    table: LidarTable, weather: WeatherTable, seed: int, materials: Sequence[str] = ()
) -> LidarReceiver | None:
    """Return the receiver of a scenario; None for a lidar unaffected by the weather.

    materials: names of those of the scene's surfaces, in their order.
    """
    if table.wavelength_nm is None:
        return None
    reflectivity = surface_reflectivities(table, materials) if table.reflectivities else None
    air = build_optical_air(weather, float(table.wavelength_nm))
    return table.to(LidarReceiver, air=air, seed=seed, reflectivity=reflectivity)


def waveform_receiver(table: LidarTable, weather: WeatherTable) -> WaveformReceiver:
    """Return the receiver of a scenario's lidar as built.

    Raises ScenarioError if its clear range cannot be reached in full sunlight, or needs too many samples.
    """
    assert table.wavelength_nm is not None
    one_mrad = table.divergence_mrad
    other_mrad = one_mrad if table.second_divergence_mrad is None else table.second_divergence_mrad
    view_mrad = (2 * one_mrad, 2 * other_mrad)
    if table.field_of_view_mrad is not None:
        view_mrad = (table.field_of_view_mrad, table.field_of_view_mrad)
    receiver = table.to(
        WaveformReceiver,
        divergence_rad=(1e-3 * one_mrad, 1e-3 * other_mrad),
        field_of_view_sr=1e-6 * np.pi / 4 * view_mrad[0] * view_mrad[1],
        air=build_optical_air(weather, float(table.wavelength_nm)),
    )
    if receiver.samples > MOST_SAMPLES:
        message = (
            f"{table.clear_range_m:g} needs {receiver.samples:,} samples of pulse_ns = {table.pulse_ns:g}, more "
            f"than {MOST_SAMPLES:,}; lower it, or lengthen the pulse"
        )
        raise ScenarioError.of("lidar.clear_range_m", message)
    if receiver.detector_variance <= 0:
        message = (
            f"{table.clear_range_m:g} cannot be reached in full sunlight even without detector noise; raise "
            "pulse_energy_nj or receiver_aperture_mm, or lower field_of_view_mrad or filter_nm"
        )
        raise ScenarioError.of("lidar.clear_range_m", message)
    return receiver


def surface_reflectivities(table: LidarTable, materials: Sequence[str]) -> Float[np.ndarray, " surface"]:
    """Return the reflectivities of surfaces by the names of their materials."""
    return np.array([table.reflectivities.get(name, table.ground_reflectivity) for name in materials])


def build_optical_air(weather: WeatherTable, wavelength_nm: float) -> OpticalAir:
    """Return the air of a scenario for light of a wavelength."""
    return optical_air(
        wavelength_nm,
        rain_rate_mm_per_h=weather.rain_rate_mm_per_h,
        snowfall_mm_per_h=weather.snow_mm_per_h,
        visibility_m=weather.visibility_m,
    )


def build_oscillator(table: OscillatorTable, whole_s: float, middle_s: float) -> Oscillator:
    """Return the oscillator of a scenario.

    table: its parameters.
    whole_s, middle_s: duration of a whole sweep, and the middle of its used window after its own.

    Raises InputFileError if the table of the sweep's error cannot be used.
    """
    points = None if table.sweep_error is None else read_sweep_error(table.sweep_error)
    error = table.to(SweepError, duration_s=whole_s, middle_s=middle_s, points=points)
    return Oscillator(
        error=error if table.bent else None,
        noise=PhaseNoise(table.levels_dbc_hz) if table.levels_dbc_hz else None,
        scale=table.scale,
    )


def build_anti_alias(table: ReceiverTable, chirp: Chirp) -> AntiAlias | None:
    """Return the anti-alias filter of a scenario; None where it is ideal."""
    if table.anti_alias_corner_hz == 0:
        return None
    return AntiAlias(corner_hz=table.anti_alias_corner_hz, order=table.anti_alias_order, chirp=chirp)


def build_high_pass(table: ReceiverTable) -> HighPass | None:
    """Return the high-pass of a scenario, with its gain over range; None if it has none."""
    rising = table.range_gain
    if table.high_pass_corner_hz == 0 and rising is None:
        return None
    gain = None if rising is None else rising.to(RangeGain)
    return HighPass(corner_hz=table.high_pass_corner_hz, order=table.high_pass_order, range_gain=gain)
