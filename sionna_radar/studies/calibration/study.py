"""Calibration of an instrument from its recordings: what they tell of its errors, and the errors that they tell.

The echoes are detected as `process` does. Which errors are observable is computed before any is estimated, and
with it what other manoeuvres would add: lines like the flown one, turned, higher, faster or rocking, over the same
reference. Then the errors are estimated (`estimation`), and the map is made with and without them.
"""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import distance_transform_edt

from sionna_radar.accuracy.compare import DemError
from sionna_radar.accuracy.reference import Checkpoints, ReferenceSurface, read_reference
from sionna_radar.accuracy.truth import compare_dem
from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.flight.instrument import UNKNOWNS, InstrumentErrors
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.progress import stage
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.mapping.navigation.echo_errors import RangeProfiles, Stage
from sionna_radar.mapping.navigation.joint import MeasuredPlaces, ground_grid
from sionna_radar.studies.calibration.estimation import Further, Solution, solve, solve_over_unknown_ground
from sionna_radar.studies.calibration.instrument_echoes import CombinedEchoes, Readings
from sionna_radar.studies.calibration.manoeuvres import information_of_lines
from sionna_radar.studies.calibration.recorded_echoes import DOPPLER_ERRORS, FEWEST, Heard, echoes_of, signals_in
from sionna_radar.survey.placement import place
from sionna_radar.survey.recording_source import check_same_radar, open_recording

USUAL = ("roll", "pitch", "heading", "range_bias", "time_offset")
DATUM = ("datum_east", "datum_north", "datum_up")
# A reference is displaced if its shift is this unlikely by what is stated of it; in standard deviations.
DISPLACED = 4.0
# Cells of the reference in one of the DEM: the ground is curved within a cell.
CELLS = 2


# End of the warning of echoes that are too far from the model.
NO_ESTIMATE = "No estimate is stated"


@dataclass(frozen=True, kw_only=True)
class Calibrated:
    """A recording with and without the estimated errors.

    source: its file. place_m: where the axis of each pulse meets the ground. before_m, after_m: how much farther the
    echoes are than predicted, with and without the errors; sigma_m: by speckle.
    dem: as believed, and corrected; error: of both, where the recording holds the truth.
    """

    source: Path
    place_m: Float[np.ndarray, "pulse 2"]
    before_m: Float[np.ndarray, " pulse"]
    after_m: Float[np.ndarray, " pulse"]
    sigma_m: Float[np.ndarray, " pulse"]
    dem: tuple[Raster, Raster]
    error: tuple[DemError, DemError] | None


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Estimated errors of an instrument, and how observable each is.

    solution: the estimate. manoeuvres: posteriors with one more line; none over unknown ground.
    displaced: the estimate that lets the reference lie elsewhere, if it does.
    doppler: what is taken from the range rates of each recording, or why nothing is.
    """

    solution: Solution
    manoeuvres: tuple[Further, ...]
    recordings: tuple[Calibrated, ...]
    reference: Path | None
    reference_sigma_m: float
    displaced: bool
    warnings: tuple[str, ...]
    overrides: Mapping[str, Any]
    doppler: tuple[str, ...] = ()

    @property
    def refused(self) -> str | None:
        """Why no estimate is stated; None if there is one."""
        return next((w for w in self.warnings if NO_ESTIMATE in w), None) if self.solution.rejected_by_chi2 else None

    @property
    def errors(self) -> dict[str, tuple[float, float]]:
        """Estimates and standard deviations of observable errors, in the units of `UNKNOWNS`."""
        solution = self.solution
        rows = zip(solution.names, solution.value, solution.sigma, solution.observable, strict=True)
        return {
            name: (v / UNKNOWNS[name].si, s / UNKNOWNS[name].si) for name, v, s, is_observable in rows if is_observable
        }


def parse_errors(names: Sequence[str]) -> tuple[str, ...]:
    """Return the errors to estimate, the usual ones without any. Raises ScenarioError for a name that is none."""
    known = [name for name in UNKNOWNS if name not in DATUM]
    for name in names:
        if name not in known:
            raise ScenarioError.of_option("--estimate", f"{shown(name)} is unknown; give some of {', '.join(known)}")
    return tuple(dict.fromkeys(names)) or USUAL


# Units, SI, of the errors that have standard deviations beforehand, and of those that may drift.
PRIORS = {name: unknown.si for name, unknown in UNKNOWNS.items() if name not in DATUM}
DRIFTS = {name: unknown.si for name, unknown in UNKNOWNS.items()}


def parse_deviations(option: str, texts: Sequence[str], units: Mapping[str, float] | None = None) -> dict[str, float]:
    """Return standard deviations, SI, from NAME=SIGMA in units by name; without these in that of the key, of any name.

    Raises ScenarioError for a name that is none, and for a deviation that is no positive number.
    """
    found = {}
    for text in texts:
        name, _, number = text.partition("=")
        try:
            value = float(number)
        except ValueError:
            value = 0.0
        if (units is not None and name not in units) or not 0 < value < np.inf:
            known = "" if units is None else f" of {', '.join(units)}"
            message = f"{shown(text)} is no standard deviation; give NAME=VALUE, a positive number and a name{known}"
            raise ScenarioError.of_option(option, message)
        found[name] = value if units is None else value * units[name]
    return found


@on_one_thread
def calibrate(
    recordings: Sequence[str | Path],
    reference: str | Path | None = None,
    *,
    names: Sequence[str] = USUAL,
    prior: Mapping[str, float] | None = None,
    drift: Mapping[str, float] | None = None,
    reference_sigma_m: float = 0.0,
    overrides: Mapping[str, Any] | None = None,
) -> Calibration:
    """Estimate errors of an instrument from its recordings.

    Parameters
    ----------
    recordings:
        As for `process`, with poses; all of one instrument, and in the same local metres.
    reference:
        Heights of the ground, as for `compare_with_reference`: a surface, or single places. None for lines that
        overlap.
    names, prior:
        Errors to estimate, in `UNKNOWNS`, and their standard deviations beforehand, SI. Where Doppler is used,
        `DOPPLER_ERRORS` are among them.
    drift:
        Errors that differ from line to line, and their standard deviations between lines, SI.
    reference_sigma_m:
        Standard deviation of an error of position and height that all of the reference shares.
    overrides:
        Values of `processing` and `dem` by dotted keys.

    Returns
    -------
    The errors with their posterior standard deviations, in the units of their keys.

    Raises
    ------
    InputFileError, ScenarioError
        No poses, too few echoes over the reference, or a setting that does not fit.

    Examples
    --------
    >>> lines = {"count": 2, "spacing_m": 10.0, "length_m": 20.0, "crossing": True}
    >>> flight = {"platform.lines": lines, "platform.start_m": None, "platform.navigation.boresight_error_deg": 0.5}
    >>> survey = run(load_scenario("hills", flight), recordings={"signals": "lines.nc"})
    >>> survey.truth.to_geotiff("ground.tif")
    >>> found = calibrate(["lines.nc"], "ground.tif").errors
    >>> bool(abs(found["roll"][0] - 0.5) < 4 * found["roll"][1])
    True

    """
    changes = dict(overrides or {})
    path = None if reference is None else Path(reference)
    with ExitStack() as stack:
        errors = {n: UNKNOWNS[n].prior * UNKNOWNS[n].si for n in (*names, *DOPPLER_ERRORS)} | dict(prior or {})
        opened = [stack.enter_context(open_recording(signals_in(Path(name)), changes)) for name in recordings]
        heard = [echoes_of(source, errors) for source in opened]
        if any(isinstance(each.echoes, RangeProfiles) and each.echoes.rates for each in heard):
            names = tuple(dict.fromkeys((*names, *DOPPLER_ERRORS)))
        known = None if path is None else read_reference(path, _grid(heard), reference_sigma_m)
        if isinstance(known, ReferenceSurface):
            found = _over_surface(heard, known, path, names, dict(prior or {}), drift or {}, reference_sigma_m)
        else:
            found = _over_unknown(heard, known, path, names, dict(prior or {}), drift or {})
        parts, surface, solution = found.parts, found.surface, found.solution
        warnings = [*found.warnings, *_doubts(solution, parts)]
        # What leads away from the model may lead anywhere: no estimate is stated, and the map is left as it is.
        solution = solution.prior_only() if solution.rejected_by_chi2 else solution
        # Over unknown ground a further line would first have to determine the ground.
        further = information_of_lines(parts, surface, solution) if isinstance(known, ReferenceSurface) else {}
        manoeuvres = tuple(
            Further(name=name, posterior=solution.posterior.with_more(information))
            for name, information in further.items()
        )
        both = zip(heard, parts.parts, strict=True)
        calibrated = tuple(_calibrated(each, part, surface, solution) for each, part in both)
    return Calibration(
        solution=solution,
        manoeuvres=manoeuvres,
        recordings=calibrated,
        reference=path,
        reference_sigma_m=reference_sigma_m,
        displaced=found.displaced,
        warnings=tuple(warnings),
        overrides=changes,
        doppler=tuple(f"{each.source.path.name}: {each.doppler}" for each in heard if each.doppler),
    )


@dataclass(frozen=True, kw_only=True)
class _Found:
    """An estimate with the ground and the echoes that it is of."""

    parts: CombinedEchoes
    surface: Heightfield
    solution: Solution
    displaced: bool = False
    warnings: tuple[str, ...] = ()


def _over_surface(
    heard: Sequence["Heard"],
    reference: ReferenceSurface,
    path: Path | None,
    names: Sequence[str],
    prior: dict[str, float],
    drift: Mapping[str, float],
    sigma_m: float,
) -> _Found:
    """Estimate errors over a surface, which may lie elsewhere."""
    surface, known = _filled(reference, _grid(heard), path)
    parts = CombinedEchoes(parts=tuple(_over(each.echoes, surface, known, path) for each in heard))
    asked = tuple(names) + (DATUM if sigma_m > 0 else ())
    with stage("estimating", 1):
        solution = solve(parts, surface, asked, prior | dict.fromkeys(DATUM, sigma_m), drift)
        free = solve(parts, surface, (*names, *DATUM), prior, drift)
    if not (warning := _displacement(free, sigma_m)):
        return _Found(parts=parts, surface=surface, solution=solution)
    return _Found(parts=parts, surface=surface, solution=free, displaced=True, warnings=(warning,))


def _over_unknown(
    heard: Sequence["Heard"],
    known: Checkpoints | None,
    path: Path | None,
    names: Sequence[str],
    prior: dict[str, float],
    drift: Mapping[str, float],
) -> _Found:
    """Estimate errors and the ground together, from lines that overlap, and single heights if there are any."""
    parts = tuple(
        each.echoes.rows(each.echoes.motion.within_lines) for each in heard if isinstance(each.echoes, RangeProfiles)
    )
    if len(parts) < len(heard):
        message = "without a surface as --reference give recordings of signals, of lines that overlap"
        raise ScenarioError.of_option("recordings", message)
    for each, part in zip(heard, parts, strict=True):
        check_same_radar(heard[0].source.sweeps, each.source.sweeps, str(each.source.path))
        of_rain = [own.sightings.profiles.volume is not None for own in (parts[0], part)]
        if each.source.settings.radar.antenna != heard[0].source.settings.radar.antenna or of_rain[0] != of_rain[1]:
            message = "are of different antennas or weather; calibrate each by itself"
            raise ScenarioError.of_option("recordings", message)
    places = None
    if known is not None:
        if not (known.sigma_m > 0).all():
            raise InputFileError(f"{shown(path or Path())}: its heights need a column sigma, or --reference-sigma")
        places = MeasuredPlaces(place_m=known.place_m, height_m=known.height_m, sigma_m=known.sigma_m)
    own = RangeProfiles.joined(parts)
    grid = ground_grid(_grid(heard), own, heard[0].source.settings.dem.spacing_m)
    with stage("estimating", 1):
        solution, surface = solve_over_unknown_ground(own, grid, names, prior, places, drift)
    return _Found(parts=CombinedEchoes(parts=parts), surface=surface, solution=solution)


def _grid(heard: Sequence[Heard]) -> Grid:
    """Return the grid of the reference: it reaches all footprints."""
    grids = [each.grid for each in heard]
    if len({(None if grid.georeference is None else grid.georeference.origin_m) for grid in grids}) > 1:
        raise ScenarioError.of_option("recordings", "have different local metres; calibrate each by itself")
    west, south = (min(float(axis[0]) for axis in axes) for axes in ([g.x_m for g in grids], [g.y_m for g in grids]))
    east, north = (max(float(axis[-1]) for axis in axes) for axes in ([g.x_m for g in grids], [g.y_m for g in grids]))
    grid = Grid.covering(west, south, east, north, grids[0].spacing_m / CELLS, (0.0, 0.0))
    return replace(grid, georeference=grids[0].georeference)


def _filled(
    reference: ReferenceSurface, grid: Grid, path: Path | None
) -> tuple[Heightfield, Bool[np.ndarray, "row column"]]:
    """Return the reference on a grid, and the cells where it is known; others have the height of the nearest."""
    height_m = reference.on(grid).height_m
    known = np.isfinite(height_m)
    if not known.any():
        raise InputFileError(f"{shown(path or Path())}: has no height where the beam meets the ground; give one of it")
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return Heightfield(grid=grid, height_m=np.ascontiguousarray(height_m[tuple(nearest)])), known


def _over(
    echoes: RangeProfiles | Readings, surface: Heightfield, known: Bool[np.ndarray, "row column"], path: Path | None
) -> RangeProfiles | Readings:
    """Return the echoes of footprints that the reference covers."""
    pose, grid = echoes.motion.pose, surface.grid
    reach_m = echoes.reach_m if isinstance(echoes, Readings) else echoes.sightings.reach_m
    toward = pose.boresight[:, None]
    if isinstance(echoes, RangeProfiles):
        toward = np.concatenate([toward, echoes.sightings.corner_directions()], axis=1)
    covered = echoes.motion.within_lines
    for k in range(toward.shape[1]):
        hit = surface.first_hit(pose.position_m, toward[:, k], reach_m)
        place_m = pose.position_m + np.nan_to_num(hit)[:, None] * toward[:, k]
        row, column, inside = grid.cell_of(place_m)
        own = np.zeros(len(echoes), dtype=bool)
        own[inside] = known[row[inside], column[inside]]
        # A corner of the lobe may pass over the horizon; its axis may not.
        covered &= own if k == 0 else own | ~np.isfinite(hit)
        covered &= np.isfinite(hit) if k == 0 else True
    if covered.sum() < FEWEST:
        message = f"{shown(path or Path())}: lies under {covered.sum()} echoes; at least {FEWEST} are needed"
        raise InputFileError(message)
    return echoes.rows(covered)


def _displacement(free: Solution, stated_m: float) -> str:
    """Return the displacement of the reference, in words; empty if what is stated of it, and chance, explain it."""
    rows = zip(free.names, free.value, free.sigma, free.observable, strict=True)
    shifts = [(name, value, sigma) for name, value, sigma, observable in rows if observable and name in DATUM]
    if not any(abs(value) > DISPLACED * np.hypot(sigma, stated_m) for _, value, sigma in shifts):
        return ""
    parts = [f"{-value:+.2f} ± {sigma:.2f} m {name.removeprefix('datum_')}" for name, value, sigma in shifts]
    stated = f"more than the {stated_m:g} m that are stated" if stated_m else "and --reference-sigma states none"
    return (
        f"the reference is displaced against the flight by {', '.join(parts)}, {stated}: it is estimated with the "
        "errors, which are known less well for it"
    )


def _doubts(solution: Solution, parts: CombinedEchoes) -> list[str]:
    """Return warnings about echoes that are not those of the modelled ground."""
    if solution.model_holds:
        return []
    bias = None if solution.rejected_by_chi2 else solution.next_range_bias(parts.line)
    wanders = "the range bias wanders with the residuals: taken as a random walk, that of another flight as long is"
    stated = "Standard deviations include the scatter of stretches, and no error that all of them share"
    return [
        *([] if bias is None else [f"{wanders} {bias[0]:.2f} ± {bias[1]:.2f} m"]),
        f"the echoes are not those of this ground: their squared residuals are {solution.reduced_chi2:.2f} times those "
        f"of speckle, and stretches of the flight differ {solution.excess:.1f} times as much as speckle lets them; "
        "plants, a coarse reference or another antenna may be the reason. "
        f"{NO_ESTIMATE if solution.rejected_by_chi2 else stated}",
    ]


def _calibrated(heard: Heard, echoes: RangeProfiles | Readings, surface: Heightfield, solution: Solution) -> Calibrated:
    before, after = (echoes.step(e, surface, (), Stage.FINE) for e in (InstrumentErrors(), solution.errors))
    pose = echoes.motion.without(solution.errors).pose
    reach_m = echoes.reach_m if isinstance(echoes, Readings) else echoes.sightings.reach_m
    hit = surface.first_hit(pose.position_m, pose.boresight, reach_m)
    maps = [_mapped(heard, errors) for errors in (InstrumentErrors(), solution.errors)]
    truth, compared = heard.source.file.truth, None
    if truth is not None and all(dem.grid == truth.surface.grid for dem in maps):
        compared = [compare_dem(dem, truth.surface, truth.lit, truth.beside_wall).lit_error for dem in maps]
    return Calibrated(
        source=heard.source.path,
        place_m=(pose.position_m + np.nan_to_num(hit)[:, None] * pose.boresight)[:, :2],
        before_m=before.residual_m,
        after_m=after.residual_m,
        sigma_m=after.sigma_m * np.sqrt(solution.scatter),
        dem=(maps[0], maps[1]),
        error=None if compared is None else (compared[0], compared[1]),
    )


def _mapped(heard: Heard, errors: InstrumentErrors) -> Raster:
    source = heard.source.corrected(errors)
    sensor = source.build_sensor()
    points = place(heard.observed.echoes, sensor, source.flight)
    profiles = heard.observed.profiles if source.keeps_profiles else None
    return source.mapper_of(points).map(points, profiles, source.pose).dem
