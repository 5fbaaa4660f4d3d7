"""Tables `[radar]`, `[radar.antenna]` and `[radar.scan]`, and consistency checks of radar and processing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario.bases import AntennaParameters, ScanParameters
from sionna_radar.scenario.choice import ChosenBy
from sionna_radar.scenario.overrides import IMPLIED_ANTENNAS
from sionna_radar.scenario.parts import ANTENNAS, SCANS
from sionna_radar.scenario.presets import PRESETS, filled_in
from sionna_radar.scenario.processing import ProcessingTable
from sionna_radar.scenario.receiver import ArrayTable, ReceiverTable, SecondReceiverTable
from sionna_radar.scenario.table import Conflicts, InputPath, Real, Table, one_of
from sionna_radar.scenario.tracing import TracingTable


class AntennaTable(AntennaParameters):
    """A planar array with a Taylor taper, sized from its half-power beamwidth in each plane."""

    kind: Literal["taylor"] = "taylor"
    beamwidth_deg: (
        Annotated[Real, Field(ge=0.2, le=60)]
        | tuple[Annotated[Real, Field(ge=0.2, le=60)], Annotated[Real, Field(ge=0.2, le=60)]]
    ) = 2.0
    """One-way half-power beamwidth; or [azimuth, elevation]."""
    side_lobe_db: Annotated[Real, Field(ge=-50, le=-15)] = -20.0
    """One-way level of the nearest side lobes, relative to the peak."""
    axial_ratio_db: Annotated[Real, Field(ge=0, le=20)] = 0.0
    """Axial ratio of a circular antenna's ellipse, 0 for a perfect one; its major axis is V."""

    def _conflicts(self) -> Conflicts:
        if self.axial_ratio_db > 0 and self.polarization in ("V", "H"):
            yield (
                "axial_ratio_db",
                f"{self.axial_ratio_db:g} has no effect on polarization = {self.polarization!r}; remove it, or set "
                "polarization = 'RHCP' or 'LHCP'",
            )

    @property
    def beamwidths_rad(self) -> tuple[float, float]:
        """Half-power beamwidth in azimuth and elevation."""
        widths = self.beamwidth_deg if isinstance(self.beamwidth_deg, tuple) else (self.beamwidth_deg,) * 2
        return float(np.deg2rad(widths[0])), float(np.deg2rad(widths[1]))


class PatternAntennaTable(AntennaParameters):
    """An antenna with a measured or computed pattern, from a file of cuts or of the whole sphere."""

    kind: Literal["pattern"] = "pattern"
    pattern: InputPath
    """Antenna pattern file: a CSV with the columns angle_deg,azimuth_db,elevation_db (angles from boresight to the left
    and up) or theta_deg,phi_deg,gain_db; MSI Planet (.msi, .pln); HFSS (report as .csv, field as .ffd); CST (.txt,
    .ffs). Levels are in dBi or relative: the directivity is the pattern's own integral."""
    receive_pattern: InputPath | None = None
    """Antenna pattern file for reception. Default: that of transmission."""
    boresight: Literal["z", "x"] = "z"
    """Boresight axis in files of theta and phi. For "z" the x axis is left of it and the y axis up; for "x" the y axis
    is left and the z axis up. Take "x" also for MSI Planet files whose vertical angles count from the zenith."""
    efficiency_db: Annotated[Real, Field(ge=-30, le=0)] = 0.0
    """One-way gain relative to directivity."""
    axial_ratio_db: Annotated[Real, Field(ge=0, le=20)] = 0.0
    """Axial ratio of a circular antenna's ellipse, 0 for a perfect one; its major axis is V."""


Spacing = Annotated[Real, Field(ge=0.05, le=20)]
Elements = Annotated[int, Field(strict=True, ge=1, le=1024)]


class ArrayAntennaTable(AntennaParameters):
    """A planar array, given by its elements."""

    kind: Literal["array"] = "array"
    elements: tuple[Elements, Elements] | None = None
    """Number of columns (left) and rows (up) of a rectangular array."""
    spacing_wavelengths: Spacing | tuple[Spacing, Spacing] = 0.5
    """Spacing of the elements; or [columns, rows]."""
    taper_db: Annotated[Real, Field(ge=-50, le=-15)] | None = None
    """Side-lobe level of a Taylor taper over rows and columns. Default: uniform weights."""
    path: InputPath | None = None
    """CSV file of the elements, instead of `elements`, `spacing_wavelengths` and `taper_db`, with the columns
    left_wavelengths,up_wavelengths and optionally amplitude_db and phase_deg: one row an element."""
    element_exponent: Annotated[Real, Field(ge=0, le=100)] = 1.0
    """Exponent of the element's power pattern, a power of the cosine of the angle from its axis."""
    element_pattern: InputPath | None = None
    """Pattern file of an element, instead of `element_exponent`, as in `PatternAntennaTable`."""
    element_boresight: Literal["z", "x"] = "z"
    """Boresight axis in the element's pattern file; see `boresight` of `PatternAntennaTable`."""
    steer_deg: tuple[Annotated[Real, Field(ge=-80, le=80)], Annotated[Real, Field(ge=-80, le=80)]] = (0.0, 0.0)
    """Steering angles of the beam from the normal of the face, to the left and up; not with a scan of mode =
    "electronic"."""
    efficiency_db: Annotated[Real, Field(ge=-30, le=0)] = 0.0
    """One-way gain relative to directivity."""

    def _conflicts(self) -> Conflicts:
        if (self.elements is None) == (self.path is None):
            yield "elements", "give either elements = [columns, rows] or path = a CSV of elements"
        if self.path is not None and self.changed("taper_db", "spacing_wavelengths"):
            yield "path", "contradicts taper_db and spacing_wavelengths, which the file has; remove them"


class ElectronicScanTable(ScanParameters):
    """An array whose beam is steered by its phases, in equal steps of direction cosine, from left to right.

    The array's face looks forward at incidence_deg from nadir, or to a side of the track.
    """

    mode: Literal["electronic"] = "electronic"
    look: Literal["forward", "left", "right"] = "forward"
    """Direction that the array's face looks: along the track, or to a side of it."""
    incidence_deg: Annotated[Real, Field(ge=0, lt=90)] = 45.0
    """Angle of the face's normal from nadir."""
    half_swath_deg: Annotated[Real, Field(gt=0, le=75)] = 40.0
    """Angle of the outermost beams from the face's normal."""
    beams: Annotated[int, Field(strict=True, ge=2, le=256)] = 41
    """Number of beam directions of a scan."""
    scans_per_s: Annotated[Real, Field(ge=1e-3, le=1e6)] = 4.0
    """Scan rate; the beam moves from left to right and returns at once."""


class ScanTable(ScanParameters):
    """How the antenna moves: across track, around the vertical, or not at all.

    side_looking does not move: it looks to one side of the track, at incidence_deg from nadir, its azimuth beam along
    the track.
    """

    mode: Literal["whisk_broom", "conical", "fixed", "side_looking"] = "whisk_broom"
    """Scan motion: "whisk_broom" turns about the direction of flight, "conical" about the vertical; "fixed" and
    "side_looking" stand still."""
    side: Literal["left", "right"] = "right"
    """Side to which a side-looking antenna looks."""
    incidence_deg: Annotated[Real, Field(ge=0, lt=90)] = 45.0
    """Angle of the beam from nadir in the middle of the scan."""
    half_swath_deg: Annotated[Real, Field(gt=0, le=180)] = 50.0
    """Half-width of the sector in which the radar transmits; 180 for all around."""
    rotation_rpm: Annotated[Real, Field(gt=0, ge=1e-6, le=1e6)] = 120.0
    """Rotation rate of the antenna."""
    start_deg: Real = 0.0
    """Scan angle at the start of the flight."""

    def _conflicts(self) -> Conflicts:
        if self.mode == "whisk_broom" and self.half_swath_deg >= 90:
            message = f"{self.half_swath_deg:g} lifts the beam to the horizon; a whisk-broom scan must stay below 90"
            yield "half_swath_deg", message
        if self.side == "left" and self.mode != "side_looking":
            yield "side", f"'left' has no effect on a {self.mode} scan; set mode = 'side_looking'"


class PanoramicScanTable(ScanParameters):
    """A beam that turns steadily about the vertical axis of its vehicle, over the horizon: it makes images, not a DEM.

    A fan beam, narrow in azimuth and wide in elevation, sees the surroundings of a vehicle on uneven ground.
    """

    mode: Literal["panoramic"] = "panoramic"
    stabilised: bool = Field(default=False, strict=True)
    """Whether the pointing is stabilised against roll and pitch of the platform."""
    incidence_deg: Annotated[Real, Field(ge=0, le=180)] = 90.0
    """Angle of the beam's axis from nadir: 90 for the horizon."""
    rotation_rpm: Annotated[Real, Field(gt=0, ge=1e-6, le=1e6)] = 60.0
    """Rotation rate of the antenna."""
    start_deg: Real = 180.0
    """Scan angle at the start of the drive, clockwise from the nose; a turn begins at the rear."""


# Of a filter, over the highest beat.
MIN_CORNER = 1e-9
# Of a range gate: 150 km.
LONGEST_GATE_US = 1000.0


class RadarTable(Table):
    """A linear FMCW radar; noise from a signal-to-noise ratio, or from transmit power and noise figure."""

    preset: Annotated[str, one_of(PRESETS)] | None = None
    """Published radar whose values are used for keys that are not given; `sionna-radar presets` lists them."""
    carrier_hz: Annotated[Real, Field(ge=1e9, le=300e9)] = 77e9
    """Frequency in the middle of the sweep."""
    bandwidth_hz: Annotated[Real, Field(ge=1e5)] = 500e6
    """Bandwidth of the sweep; the range cell is c over twice it."""
    chirp_rate_hz: Annotated[Real, Field(ge=1e-2, le=1e7)] = 360.0
    """Number of chirps a second, each as long as its period; of a triangular sweep, pairs of sweeps a second."""
    stagger: Annotated[Real, Field(ge=0, le=1)] = 0.0
    """Extra wait before every second chirp, relative to a chirp's duration: range-Doppler maps then resolve range rates
    that even intervals leave ambiguous. 0.5 doubles the unambiguous interval, 0.25 quadruples it."""
    samples_per_chirp: Annotated[int, Field(strict=True, ge=32, le=2**18)] = 1024
    """Number of samples of each sweep; with real samples half as many range cells are unambiguous, with I/Q samples as
    many."""
    sweep: Literal["up", "down", "triangular"] = "up"
    """Direction of the sweep: rising, falling, or one after the other."""
    sampling: Literal["real", "iq"] = "real"
    """Sampling of the beat signal: real, or in phase and quadrature."""
    gate_delay_us: Annotated[Real, Field(ge=0, le=LONGEST_GATE_US)] = 0.0
    """Range gate: delay of the sweep that echoes are mixed with, and of the samples, after the transmitted sweep.
    Ranges begin at c / 2 times it (150 m a microsecond); nearer echoes have negative beats. A pulse's time is that of
    the middle of its samples."""
    snr_db: Annotated[Real, Field(ge=-100, le=200)] | None = None
    """Signal-to-noise ratio of one sample over level ground in the middle of the scan (alternative to transmit power
    and noise figure)."""
    transmit_power_dbm: Annotated[Real, Field(ge=-60, le=60)] | None = None
    """Transmit power at the antenna."""
    noise_figure_db: Annotated[Real, Field(ge=0, le=60)] | None = None
    """Noise figure of the receiver."""
    temperature_k: Annotated[Real, Field(ge=0.01, le=1e6)] = 290.0
    """Reference temperature of the noise figure."""
    receiver: ReceiverTable = ReceiverTable()
    """Receiver between antenna and samples."""
    antenna: Annotated[AntennaParameters, ChosenBy("kind", ANTENNAS, "taylor", implied=IMPLIED_ANTENNAS)] = (
        AntennaTable()
    )
    """Beam and polarization of the antenna."""
    second_receiver: SecondReceiverTable | None = None
    """Further receivers that measure the angle of arrival inside the beam. Default: none."""
    array: ArrayTable | None = None
    """Transmitters and receivers of a MIMO module, for sensor = "mimo". Default: one of each."""
    scan: Annotated[ScanParameters, ChosenBy("mode", SCANS, "whisk_broom")] = ScanTable()
    """Motion of the beam."""

    @model_validator(mode="before")
    @classmethod
    def _with_preset(cls, values: Any) -> Any:
        if isinstance(values, Mapping) and isinstance(values.get("preset"), str) and values["preset"] in PRESETS:
            return filled_in(values, IMPLIED_ANTENNAS)
        return values

    def differing(self) -> dict[str, Any]:
        """Return the keys that differ from their defaults, and all that the preset sets."""
        of_preset = PRESETS[self.preset].keys if self.preset else {}
        dumped = self.model_dump(mode="json", exclude_none=True)
        return {**super().differing(), **{key: value for key, value in dumped.items() if key in of_preset}}

    def _conflicts(self) -> Conflicts:
        scan = self.scan
        if isinstance(scan, ElectronicScanTable) and scan.beams * scan.scans_per_s > self.chirp_rate_hz * (1 + 1e-9):
            yield (
                "scan.scans_per_s",
                f"{scan.beams} beams {scan.scans_per_s:g} times a second exceed the {self.chirp_rate_hz:g} chirps a "
                f"second; lower it to {self.chirp_rate_hz / scan.beams:.3g}, or raise chirp_rate_hz",
            )
        if self.bandwidth_hz >= 0.5 * self.carrier_hz:
            message = f"{self.bandwidth_hz:g} is not small against carrier_hz = {self.carrier_hz:g}; lower it"
            yield "bandwidth_hz", message
        highest_hz = self.samples_per_chirp * self.chirp_rate_hz * (1 if self.sampling == "iq" else 0.5)
        if self.sweep == "triangular":
            highest_hz *= 2
        if 1e-6 * self.gate_delay_us * self.chirp_rate_hz * (2 if self.sweep == "triangular" else 1) >= 1:
            yield "gate_delay_us", f"{self.gate_delay_us:g} is no shorter than a sweep; lower it, or chirp_rate_hz"
        if self.receiver.high_pass_corner_hz >= highest_hz:
            message = f"{self.receiver.high_pass_corner_hz:g} lies beyond the highest beat, {highest_hz:g}; lower it"
            yield "receiver.high_pass_corner_hz", message
        yield from self._conflicts_of_receiver(highest_hz)
        physical = [self.transmit_power_dbm, self.noise_figure_db]
        if self.snr_db is not None and any(value is not None for value in physical):
            yield "snr_db", "contradicts transmit_power_dbm and noise_figure_db; describe the noise one way only"
        if self.snr_db is None and self.transmit_power_dbm is None:
            yield "snr_db", "missing; give snr_db, or both transmit_power_dbm and noise_figure_db"
        if self.snr_db is None and self.system_noise_figure_db is None:
            yield "noise_figure_db", "missing, but required with transmit_power_dbm; add it, for example 10"

    def _conflicts_of_receiver(self, highest_hz: float) -> Conflicts:
        receiver = self.receiver
        for kind in ("high_pass", "anti_alias"):
            corner_hz = getattr(receiver, f"{kind}_corner_hz")
            if 0 < corner_hz < MIN_CORNER * highest_hz:
                message = f"{corner_hz:g} is negligible against the highest beat, {highest_hz:g}; raise it, or set 0"
                yield f"receiver.{kind}_corner_hz", message
        if receiver.anti_alias_corner_hz > 4 * highest_hz:
            message = f"{receiver.anti_alias_corner_hz:g} lies far beyond the highest beat, {highest_hz:g}; lower it"
            yield "receiver.anti_alias_corner_hz", message
        rising = receiver.range_gain
        if rising is not None and rising.from_hz >= highest_hz:
            message = f"{rising.from_hz:g} lies beyond the highest beat, {highest_hz:g}; lower it"
            yield "receiver.range_gain.from_hz", message
        if receiver.converter.imbalanced and self.sampling == "real":
            message = "real samples have no quadrature component; set radar.sampling = 'iq'"
            yield "receiver.converter.iq_gain_db", message
        if receiver.converter.full_scale_dbm is not None and self.transmit_power_dbm is None:
            yield "receiver.converter.full_scale_dbm", "needs transmit_power_dbm; or give full_scale_over_noise_db"
        if receiver.amplifiers and (self.noise_figure_db is not None or self.snr_db is not None):
            noise_key = "noise_figure_db" if self.noise_figure_db is not None else "snr_db"
            yield "receiver.amplifiers", f"contradicts {noise_key}; describe the noise one way only"

    @property
    def system_noise_figure_db(self) -> float | None:
        """The noise figure, of the amplifiers if given; None with `snr_db`."""
        chain = self.receiver.noise_figure_db
        return self.noise_figure_db if chain is None else chain

    @property
    def mean_rate_hz(self) -> float:
        """Chirps a second, on average over both intervals of `stagger`."""
        return self.chirp_rate_hz / (1 + self.stagger / 2)

    @property
    def used_samples(self) -> tuple[int, int]:
        """The first sample of a sweep that is used, and the one after the last."""
        first, last = (round(self.samples_per_chirp * fraction) for fraction in self.receiver.oscillator.used_window)
        return first, last

    @property
    def max_range_m(self) -> float:
        """Range whose beat lies at the highest unambiguous frequency of the sampling."""
        # The tables of a scenario load without SciPy, in half the time.
        from scipy.constants import speed_of_light

        cells = self.samples_per_chirp / (2 if self.sampling == "real" else 1)
        return float(cells * speed_of_light / (2 * self.bandwidth_hz) + 1e-6 * self.gate_delay_us * speed_of_light / 2)


def refuse_gate(radar: RadarTable, what: str) -> None:
    """Raise ScenarioError for a range gate where `what` needs ranges from zero on."""
    if radar.gate_delay_us > 0:
        message = f"{radar.gate_delay_us:g}: {what} assumes ranges from zero on; set 0, and raise samples_per_chirp"
        raise ScenarioError.of("radar.gate_delay_us", message)


def refuse_squint(radar: RadarTable, what: str) -> None:
    """Raise ScenarioError for a beam that squints where `what` needs one that stands still over a sweep."""
    if radar.antenna.squint_deg_per_ghz != 0:
        message = (
            f"{radar.antenna.squint_deg_per_ghz:g}: {what} assumes a beam that does not move during a sweep; set 0"
        )
        raise ScenarioError.of("radar.antenna.squint_deg_per_ghz", message)


def speckle_looks(processing: ProcessingTable, tracing: TracingTable) -> int:
    """Return the number of averaged powers of a pulse with independent speckle; one for static ground."""
    return processing.average.powers if tracing.speckle == "per_pulse" else 1


def refuse_average(processing: ProcessingTable, what: str) -> None:
    """Raise ScenarioError for averaged chirps where `what` needs single ones."""
    if processing.average.chirps > 1:
        message = f"{processing.average.chirps}: {what} supports single chirps only; set 1"
        raise ScenarioError.of("processing.average.chirps", message)


NEEDED = {"interferometric": "interferometer", "monopulse": "monopulse", "row": "row"}


def conflicts_of_angle(angle: str, radar: RadarTable) -> Conflicts:
    """Yield the keys that an angle of arrival lacks."""
    if angle != "off" and (radar.second_receiver is None or radar.second_receiver.kind != NEEDED[angle]):
        needed = f"{angle!r} needs radar.second_receiver with kind = {NEEDED[angle]!r}; add it"
        yield "processing.angle", needed


def conflicts_of_array(radar: RadarTable, sensor: str) -> Conflicts:
    """Yield the keys that an array lacks, and those without effect on it."""
    array = radar.array
    if sensor != "mimo":
        if array is not None and sensor == "radar":
            yield "radar.array", "has no effect on sensor = 'radar'; set sensor = 'mimo', or remove it"
        return
    if array is None:
        yield "radar.array", "missing; sensor = 'mimo' needs its elements, or a preset that defines them"
        return
    frame_s = array.chirps_per_frame / radar.chirp_rate_hz
    if frame_s * array.frame_rate_hz > 1 + 1e-9:
        message = f"{array.frame_rate_hz:g} frames of {1e3 * frame_s:.3g} ms do not fit into a second; lower it to "
        yield "radar.array.frame_rate_hz", f"{message}{1 / frame_s:.3g}, or lower radar.array.chirps"
