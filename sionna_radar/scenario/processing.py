"""Tables `[processing]` and `[dem]`."""

from typing import Annotated, Literal

from pydantic import Field, field_validator

from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.numerics import window as window_of
from sionna_radar.scenario.bases import Offset
from sionna_radar.scenario.choice import NameIn, ParametersOf
from sionna_radar.scenario.parts import DEM_METHODS, RANGE_ESTIMATORS
from sionna_radar.scenario.table import Conflicts, InputPath, NonNegative, Positive, Real, Table, refuse

Turn = Annotated[Real, Field(ge=-180.0, le=180.0)]


# Range cells on each side of a cell under test, where as many fit and none are given.
GUARD_CELLS, TRAINING_CELLS = 48, 32


class CfarTable(Table):
    """Constant false-alarm rate detection; guard and training count range cells on each side."""

    kind: Literal["CA", "GO", "SO", "OS"] = "SO"
    """cell averaging, greatest of, smallest of, or ordered statistic."""
    guard: Annotated[int, Field(strict=True, ge=0, le=4096)] | None = None
    """range cells next to the cell under test that are left out, on each side; without it 48, or three fifths of what
    fits on a side of short spectra."""
    training: Annotated[int, Field(strict=True, ge=1, le=512)] | None = None
    """range cells whose power is the noise, on each side; without it 32, or the rest of what fits."""
    rank: Annotated[Real, Field(gt=0, le=1)] = 0.75
    """of an ordered statistic, as a share of the training cells."""
    false_alarm_probability: Annotated[Real, Field(ge=1e-12, le=0.1)] = 1e-6
    """in one cell."""

    def _conflicts(self) -> Conflicts:
        training = self.training or TRAINING_CELLS
        if self.kind == "OS" and self.rank * training < 0.5:
            yield (
                "rank",
                f"{self.rank:g} of {training} training cells is less than half a cell; "
                f"give at least {0.5 / training:g}",
            )

    def sides(self, cells: int) -> tuple[int, int]:
        """Return the guard and training cells on each side in spectra of a number of range cells.

        Every cell has a side that fits if twice their sum is less than the cells. Where the usual ones do not fit, they
        share in the same proportion what does.
        """
        room = (cells - 1) // 2
        if self.guard is None and self.training is None:
            both = min(GUARD_CELLS + TRAINING_CELLS, max(room, 1))
            guard = both * GUARD_CELLS // (GUARD_CELLS + TRAINING_CELLS)
            return guard, both - guard
        if self.guard is None:
            assert self.training is not None
            return max(0, min(GUARD_CELLS, room - self.training)), self.training
        return self.guard, self.training or max(1, min(TRAINING_CELLS, room - self.guard))

    def misfit(self, cells: int) -> str | None:
        """Return why guard and training do not fit spectra of a number of range cells; None if they do."""
        both = sum(self.sides(cells))
        if 2 * both < cells:
            return None
        return f"guard + training = {both} cells on each side do not fit {cells} range cells"


class AverageTable(Table):
    """Several chirps in a row that make one pulse, measured in their middle."""

    chirps: Annotated[int, Field(strict=True, ge=1, le=32)] = 1
    """of a pulse. The pulse rate is radar.chirp_rate_hz over it."""
    mode: Literal["coherent", "incoherent"] = "coherent"
    """"coherent" takes the mean of the beat signals, each turned by what the measured velocity changes the range of
    still ground on the beam's axis: noise falls by the number of chirps, and so does ground whose Doppler shifts differ
    by more than one over the burst's duration. "incoherent" takes the mean of the power spectra, which steadies noise,
    and speckle as far as it changes from chirp to chirp."""

    @property
    def powers(self) -> int:
        """Chirps whose power spectra are averaged; one where beat signals are."""
        return self.chirps if self.mode == "incoherent" else 1


class ExpectedGroundTable(Table):
    """Where the ground is expected, so that echoes from elsewhere are none: rain, birds, the far side of a valley."""

    path: InputPath | None = None
    """a rough DEM in metres, in the terrain's vertical datum; without it level ground `platform.altitude_m` below the
    platform, as an altimeter reports it."""
    tolerance_m: Positive
    """by how much the ground may lie above or below."""


class VolumeTable(Table):
    """How the ground behind an echo that fills the beam (rain, snowfall, dust) is told from it."""

    estimation_rounds: Annotated[int, Field(strict=True, ge=1, le=20)] = 2
    """so often the volume's mean echo and the ground are learned from each other."""
    smoothed_cells: Annotated[int, Field(strict=True, ge=1, le=1000)] = 8
    """range cells, each way, over which the volume's mean echo is smoothed."""
    cells_before: Annotated[int, Field(strict=True, ge=0, le=1000)] = 16
    """range cells between those that hold the volume alone and the ground, besides `widths_before`."""
    widths_before: NonNegative = 5.0
    """widths of the echo of level ground between them, besides `cells_before`."""
    floor_share: Annotated[Real, Field(gt=0, lt=1)] = 0.01
    """lowest mean behind the ground, over the volume's there: side lobes and double bounces."""
    width_spread_nepers: Positive = 0.25
    """uncertainty of the width of an echo on ground of a known slope: the beam is as wide across, and ground is
    curved."""
    height_step_cells: Positive = 1.0
    """between the heights that neighbouring pulses are compared by."""
    rain_rate_mm_per_h: Annotated[Real, Field(gt=0, le=300)] | None = None
    """as a weather service would say it: how fast the drops are expected to fall. Their Doppler moves the end of the
    rain, and with it ranges of ground that is fainter than the rain. Without it the strength of the rain's own echo
    tells it where the transmitted power is known, and 5 mm/h are expected where it is not."""


class CalibrationTable(Table):
    """Errors of the instrument that recordings are processed without: what is believed minus what is true.

    `sionna-radar calibrate` estimates them. A simulated flight has its errors in `platform.navigation` instead.
    """

    mounting_deg: tuple[Turn, Turn, Turn] = (0.0, 0.0, 0.0)
    """by how much the mount is believed to be turned about nose, right and down."""
    squint_deg: Turn = 0.0
    """by how much the beam is believed to be turned about the antenna's upward axis."""
    lever_arm_m: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)
    """by how much the lever arm is believed to be longer: nose, right, down."""
    datum_m: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)
    """positions minus those in the datum of the reference: east, north, up."""
    velocity_mps: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)
    """constant error of the velocity: east, north, up."""
    range_bias_m: Offset = 0.0
    """range that is read at range zero."""
    range_scale_ppm: Annotated[Real, Field(ge=-1e5, le=1e5)] = 0.0
    """by how much ranges are read longer, for each metre."""
    time_offset_s: Annotated[Real, Field(ge=-10, le=10)] = 0.0
    """lag of the reported poses behind the radar's clock."""


class TrackerTable(Table):
    """A first-order loop over the ranges of pulses, as radio altimeters have: `ranging = "tracker"`.

    It smooths the ranges after their correction for Doppler, before they become points. Its standard deviations are
    those that errors independent from pulse to pulse leave; that they repeat from point to point, and lag behind ground
    that rises, a map does not know.
    """

    time_constant_s: Positive = 0.1
    """of the loop."""
    follows: Literal["threshold", "leading_edge", "centroid", "peak"] = "threshold"
    """what is read of each pulse; see `ranging`."""


class ProcessingTable(Table):
    """From beat signals to ranges."""

    window: str = "hann"
    """of `scipy.signal.get_window`."""
    zero_padding: Annotated[int, Field(strict=True, ge=1, le=16)] = 2
    """bins of the spectrum in a range cell."""
    cfar: CfarTable = CfarTable()
    """detection."""
    echoes: Literal["first", "strongest", "all"] = "strongest"
    """which echoes of a pulse are kept; without it "all" where dem.method is "stepped"."""
    merge_gap_m: NonNegative = 3.0
    """detected cells no farther apart are one echo."""
    dynamic_range_db: Annotated[Real, Field(gt=0, le=300)] = 20.0
    """echoes this far under the strongest of their pulse are dropped."""
    ranging: Annotated[str, NameIn(RANGE_ESTIMATORS)] = "centroid"
    """"peak" takes the strongest bin of an echo, "centroid" its mean range, "leading_edge" where it rises, moved to its
    middle, "threshold" where it rises to half of its amplitude, "model_fit" the range, slope and power of the plane
    whose echo fits best; "tracker" smooths the ranges of pulses by a first-order loop, as altimeters do. Behind a
    volume that is not far below the ground it is the range that the whole scan line makes most probable instead. Custom
    range estimators are named here as well."""
    ranging_parameters: Annotated[Table | None, ParametersOf("ranging", RANGE_ESTIMATORS)] = None
    """of "tracker", or of a custom range estimator that has some."""
    min_range_m: NonNegative = 3.0
    """nothing nearer is detected."""
    volume_clutter: Literal["auto", "off"] = "auto"
    """"auto" looks in the survey for an echo that fills the beam (rain, snowfall, dust) and, where there is one, for
    the ground that ends it; "off" takes rain for ground where it is the stronger."""
    volume: VolumeTable = VolumeTable()
    """detection behind it."""
    expected_ground: ExpectedGroundTable | None = None
    """ranges in which the ground of a pulse may lie; without it all."""
    angle: Literal["off", "interferometric", "monopulse", "row"] = "off"
    """angle of arrival inside the beam, by radar.second_receiver: "interferometric" from the phase between the
    receivers, "monopulse" from the ratio of difference and sum, "row" by MUSIC from a row of receivers, which tells two
    surfaces in one range cell apart; each echo becomes a series of points, one for each stretch of its ranges. "off"
    places an echo on the beam's axis."""
    angle_length_m: Positive | None = None
    """slant range that is averaged into one point; without it as much as leaves the resolution on the ground to the
    beam's width across."""
    leakage: Literal["keep", "subtract"] = "keep"
    """"subtract" takes the mean of some chirps, spread over the survey, out of every chirp: what leaks from the
    transmitter is the same in all of them, echoes of ground are not. "keep" leaves it."""
    interference: Literal["keep", "zeroing"] = "keep"
    """"zeroing" sets samples of a chirp to zero that stand out of all others, as do bursts of other radars."""
    average: AverageTable = AverageTable()
    """chirps that are averaged to one pulse."""
    calibration: CalibrationTable | None = None
    """known errors of the instrument, of recordings."""
    doppler_correction: bool = Field(default=True, strict=True)
    """whether the measured velocity takes the Doppler shift of still ground out of the ranges."""

    def _conflicts(self) -> Conflicts:
        if self.angle == "off" and self.angle_length_m is not None:
            yield "angle_length_m", f"{self.angle_length_m:g} has no effect with angle = 'off'; give angle"
        if self.angle != "off" and self.leakage == "subtract":
            yield "leakage", "'subtract' knows the first receiver alone; set angle = 'off', or 'keep' it"

    @field_validator("window")
    @classmethod
    def _known_window(cls, value: str) -> str:
        try:
            window_of(value, 32)
        except (ValueError, TypeError) as error:
            message = f"{shown(value)} is not a window of scipy.signal.get_window; try 'hann' or 'blackman'"
            raise refuse("", message) from error
        return value


class DemTable(Table):
    """The elevation model: its grid, and how the echoes become heights."""

    method: Annotated[str, NameIn(DEM_METHODS, ("auto",))] = "auto"
    """"auto" takes "stepped" over a scenario with buildings, if the sensor has range profiles, the air holds nothing
    that would be taken for walls and the lines of a whisk-broom scan are no farther apart than two footprints, and
    "linear" elsewhere. "linear" interpolates between the located echoes. "smooth" lays the most probable surface
    through the mean ranges of the whole echoes (or through the points, without range profiles), each weighted by its
    uncertainty, under a covariance that is learned from them. "refined" goes on from there: it predicts every echo from
    the surface and the known beam, and moves the surface to where the measured echoes are most likely. "stepped" is for
    built-up ground: it first finds where the surface breaks, from what all echoes say for and against every height, and
    maps each level by itself. Custom methods are named here as well."""
    method_parameters: Annotated[Table | None, ParametersOf("method", DEM_METHODS)] = None
    """of a custom method that has some."""
    spacing_m: Positive = 1.0
    """size of a cell."""
    max_gap_m: Positive | None = None
    """farthest that a filled cell is from a measured one; without it the distance between neighbouring beams on level
    ground, and no less than two cells."""
    microrelief_m: NonNegative | None = None
    """RMS difference of heights 1 m apart that microrelief adds to the landforms: fractal, and hardly constrained by
    echoes. It is part of the terrain model of every map and of its `dem_sigma.tif`. Without it 0.03 m over terrain from
    a file and in recordings of real radars, as fields and forest floors have, and 0 over synthetic terrain, which is
    smooth."""
    min_confidence_m: Positive | None = None
    """cells whose standard deviation (`dem_sigma.tif`) is more are left out; without it none is."""
    cover: Literal["unknown", "known"] = "unknown"
    """whether a map of whole echoes knows the land cover, as from a map of it: "known" takes the scenario's covers and
    the backscatter of their materials, so that of a beam over two covers the brighter part tells its own height.
    "linear" does not use it, nor does "smooth" through rain. A survey warns where unknown covers move its heights."""
    shadow_incidence_deg: Annotated[Real, Field(gt=0, le=90)] = 85.0
    """surfaces seen at a greater incidence count as shadow."""

    @property
    def map_method(self) -> str:
        """The method; of "auto", which a scenario has replaced, what fits any ground."""
        return "linear" if self.method == "auto" else self.method
