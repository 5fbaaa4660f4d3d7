"""Tables `[processing]` (beat signals to ranges) and `[dem]` (echoes to heights)."""

from typing import Annotated, Literal

from pydantic import Field, field_validator

from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.windows import window as window_of
from sionna_radar.scenario.bases import AttitudeSpreadAxes, Offset, SpreadAxes
from sionna_radar.scenario.choice import NameIn, ParametersOf
from sionna_radar.scenario.parts import DEM_METHODS, RANGE_ESTIMATORS
from sionna_radar.scenario.table import Conflicts, InputPath, NonNegative, Positive, Real, Table, refuse

Turn = Annotated[Real, Field(ge=-180.0, le=180.0)]


# Range cells on each side of a cell under test, where as many fit and none are given.
GUARD_CELLS, TRAINING_CELLS = 48, 32


class CfarTable(Table):
    """Constant false-alarm rate (CFAR) detection; guard and training count range cells on each side."""

    kind: Literal["CA", "GO", "SO", "OS"] = "SO"
    """CFAR variant: cell averaging (CA), greatest of (GO), smallest of (SO), or ordered statistic (OS)."""
    guard: Annotated[int, Field(strict=True, ge=0, le=4096)] | None = None
    """Guard cells on each side of the cell under test. Default: 48, or three fifths of what fits on a side of short
    spectra."""
    training: Annotated[int, Field(strict=True, ge=1, le=512)] | None = None
    """Training cells on each side, whose power estimates the noise. Default: 32, or the rest of what fits."""
    rank: Annotated[Real, Field(gt=0, le=1)] = 0.75
    """Rank of the ordered statistic, as a fraction of the training cells."""
    false_alarm_probability: Annotated[Real, Field(ge=1e-12, le=0.1)] = 1e-6
    """False-alarm probability in one range cell."""

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
    """Averaging of successive chirps to one pulse, at their mean time."""

    chirps: Annotated[int, Field(strict=True, ge=1, le=32)] = 1
    """Number of chirps averaged to one pulse; the pulse rate is radar.chirp_rate_hz divided by it."""
    mode: Literal["coherent", "incoherent"] = "coherent"
    """Kind of average. "coherent" takes the mean of the beat signals, each phase-shifted by the range change that the
    measured velocity gives stationary ground on the beam's axis: noise falls by the number of chirps, and so does
    ground whose Doppler shifts differ by more than one over the burst's duration. "incoherent" takes the mean of the
    power spectra, which steadies noise, and speckle as far as it changes from chirp to chirp."""

    @property
    def powers(self) -> int:
        """Chirps whose power spectra are averaged; one where beat signals are."""
        return self.chirps if self.mode == "incoherent" else 1


class ExpectedGroundTable(Table):
    """Expected heights of the ground; echoes from elsewhere (rain, birds, the far side of a valley) are rejected."""

    path: InputPath | None = None
    """Rough DEM in metres, in the terrain's vertical datum. Default: level ground `platform.altitude_m` below the
    platform, as an altimeter reports it."""
    tolerance_m: Positive
    """Largest height of the ground above or below the expected ground."""


class VolumeTable(Table):
    """Detection of the ground behind volume clutter: rain, snowfall or dust that fills the beam."""

    estimation_rounds: Annotated[int, Field(strict=True, ge=1, le=20)] = 2
    """Iterations between the estimates of the volume's mean echo and of the ground, which depend on each other."""
    smoothed_cells: Annotated[int, Field(strict=True, ge=1, le=1000)] = 8
    """Half-width, in range cells, of the smoothing of the volume's mean echo."""
    cells_before: Annotated[int, Field(strict=True, ge=0, le=1000)] = 16
    """Range cells between those that hold the volume alone and the ground, in addition to `widths_before`."""
    widths_before: NonNegative = 5.0
    """Widths of the echo of level ground between the cells of the volume alone and the ground, in addition to
    `cells_before`."""
    floor_share: Annotated[Real, Field(gt=0, lt=1)] = 0.01
    """Lowest mean power behind the ground, as a fraction of the volume's there: side lobes and double bounces."""
    width_spread_nepers: Positive = 0.25
    """Uncertainty of the width of an echo on ground of a known slope: the beam has an extent across the slope, and
    ground is curved."""
    height_step_cells: Positive = 1.0
    """Step between the heights at which neighbouring pulses are compared."""
    rain_rate_mm_per_h: Annotated[Real, Field(gt=0, le=300)] | None = None
    """Expected rain rate, as from a weather service. It sets how fast the drops are expected to fall: their Doppler
    shift moves the end of the rain, and with it ranges of ground that is fainter than the rain. Default: estimated from
    the strength of the rain's own echo where the transmitted power is known, and 5 mm/h otherwise."""


class CalibrationTable(Table):
    """Known errors of the instrument, believed minus true, which are removed from recordings.

    `sionna-radar calibrate` estimates them. A simulated flight has its errors in `platform.navigation` instead.
    """

    mounting_deg: tuple[Turn, Turn, Turn] = (0.0, 0.0, 0.0)
    """Error of the mounting angles, believed minus true, about nose, right and down."""
    squint_deg: Turn = 0.0
    """Error of the beam's direction about the antenna's upward axis, believed minus true."""
    lever_arm_m: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)
    """Error of the lever arm, believed minus true: nose, right, down."""
    datum_m: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)
    """Offset of the positions from the datum of the reference: east, north, up."""
    velocity_mps: tuple[Offset, Offset, Offset] = (0.0, 0.0, 0.0)
    """Constant error of the velocity: east, north, up."""
    range_bias_m: Offset = 0.0
    """Range reading at range zero."""
    range_scale_ppm: Annotated[Real, Field(ge=-1e5, le=1e5)] = 0.0
    """Range scale error: excess of the range reading per metre."""
    time_offset_s: Annotated[Real, Field(ge=-10, le=10)] = 0.0
    """Lag of the reported poses behind the radar's clock."""


class RefinedNavigationTable(Table):
    """Refinement of the flight's navigation by its own echoes: `navigation = "refined"`.

    Errors of position and attitude are estimated together with the ground, as constants and slow processes in time, of
    the sizes that are stated here, or else in `platform.navigation`.
    """

    position_m: SpreadAxes | None = None
    """Standard deviation of the position's error, a first-order Gauss-Markov process: one for all axes, or east, north,
    up. Default: all errors as `platform.navigation` states them."""
    position_correlation_s: Positive = 60.0
    """Correlation time of the position's error."""
    attitude_deg: AttitudeSpreadAxes | None = None
    """Standard deviation of the attitude's error, a first-order Gauss-Markov process: one for all angles, or roll,
    pitch, heading. Default: all errors as `platform.navigation` states them."""
    attitude_correlation_s: Positive = 60.0
    """Correlation time of the attitude's error."""
    reference: InputPath | None = None
    """Heights of the ground that are known otherwise, such as a coarse DEM: a GeoTIFF, a point cloud or a table of
    places, as for `--reference`."""
    reference_sigma_m: Positive | None = None
    """Standard deviation of each height of the reference, whose errors are taken as independent from cell to cell.
    Needed with a reference without its own."""

    def _conflicts(self) -> Conflicts:
        if self.reference_sigma_m is not None and self.reference is None:
            yield "reference_sigma_m", "has no effect without a reference; give reference, or remove it"


class TrackerTable(Table):
    """A first-order loop over the ranges of pulses, as radio altimeters have: `ranging = "tracker"`.

    It smooths the ranges after their correction for Doppler, before they become points. Its standard deviations are
    those that errors independent from pulse to pulse leave; that they repeat from point to point, and lag behind ground
    that rises, a map does not know.
    """

    time_constant_s: Positive = 0.1
    """Time constant of the loop."""
    follows: Literal["threshold", "leading_edge", "centroid", "peak"] = "threshold"
    """Range of each pulse that the loop follows; see `ranging`."""


class ObstaclesTable(Table):
    """Report of obstacles: echoes above the map, in clusters. The map is made without them."""

    report: bool | None = Field(default=None, strict=True)
    """Whether obstacles are reported. Default: where the scene has wires, poles or fences."""
    sigmas: Annotated[Real, Field(ge=2, le=20)] = 5.0
    """Least height of an echo over the map, in standard deviations of both and of the beam's width."""
    min_probability: Annotated[Real, Field(gt=0, lt=1)] = 0.99
    """Least probability that a reported cluster of echoes is neither noise nor ground."""


class ProcessingTable(Table):
    """Processing of beat signals to ranges: window, detection, ranging, angle of arrival."""

    window: str = "hann"
    """Window of the range FFT, as `scipy.signal.get_window` names it."""
    zero_padding: Annotated[int, Field(strict=True, ge=1, le=16)] = 2
    """Zero-padding factor: bins of the spectrum per range cell."""
    cfar: CfarTable = CfarTable()
    """Detection threshold (CFAR)."""
    echoes: Literal["first", "strongest", "all"] = "strongest"
    """Echoes of a pulse that are kept. Default: "all" where dem.method is "stepped" or "canopy", else
    "strongest"."""
    merge_gap_m: NonNegative = 3.0
    """Largest gap between detected cells of one echo."""
    dynamic_range_db: Annotated[Real, Field(gt=0, le=300)] = 20.0
    """Dynamic range of a pulse: echoes weaker than the strongest by more than this are dropped."""
    ranging: Annotated[str, NameIn(RANGE_ESTIMATORS)] = "centroid"
    """Range estimator. "peak" takes the strongest bin of an echo, "centroid" its mean range, "leading_edge" the rising
    edge, moved to the echo's middle, "threshold" the rise to half of its amplitude, "model_fit" the range, slope and
    power of the plane whose echo fits best; "tracker" smooths the ranges of pulses by a first-order loop, as altimeters
    do. Behind a volume that is not far below the ground it is the range that the whole scan line makes most probable
    instead. Custom range estimators are named here as well."""
    ranging_parameters: Annotated[Table | None, ParametersOf("ranging", RANGE_ESTIMATORS)] = None
    """Parameters of "tracker", or of a custom range estimator."""
    min_range_m: NonNegative = 3.0
    """Least range of a detection."""
    volume_clutter: Literal["auto", "off"] = "auto"
    """Detection behind volume clutter. "auto" looks in the survey for an echo that fills the beam (rain, snowfall,
    dust) and, where there is one, for the ground that ends it, and, where obstacles are reported and `echoes` is "all",
    for what stands out of it; "off" takes rain for ground where it is the stronger."""
    volume: VolumeTable = VolumeTable()
    """Detection of the ground behind volume clutter."""
    obstacles: ObstaclesTable = ObstaclesTable()
    """Report of obstacles above the ground."""
    expected_ground: ExpectedGroundTable | None = None
    """Ranges in which the ground of a pulse may lie. Default: all."""
    angle: Literal["off", "interferometric", "monopulse", "row"] = "off"
    """Angle of arrival inside the beam, by radar.second_receiver: "interferometric" from the phase between the
    receivers, "monopulse" from the ratio of difference and sum, "row" by MUSIC from a row of receivers, which separates
    two surfaces in one range cell; each echo becomes a series of points, one for each interval of its ranges. "off"
    places an echo on the beam's axis."""
    angle_length_m: Positive | None = None
    """Slant range that is averaged into one point. Default: as much as leaves the resolution on the ground to the
    beam's width across."""
    leakage: Literal["keep", "subtract"] = "keep"
    """Treatment of transmitter leakage. "subtract" removes the mean of some chirps, spread over the survey, from every
    chirp: leakage is the same in all of them, echoes of ground are not. "keep" leaves it."""
    interference: Literal["keep", "zeroing"] = "keep"
    """Treatment of interference. "zeroing" sets samples of a chirp to zero that stand out of all others, as do bursts
    of other radars; "keep" leaves them."""
    average: AverageTable = AverageTable()
    """Averaging of several chirps to one pulse."""
    calibration: CalibrationTable | None = None
    """Known errors of the instrument that made a recording."""
    navigation: Literal["reported", "refined"] = "reported"
    """Poses that echoes are placed with: "reported" as the navigation system reports them; "refined" without the errors
    that echoes of overlapping scan lines and flight lines tell, estimated together with the ground."""
    refined_navigation: RefinedNavigationTable = RefinedNavigationTable()
    """Sizes of the errors that "refined" estimates, and a reference for them."""
    doppler_correction: bool = Field(default=True, strict=True)
    """Whether ranges are corrected for the Doppler shift of stationary ground, by the measured velocity."""

    def _conflicts(self) -> Conflicts:
        if self.angle == "off" and self.angle_length_m is not None:
            yield "angle_length_m", f"{self.angle_length_m:g} has no effect with angle = 'off'; give angle"
        if self.angle != "off" and self.leakage == "subtract":
            yield "leakage", "'subtract' supports the first receiver only; set angle = 'off', or leakage = 'keep'"
        if self.navigation == "reported" and self.refined_navigation != RefinedNavigationTable():
            yield "refined_navigation", "has no effect with navigation = 'reported'; set 'refined', or remove it"

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
    """The digital elevation model (DEM): its grid, and the mapping method."""

    method: Annotated[str, NameIn(DEM_METHODS, ("auto",))] = "auto"
    """Mapping method. "auto" takes "stepped" over a scenario with buildings, if the sensor has range profiles, the air
    holds nothing that would be taken for walls and the lines of a whisk-broom scan are no farther apart than two
    footprints, and "linear" elsewhere. "linear" interpolates between the located echoes. "smooth" fits the most
    probable surface to the mean ranges of the whole echoes (or to the points, without range profiles), each weighted by
    its uncertainty, under a covariance that is estimated from them. "refined" starts from there: it predicts every echo
    from the surface and the known beam, and moves the surface to where the measured echoes are most likely. "stepped"
    is for built-up ground: it first finds where the surface breaks, from the likelihood of every height given all
    echoes, and maps each level by itself. "canopy" is for fields, orchards and vineyards: from the same echoes it maps
    the ground under plants, their top and what was seen of each. Custom methods are named here as well."""
    method_parameters: Annotated[Table | None, ParametersOf("method", DEM_METHODS)] = None
    """Parameters of the mapping method."""
    surface: Literal["ground", "top"] = "ground"
    """Surface that the DEM of "canopy" is of: the ground, or the top of the plants on it."""
    spacing_m: Positive = 1.0
    """Cell size of the DEM."""
    max_gap_m: Positive | None = None
    """Largest distance of a filled cell from a measured one. Default: the distance between neighbouring beams on level
    ground, and at least two cells."""
    microrelief_m: NonNegative | None = None
    """RMS height difference over 1 m that microrelief adds to the landforms: fractal, and hardly constrained by echoes.
    It is part of the terrain model of every map and of its `dem_sigma.tif`. Default: 0.03 m over terrain from a file
    and in recordings of real radars, as of fields and forest floors, and 0 over synthetic terrain, which is smooth."""
    min_confidence_m: Positive | None = None
    """Largest standard deviation (`dem_sigma.tif`) of a filled cell; cells above it are left empty. Default: no
    limit."""
    cover: Literal["unknown", "known"] = "unknown"
    """Whether a map of whole echoes knows the land cover, as from a map of it: "known" takes the scenario's covers and
    the backscatter of their materials, so that in a beam over two covers the brighter one determines the height it is
    assigned. "linear" does not use it, nor does "smooth" through rain. A survey warns where unknown covers move its
    heights."""
    shadow_incidence_deg: Annotated[Real, Field(gt=0, le=90)] = 85.0
    """Incidence above which a surface counts as radar shadow."""

    def _conflicts(self) -> Conflicts:
        if self.surface == "top" and self.method != "canopy":
            yield "surface", f"'top' has no effect with method = {shown(self.method)}; set 'canopy', or remove it"

    @property
    def map_method(self) -> str:
        """The method; of "auto", which a scenario has replaced, what fits any ground."""
        return "linear" if self.method == "auto" else self.method
