"""Tables of the receiver: `[radar.receiver]`, oscillators, interferers, and a second receiver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import accumulate, pairwise
from math import log10
from types import MappingProxyType
from typing import Annotated, Literal, get_args

from pydantic import Field

from sionna_radar.foundation.decibels import from_db, to_db
from sionna_radar.scenario.bases import StageParameters
from sionna_radar.scenario.choice import ChosenBy
from sionna_radar.scenario.parts import RECEIVER_STAGES
from sionna_radar.scenario.table import Conflicts, InputPath, NonNegative, Point2, Positive, Real, Table, one_of


@dataclass(frozen=True, kw_only=True)
class PhaseNoiseLevels:
    """Published phase noise.

    levels: offsets from the carrier in Hz, and levels of one sideband in dBc/Hz.
    source: of its figures. assumed: what no source gives.
    """

    levels: tuple[tuple[float, float], ...]
    source: str
    assumed: str


_SHAPE = "a loop 1 MHz wide: level within it, 20 dB a decade beyond; the source gives the figure at 1 MHz alone"
# The data sheets themselves were not at hand.
_AWR1843AOP = "at 1 MHz, from the AWR1843AOP data sheet SWRS236C as a public repository of component data quotes it"
_AWR2243 = "at 1 MHz, from the AWR2243 data sheet SWRS223D as the fact check of a public repository quotes it"


def _synthesiser(level_dbc_hz: float, band: str, source: str) -> PhaseNoiseLevels:
    levels = ((1e3, level_dbc_hz), (1e6, level_dbc_hz), (1e7, level_dbc_hz - 20))
    return PhaseNoiseLevels(levels=levels, source=f"{band}, {level_dbc_hz:g} dBc/Hz {source}", assumed=_SHAPE)


PHASE_NOISE: Mapping[str, PhaseNoiseLevels] = MappingProxyType(
    {
        "ti_awr1843aop_76ghz": _synthesiser(-95.0, "the first of two figures, for 76 to 77 GHz", _AWR1843AOP),
        "ti_awr1843aop_77ghz": _synthesiser(-93.0, "the second of two figures, for 77 to 81 GHz", _AWR1843AOP),
        "ti_awr2243_76ghz": _synthesiser(-96.0, "76 to 77 GHz (VCO1)", _AWR2243),
        "ti_awr2243_77ghz": _synthesiser(-94.0, "77 to 81 GHz (VCO2)", _AWR2243),
    }
)


Order = Annotated[int, Field(strict=True, ge=1, le=4)]
# An offset from the carrier, and the level there in one sideband.
Offset = tuple[Annotated[Real, Field(gt=0, le=1e12)], Annotated[Real, Field(ge=-250, le=0)]]
# Of the reference, over its own; more is another radar.
MAX_DRIFT = 0.1
# Of all amplifiers up to any of them, either way.
MAX_GAIN_DB = 300
Place = Literal["leakage", "mixer", "interference", "noise", "filters", "converter"]
Stage = Annotated[StageParameters, ChosenBy("stage", RECEIVER_STAGES, by_name=True)]


class OscillatorTable(Table):
    """Errors of the oscillator: phase noise, frequency errors of the sweep, and drift.

    Frequency errors are those of the transmitted wave; echoes are mixed with the same sweep, which has advanced since.
    """

    phase_noise_dbc_hz: tuple[Offset, ...] = ()
    """Phase noise: pairs of an offset from the carrier in Hz and the level of one sideband there, dBc/Hz. Decibels are
    linear in the logarithm of the offset; below the first pair they are extrapolated from the first two, beyond the
    last they stay."""
    phase_noise_preset: Annotated[str, one_of(PHASE_NOISE)] | None = None
    """Phase noise of a published oscillator, instead of `phase_noise_dbc_hz`."""
    quadratic_hz: Real = 0.0
    """Quadratic frequency error: its value at both ends of the sweep, growing with the square of the time from its
    middle."""
    cubic_hz: Real = 0.0
    """Cubic frequency error: its value at the end of the sweep, and the negative at its start."""
    sinusoidal_hz: Real = 0.0
    """Amplitude of a sinusoidal frequency error."""
    sinusoidal_periods: Annotated[Real, Field(gt=0, le=1e4)] = 1.0
    """Periods of the sinusoidal frequency error in a sweep."""
    settling_hz: Real = 0.0
    """Frequency error at the start of the sweep that decays exponentially."""
    settling_time_s: Positive | None = None
    """Time in which the settling error falls to 1/e."""
    sweep_error: InputPath | None = None
    """CSV file of a further frequency error, with the columns time_s, from the start of the sweep, and error_hz."""
    drift_ppm_per_k: Annotated[Real, Field(ge=-1e4, le=1e4)] = 0.0
    """Temperature drift of the frequency reference that slope, carrier and sampling follow, per kelvin."""
    warmer_k: Annotated[Real, Field(ge=-200, le=200)] = 0.0
    """Temperature above that at which the reference was measured."""
    used_window: tuple[Annotated[Real, Field(ge=0, le=1)], Annotated[Real, Field(ge=0, le=1)]] = (0.0, 1.0)
    """First and last fraction of the sweep between which samples are used: fewer samples of less bandwidth, at the same
    rate. The time of a pulse is that of their middle."""

    def _conflicts(self) -> Conflicts:
        offsets = [offset for offset, _ in self.phase_noise_dbc_hz]
        if any(log10(b) <= log10(a) for a, b in pairwise(offsets)):
            yield "phase_noise_dbc_hz", "its offsets must increase from pair to pair; sort them"
        if offsets and self.phase_noise_preset is not None:
            yield "phase_noise_preset", "contradicts phase_noise_dbc_hz; give one of them"
        if (self.settling_hz != 0) != (self.settling_time_s is not None):
            yield "settling_time_s", "goes with settling_hz; give both or none"
        if abs(self.scale - 1) > MAX_DRIFT:
            message = f"{self.drift_ppm_per_k:g} over {self.warmer_k:g} K scale ranges by {self.scale:g}; lower it"
            yield "drift_ppm_per_k", message
        first, last = self.used_window
        if last - first < 0.05:
            yield "used_window", f"{first:g} to {last:g} is less than a twentieth of the sweep; widen it"

    @property
    def levels_dbc_hz(self) -> tuple[Offset, ...]:
        """Offsets from the carrier and levels of one sideband; none for an oscillator without phase noise."""
        return PHASE_NOISE[self.phase_noise_preset].levels if self.phase_noise_preset else self.phase_noise_dbc_hz

    @property
    def bent(self) -> bool:
        """Whether the sweep is not straight."""
        errors = (self.quadratic_hz, self.cubic_hz, self.sinusoidal_hz, self.settling_hz)
        return any(errors) or self.sweep_error is not None

    @property
    def scale(self) -> float:
        """Ranges that are read over true ones, by the drift of the reference."""
        return 1 + 1e-6 * self.drift_ppm_per_k * self.warmer_k


class LeakageTable(Table):
    """A constant leakage path from transmitter to receiver: between the antennas, off a radome."""

    delay_ns: Annotated[Real, Field(ge=0, le=1e6)]
    """Delay from transmitter to receiver."""
    level_db: Annotated[Real, Field(ge=-250, le=0)]
    """Leakage power, relative to the transmitted power."""


class AmplifierTable(Table):
    """An amplifier stage in front of the converter; a negative gain is a loss."""

    gain_db: Annotated[Real, Field(ge=-100, le=150)]
    """Power gain; negative for a loss."""
    noise_figure_db: Annotated[Real, Field(ge=0, le=100)]
    """Noise figure of the stage alone; that of a passive stage is its loss."""


class ConverterTable(Table):
    """The analogue-to-digital converter and its gain; each component of I/Q samples has one."""

    bits: Annotated[int, Field(strict=True, ge=1, le=24)] | None = None
    """Number of bits of a sample. Default: samples are not rounded."""
    full_scale_dbm: Annotated[Real, Field(ge=-200, le=60)] | None = None
    """Full-scale power: that of the sine that just fills the converter, at its input."""
    full_scale_over_noise_db: Annotated[Real, Field(ge=0, le=250)] | None = None
    """Full scale relative to the thermal noise of a sample, instead of `full_scale_dbm`."""
    gain_db: Annotated[Real, Field(ge=-100, le=200)] = 0.0
    """Fixed gain between antenna and converter, in addition to that of the amplifiers."""
    agc_headroom_db: Annotated[Real, Field(ge=0, le=60)] | None = None
    """Headroom of an automatic gain control, instead of a fixed gain: each sweep's gain puts its strongest sample this
    far below full scale."""
    dc_offset_db: Annotated[Real, Field(ge=-250, le=0)] | None = None
    """DC offset of the converter, in both components of I/Q samples: its amplitude relative to full scale."""
    iq_gain_db: Annotated[Real, Field(ge=-10, le=10)] = 0.0
    """Gain imbalance: gain of the quadrature component relative to the in-phase one."""
    iq_phase_deg: Annotated[Real, Field(ge=-45, le=45)] = 0.0
    """Phase imbalance: lag of the quadrature component behind 90 deg."""

    def _conflicts(self) -> Conflicts:
        scales = {
            "full_scale_dbm": self.full_scale_dbm,
            "full_scale_over_noise_db": self.full_scale_over_noise_db,
            "agc_headroom_db": self.agc_headroom_db,
        }
        given_scales = [key for key, value in scales.items() if value is not None]
        if len(given_scales) > 1:
            yield given_scales[1], f"contradicts {given_scales[0]}; give one of {', '.join(scales)}"
        for key in ("bits", "dc_offset_db"):
            if getattr(self, key) is not None and not given_scales:
                yield key, f"needs a full scale; give one of {', '.join(scales)}"
        if self.gain_db != 0 and self.full_scale_dbm is None:
            yield "gain_db", "has no effect without full_scale_dbm; give it"

    @property
    def limited(self) -> bool:
        """Whether samples have a full scale."""
        return any(v is not None for v in (self.full_scale_dbm, self.full_scale_over_noise_db, self.agc_headroom_db))

    @property
    def imbalanced(self) -> bool:
        """Whether the two parts of I/Q samples differ."""
        return self.iq_gain_db != 0 or self.iq_phase_deg != 0


class RangeGainTable(Table):
    """A gain that rises with the beat frequency, and so with range: the sensitivity time control of an FMCW radar.

    It acts between mixer and converter. Echoes beyond to_hz keep the receiver's gain, nearer ones are attenuated: from
    from_hz to to_hz the gain rises by 6 dB an octave for each order, below it is flat. Spectra are calibrated for it.
    """

    from_hz: Positive
    """Beat frequency at which the gain begins to rise."""
    to_hz: Positive
    """Beat frequency at which the gain ceases to rise."""
    order: Order = 2
    """Order of the rise: 1 compensates the spreading of a volume that fills the beam, 2 that of points."""

    def _conflicts(self) -> Conflicts:
        if self.to_hz <= self.from_hz:
            yield "to_hz", f"{self.to_hz:g} is not beyond from_hz = {self.from_hz:g}; raise it"


class ReceiverTable(Table):
    """The receiver between antenna and samples; without these keys it is ideal."""

    high_pass_corner_hz: NonNegative = 0.0
    """Corner frequency of a Butterworth high-pass on the beat signal; 0 for none."""
    high_pass_order: Order = 2
    """Order of the high-pass."""
    range_gain: RangeGainTable | None = None
    """Gain over beat frequency, in addition to the high-pass. Default: flat."""
    anti_alias_corner_hz: NonNegative = 0.0
    """Corner frequency of a Butterworth low-pass in front of the converter; 0 for an ideal one that ends with the
    sampled band. With I/Q samples it counts from the middle of their band."""
    anti_alias_order: Annotated[int, Field(strict=True, ge=1, le=8)] = 4
    """Order of the anti-alias low-pass."""
    oscillator: OscillatorTable = OscillatorTable()
    """Phase noise, sweep nonlinearity and drift."""
    leakage: tuple[LeakageTable, ...] = ()
    """Leakage paths from transmitter to receiver."""
    amplifiers: tuple[AmplifierTable, ...] = ()
    """Gains and noise figures from the antenna on, instead of `radar.noise_figure_db`."""
    converter: ConverterTable = ConverterTable()
    """Bits, full scale, and errors of I/Q samples."""
    stages: dict[Place, Stage] = {}
    """Custom stages of the receiver by the name of the stage that they replace: leakage, mixer, interference, noise,
    filters, converter."""

    def _conflicts(self) -> Conflicts:
        for kind in ("high_pass", "anti_alias"):
            if getattr(self, f"{kind}_corner_hz") == 0 and self.changed(f"{kind}_order"):
                message = f"{getattr(self, f'{kind}_order')} has no effect without {kind}_corner_hz; give it"
                yield f"{kind}_order", message
        gains_db = accumulate(stage.gain_db for stage in self.amplifiers)
        excess_db = next((gain_db for gain_db in gains_db if abs(gain_db) > MAX_GAIN_DB), None)
        if excess_db is not None:
            message = (
                f"their total gain of {excess_db:g} dB exceeds {MAX_GAIN_DB} dB in magnitude; give fewer "
                "amplifiers, or lower gains"
            )
            yield "amplifiers", message
        for slot, stage in self.stages.items():
            if stage.stage != slot and stage.stage in get_args(Place):
                message = (
                    f"{stage.stage!r} is a built-in stage of another position; name a plug-in's stage, or remove it"
                )
                yield f"stages.{slot}", message

    @property
    def amplifier_gain_db(self) -> float:
        """The gain of all amplifiers."""
        return sum((stage.gain_db for stage in self.amplifiers), 0.0)

    @property
    def noise_figure_db(self) -> float | None:
        """The noise figure of all amplifiers (Friis 1944); None where there are none."""
        if not self.amplifiers:
            return None
        factor, gain = 1.0, 1.0
        for stage in self.amplifiers:
            factor += (from_db(stage.noise_figure_db) - 1) / gain
            gain *= from_db(stage.gain_db)
        return to_db(factor)


class Interferer(Table):
    """Another radar, in the line of sight of ours, whose waves our antenna receives directly."""

    kind: Literal["fmcw", "cw"] = "fmcw"
    """Waveform of the interferer: a linear sweep, or a steady carrier."""
    position_m: Point2
    """Position: east and north."""
    height_m: NonNegative = 0.0
    """Height above the ground."""
    power_dbm: Annotated[Real, Field(ge=-100, le=90)]
    """Transmit power."""
    antenna_gain_db: Annotated[Real, Field(ge=-100, le=80)] = 0.0
    """Gain of the interferer's antenna toward ours in dBi, less its polarization loss."""
    carrier_hz: Annotated[Real, Field(ge=1e9, le=300e9)] = 77e9
    """Frequency in the middle of the interferer's sweep."""
    bandwidth_hz: Annotated[Real, Field(ge=0, le=1e11)] | None = None
    """Bandwidth of the interferer's sweep."""
    chirp_rate_hz: Annotated[Real, Field(ge=1e-2, le=1e7)] | None = None
    """Number of the interferer's sweeps a second, each as long as its period."""
    sweep: Literal["up", "down"] = "up"
    """Direction of the interferer's sweep: rising or falling."""
    offset_s: Annotated[Real, Field(ge=-1e6, le=1e6)] = 0.0
    """Time after the start of the survey at which one of the interferer's sweeps begins."""

    def _conflicts(self) -> Conflicts:
        sweep = {"bandwidth_hz": self.bandwidth_hz, "chirp_rate_hz": self.chirp_rate_hz}
        for key, value in sweep.items():
            if self.kind == "fmcw" and value is None:
                yield key, "missing; give it, or kind = 'cw'"
            if self.kind == "cw" and value is not None:
                yield key, "does not apply to a steady carrier; remove it, or set kind = 'fmcw'"


class SecondReceiverTable(Table):
    """Further receivers beside the first, for the angle of arrival; each has the noise of one."""

    kind: Literal["interferometer", "monopulse", "row"] = "interferometer"
    """Kind of the second receiver. An "interferometer" has the antenna's pattern and a phase centre of its own;
    "monopulse" is the difference of the antenna's two halves, whose sum is the first receiver; a "row" is several
    receivers like an interferometer's, evenly spaced with the first: real ones, or virtual ones of a MIMO radar that
    separates its transmitters."""
    receivers: Annotated[int, Field(strict=True, ge=3, le=32)] | None = None
    """Number of receivers of a row, the first included."""
    axis: Literal["elevation", "azimuth", "both"] = "both"
    """Axis along which the phase centre or the halves lie: the antenna's elevation (up) or azimuth (left). With "both"
    a third receiver gives each axis its own; a row then lies along the elevation, with one receiver beside it."""
    baseline_wavelengths: Annotated[Real, Field(ge=0.05, le=1000)] | None = None
    """Distance between the phase centres of an interferometer, or between neighbours in a row. Default: for an
    interferometer such that the phase scatters by a quarter of a radian over the two-way beam, in a row half of the
    longest that is unambiguous."""
    baseline_error_wavelengths: Annotated[Real, Field(ge=-1, le=1)] = 0.0
    """Error of the baseline: excess of the true distance over the one that processing assumes."""
    phase_error_deg: Annotated[Real, Field(ge=-180, le=180)] = 0.0
    """Uncalibrated phase of a second receiver relative to the first; not for "monopulse"."""

    def _conflicts(self) -> Conflicts:
        if self.kind == "row" and self.receivers is None:
            yield "receivers", "missing; give the number of receivers of the row, for example 8"
        if self.kind != "row" and self.receivers is not None:
            yield "receivers", f"{self.receivers} has no effect on kind = {self.kind!r}; set kind = 'row'"
        for name in self.changed("baseline_wavelengths", "baseline_error_wavelengths", "phase_error_deg"):
            if self.kind == "monopulse":
                yield name, f"has no effect on kind = 'monopulse', whose halves are the antenna's own; remove {name}"


Place2 = tuple[Annotated[Real, Field(ge=-500, le=500)], Annotated[Real, Field(ge=-500, le=500)]]
MAX_TRANSMITTERS, MAX_RECEIVERS, MAX_CHANNELS = 64, 64, 1024
# Places closer than this are one.
SAME_WAVELENGTHS = 1e-3


class ArrayTable(Table):
    """Transmitters and receivers of a MIMO module that maps without rotating: sensor = "mimo".

    The antenna's pattern is that of each element.
    """

    transmitters_wavelengths: tuple[Place2, ...]
    """Positions of the transmitters: [left, up] of the antenna's middle."""
    receivers_wavelengths: tuple[Place2, ...]
    """Positions of the receivers: [left, up] of the antenna's middle."""
    multiplexing: Literal["tdm", "ddm", "bpm"] = "tdm"
    """Separation of the transmitters: in turn ("tdm"), or all at once with different Doppler frequencies ("ddm") or
    binary phases ("bpm")."""
    chirps: Annotated[int, Field(strict=True, ge=8, le=4096)] = 64
    """Number of chirps of each transmitter in a frame; with "bpm" blocks of a power of two."""
    frame_rate_hz: Annotated[Real, Field(gt=0, le=1e5)] = 10.0
    """Number of frames a second; between them the module is silent."""
    gain_error_db: Annotated[Real, Field(ge=0, le=20)] = 0.0
    """Standard deviation of the residual gain error of each transmitter and receiver after calibration."""
    phase_error_deg: Annotated[Real, Field(ge=0, le=180)] = 0.0
    """Standard deviation of the residual phase error of each transmitter and receiver after calibration."""
    coupling_db: Annotated[Real, Field(ge=-100, le=-3)] | None = None
    """Mutual coupling between receivers half a wavelength apart; it falls with distance. Default: none."""
    half_view_deg: Annotated[Real, Field(gt=0, lt=90)] = 50.0
    """Largest angle of a direction from the antenna's axis; directions beyond are left out."""
    rate_window: Literal["hann", "hamming", "blackman", "blackmanharris"] = "hann"
    """Window of the Doppler FFT over the chirps of a frame."""
    average_cells: tuple[
        Annotated[int, Field(strict=True, ge=1, le=64)], Annotated[int, Field(strict=True, ge=1, le=64)]
    ] = (2, 2)
    """Number of range-rate and of range cells that are averaged to a point."""
    max_sigma_m: Positive = 2.0
    """Largest standard deviation of a point, along the ray or across it; points above it are left out."""

    def _conflicts(self) -> Conflicts:
        limits = {"transmitters_wavelengths": MAX_TRANSMITTERS, "receivers_wavelengths": MAX_RECEIVERS}
        for name, most in limits.items():
            places = getattr(self, name)
            if not 1 <= len(places) <= most:
                yield name, f"has {len(places)} elements; give 1 to {most}"
            rounded = [tuple(round(x / SAME_WAVELENGTHS) for x in place) for place in places]
            for number, place in enumerate(rounded):
                if place in rounded[:number]:
                    first = rounded.index(place)
                    yield name, f"elements {first} and {number} are both at {list(places[number])}; move or remove one"
        channels = len(self.transmitters_wavelengths) * len(self.receivers_wavelengths)
        if channels > MAX_CHANNELS:
            yield "receivers_wavelengths", f"{channels} channels are more than {MAX_CHANNELS}; give fewer"

    @property
    def chirps_per_frame(self) -> int:
        """All chirps of a frame."""
        count = len(self.transmitters_wavelengths)
        return self.chirps * (1 << (count - 1).bit_length() if self.multiplexing == "bpm" else count)
