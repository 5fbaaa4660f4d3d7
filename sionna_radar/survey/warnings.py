"""Warnings about the result of a survey, each with a remedy."""

import logging
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.ndimage import maximum_filter1d

from sionna_radar.accuracy.truth import Comparison
from sionna_radar.accuracy.uncertainty import calibration
from sionna_radar.detection.angle.array_arrival import ArrayEstimator
from sionna_radar.detection.angle.arrival import AngleEstimator
from sionna_radar.detection.angle.row import RowEstimator
from sionna_radar.detection.angle.segments import range_strips
from sionna_radar.detection.volume.clutter import NEAR_CELLS
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.decibels import to_db
from sionna_radar.foundation.raster import Raster
from sionna_radar.inference.terrain.uncertainty import TiledUncertainty, Uncertainty
from sionna_radar.mapping.linear.linear import LinearUncertainty
from sionna_radar.mapping.mapper import CanopyMap, Estimate
from sionna_radar.mapping.options import CanopyParameters
from sionna_radar.mapping.points import Points
from sionna_radar.radar.mimo_array import MimoArray
from sionna_radar.scenario.radar import NEEDED
from sionna_radar.signal.build import rounding_over_noise
from sionna_radar.survey.beam_bias import beam_bias, maps_by_turning, unmodelled_bias_warnings
from sionna_radar.survey.cover_shifts import cover_remedy, cover_shifts, cover_warnings
from sionna_radar.survey.folded_directions import folded_likeness
from sionna_radar.survey.observation import Observed
from sionna_radar.survey.preparation import Prepared
from sionna_radar.survey.strip import LEAST_ON_STRIP, on_a_strip, strip_width_m
from sionna_radar.survey.unmodelled_ground import TIMES_STATED_WARNED, expected_ground_warnings, plant_warnings
from sionna_radar.tracing.paths import Paths

logger = logging.getLogger("sionna_radar")

# Keys that raise echoes, by the sensor.
LOUDER = {
    "radar": "radar.snr_db or radar.transmit_power_dbm",
    "mimo": "radar.snr_db or radar.transmit_power_dbm",
    "lidar": "lidar.clear_range_m, lidar.ground_reflectivity or lidar.reflectivities",
}
# Spread over the survey, by which warnings know how the antenna looks at the ground.
WARNED_PULSES = 200

# Warn below this share of filled lit cells, and above this share of pulses without an echo.
MIN_COVERAGE, MAX_SILENT = 0.2, 0.5
# Rain echoes lie tens of metres above the ground; a few ruin a DEM.
RAIN_FRACTION_WARNED = 0.01
# By so much a range cell may lie off across the one axis of a second receiver, in all but a share of the pulses: with a
# beam of 8 deg at 71 m a speckled cell then moves points by some 0.2 m.
STRIP_OFF_RAD, STRIP_SHARE_WARNED = np.deg2rad(15.0), 0.1
# Share of echoes unexplained by a map without walls above which a warning is given.
UNEXPLAINED_FRACTION_WARNED = 0.01
# Of its width, by which the beam may turn within the averaged chirps of a pulse, in all but a share of the pulses.
TURNED_WIDTHS_WARNED, TURNED_SHARE_WARNED = 0.5, 0.1
# Widest gap between virtual elements of a filled array, wavelengths: half of one, and a little.
LARGEST_GAP = 0.55
# Fewest places of virtual elements, over their number: boards that check their channels by doubled ones have more.
LEAST_PLACES = 2 / 3
# Fewest cells of range rate within the beam of an array.
LEAST_RATES = 4
# Greatest likeness of directions that fold into one cell: above it 0.7 to 30 % of the points of strong echoes lay
# beyond 5 sigma (14 flights over hills and level ground), of the same modules with nothing folded up to 0.1 %.
LARGEST_LIKENESS = 0.5
# Share of the lit cells in intervals of 95 % below which a warning is given, and fewest cells for it.
LEAST_IN_95, LEAST_CELLS = 0.8, 100
# Height of plants over that of the tallest that are looked for above which they may be taller, and share of such cells.
NEAR_TALLEST, MANY_TALLEST = 0.9, 0.05
# Share of echoes that are leakage above which a warning is given.
LEAKED_SHARE_WARNED = 0.01
# Share of clipped pulses above which a warning is given.
SATURATED_FRACTION_WARNED = 0.001
LOWER = "fly lower, or narrow the beam"


def warnings_of(
    echoes: int,
    rain_echoes: int,
    lost_pulses: int = 0,
    pulses: int = 0,
    falling: str = "rain",
    window_key: str | None = None,
    *,
    stepped_behind_volume: bool = False,
    remedy: str = LOWER,
    louder: str = "radar.snr_db or radar.transmit_power_dbm",
) -> Iterator[str]:
    """Yield the warnings about a result: no echo at all, or what falls (rain, snow, dust) in front of the ground.

    lost_pulses: those of `pulses` in which rain masks the ground. window_key: limits the ranges that are searched.
    remedy: against echoes of what falls. louder: keys that raise echoes.
    """
    elsewhere = f"; or the ground lies outside {window_key}: check its heights, or raise its tolerance_m"
    window = elsewhere if window_key else ""
    # No weather was asked for: what fills the beam may be the receiver's own.
    clear = "; or, if nothing is in the air, set processing.volume_clutter = 'off'" if falling == "air" else ""
    masked = lost_pulses > RAIN_FRACTION_WARNED * max(pulses, 1)
    if echoes == 0 and not masked:
        yield f"no echo was detected; raise {louder}, or fly lower{window}"
        return
    if echoes > 0 and rain_echoes > RAIN_FRACTION_WARNED * echoes:
        count = f"{rain_echoes:,} of {echoes:,}"
        yield (
            f"{f'most echoes ({count})' if 2 * rain_echoes > echoes else f'{count} echoes'} come from the {falling} in "
            f"front of the ground, and the DEM is wrong or empty there; {remedy}"
        )
    if stepped_behind_volume:
        yield (
            f"{falling}: dem.method = 'stepped' mistakes parts of its echo for walls and roofs; set dem.method = "
            f"'refined' or 'linear'{clear}"
        )
    if masked:
        yield (
            f"{falling}: {lost_pulses:,} of {pulses:,} pulses ({lost_pulses / pulses:.1%}) do not separate the ground "
            f"from the {falling} in front of it, and the DEM is empty where no neighbour does; {LOWER}{window}"
            f"{clear}"
        )


def map_warnings(
    points: Points, pulses: int, filled: int, coverage: float, spacing_m: float, louder: str, *, directed: bool = False
) -> Iterator[str]:
    """Yield the warnings about a map along a line, an empty map, or one with few lit cells filled.

    louder: keys that raise echoes. directed: whether points are echoes whose direction was measured.
    """
    if len(points) == 0:
        return
    silent = pulses - len(np.unique(points.pulse))
    if silent > MAX_SILENT * pulses:
        silent_text = f"{silent:,} of {pulses:,} pulses ({silent / pulses:.0%})"
        if directed:
            yield f"{silent_text} have no direction of arrival; change radar.second_receiver, or raise {louder}"
        else:
            yield f"{silent_text} have no echo; raise {louder}, or fly lower"
        if len(points) < LEAST_ON_STRIP:
            return
    spread_by_noise = points.spread_by_noise
    if spread_by_noise or on_a_strip(points, spacing_m):
        noise = ", spread by the noise of their ranges" if spread_by_noise else ""
        yield (
            f"all echoes lie on a strip {strip_width_m(points):.1f} m wide{noise}, of which no map can be made; scan "
            "across it (radar.scan.mode = 'whisk_broom' or 'conical') within the flight, or fly platform.lines side by "
            "side"
        )
    elif coverage < MIN_COVERAGE:
        silent_text = "no cell that the beam reached is" if filled == 0 else f"{coverage:.0%} of the lit cells are"
        remedy = "fly a longer track, scan faster or fly slower, or raise dem.spacing_m"
        yield f"{silent_text} filled: echoes lie farther apart than dem.max_gap_m; {remedy}"


def steered_warnings(beams: int, method: str, profiles: str) -> Iterator[str]:
    """Yield the warning about a DEM method that models every beam of an electronic scan as broadside."""
    if beams and profiles != "unused":
        yield f"dem.method = {method!r} models every beam of the scan as the narrower broadside beam; 'linear' does not"


def direction_warnings(angle: AngleEstimator | ArrayEstimator | None, sampled: Pose, points: int) -> Iterator[str]:
    """Yield the warnings about range cells that are not across the axis of a single second receiver."""
    if not isinstance(angle, AngleEstimator):
        return
    row = isinstance(angle, RowEstimator)
    if row or len(set(angle.axes)) == 1:
        axis = angle.axes[-1]
        off = np.arccos(np.clip(np.abs(range_strips(sampled, angle.spread).climb[:, axis]), 0.0, 1.0))
        fraction = float(np.mean(off > STRIP_OFF_RAD))
        if fraction > STRIP_SHARE_WARNED:
            harm = (
                "the row's axis, and their spread is interpreted as a second surface; set radar.scan.mode = 'conical'"
                if row
                else "the second receiver's axis, and their speckle is interpreted as height; set "
                "radar.second_receiver.axis = 'both'"
            )
            yield (
                f"in {fraction:.0%} of the pulses range cells lie across the beam by more than "
                f"{np.rad2deg(STRIP_OFF_RAD):.0f} deg off {harm}"
            )
    if points == 0:
        yield "no direction was found for any echo; raise radar.snr_db, or change radar.second_receiver"


def unexplained_warnings(uncertainty: Uncertainty | None, echoes: int, method: str) -> Iterator[str]:
    """Yield the warning about a map without steps over ground with objects."""
    count = uncertainty.unexplained if isinstance(uncertainty, TiledUncertainty) else 0
    if count > UNEXPLAINED_FRACTION_WARNED * echoes:
        yield (
            f"{count:,} of {echoes:,} echoes do not fit the surface of dem.method = {method!r}, which does not model "
            "walls: poles, buildings or trees stand on the ground, and `dem_sigma.tif` is widened around them; compare "
            "with 'linear', or map buildings with 'stepped'"
        )


def misfit_warnings(uncertainty: Uncertainty | None) -> Iterator[str]:
    """Yield the warning about ground that differs more between scan lines than the terrain model says."""
    misfit = uncertainty.misfit if isinstance(uncertainty, LinearUncertainty | TiledUncertainty) else 1.0
    if misfit > 1:
        yield (
            f"heights along a scan line lie {misfit:.1f} times farther from what the other lines predict than the "
            "terrain model states, as where walls or banks run along the lines: `dem_sigma.tif` is widened by as much, "
            "and may still be too small beside walls; fly lines that cross them, or closer ones (a faster scan, or a "
            "slower flight)"
        )


def shared_warnings(points: Points, cell_m: float, falling: str) -> Iterator[str]:
    """Yield the warning about heights that rain may have moved together by more than a range cell."""
    off_m = points.shared_height_sigma_m
    if off_m > cell_m:
        yield (
            f"behind the {falling} all heights may be off together by {off_m:.2g} m (standard deviation, in "
            f"`dem_sigma.tif`): the survey hardly tells how the {falling} moves, which shifts its range, or how "
            "bright the ground is; raise radar.chirp_rate_hz, for shorter sweeps, or narrow the beam"
        )


def _doppler_warnings(prepared: Prepared, points: Points) -> Iterator[str]:
    """Yield the warning about ranges that keep the Doppler shift of the radar's own motion."""
    sweeps = prepared.receiver.sweeps
    if prepared.local.processing.doppler_correction or len(sweeps) > 1 or len(points) == 0:
        return
    pose = prepared.flight.sample(WARNED_PULSES).measured
    shift_m = float(np.median(np.abs(sweeps[0].doppler_range_m(pose.boresight_range_rate_mps))))
    if shift_m > np.median(points.range_sigma_m):
        yield (
            f"ranges keep the Doppler shift of the radar's own motion, {shift_m:.2g} m in the median, which no stated "
            "uncertainty holds; set processing.doppler_correction = true"
        )


def _burst_warnings(prepared: Prepared) -> Iterator[str]:
    """Yield the warning about beams that turn while the chirps of a pulse are averaged."""
    chirps, width_rad = prepared.local.processing.average.chirps, min(prepared.instrument.antenna.beamwidths_rad)
    if chirps == 1 or len(prepared) < 2:
        return
    here = prepared.flight.sample(WARNED_PULSES).index
    here = here[here + 1 < len(prepared)]
    ahead, next_ahead = (prepared.flight.pulses(index).measured.boresight for index in (here, here + 1))
    to_next = np.arccos(np.clip(np.einsum("pi,pi->p", ahead, next_ahead), -1, 1))
    turn_rad = to_next * (chirps - 1) / chirps
    turned = turn_rad > TURNED_WIDTHS_WARNED * width_rad
    if np.mean(turned) > TURNED_SHARE_WARNED:
        turn_deg, width_deg = np.rad2deg([np.median(turn_rad[turned]), width_rad])
        yield (
            f"the beam of {width_deg:.3g} deg turns by {turn_deg:.3g} deg within the {chirps} chirps of a pulse, whose "
            "average is that of different ground; lower processing.average.chirps or the speed of the scan, or raise "
            "radar.chirp_rate_hz"
        )


def _leakage_warnings(prepared: Prepared, points: Points) -> Iterator[str]:
    """Yield the warning about echoes that are the transmitter's leakage, or side lobes of it."""
    local, detector = prepared.local, prepared.instrument.detector
    table = local.radar.receiver
    kept = local.sensor == "radar" and bool(table.leakage) and detector.leakage == "keep"
    # A coherent average weakens leakage by the phases that it turns for the ground.
    if not kept or len(points) == 0 or local.processing.average.chirps > detector.analyser.averaged:
        return
    pulses = prepared.flight.sample(WARNED_PULSES)
    alone = replace(detector.analyser, averaged=1).power(prepared.receiver.beats(Paths.none(), pulses)[0]).mean(axis=0)
    # The power of an echo is that of its strongest cell, within the main lobe from its range.
    alone = maximum_filter1d(alone, 2 * detector.lobe_cells * detector.analyser.zero_padding + 1)
    shift_m = np.zeros(len(points))
    if len(prepared.receiver.sweeps) == 1:
        shift_m = detector.shift_m(prepared.flight.pulses(np.unique(points.pulse)).measured)[
            np.unique(points.pulse, return_inverse=True)[1]
        ]
    place = np.rint((points.range_m + shift_m) / detector.analyser.bin_m).astype(np.int64) - detector.analyser.first_bin
    share = float(np.mean(2 * alone[np.clip(place, 0, len(alone) - 1)] > points.power))
    if share > LEAKED_SHARE_WARNED:
        yield (
            f"{share:.0%} of the echoes lie where radar.receiver.leakage has at least half of their power, and are no "
            "ground; set processing.leakage = 'subtract', or raise processing.min_range_m"
        )


def saturation_warnings(saturated_pulses: int, pulses: int, headroom_db: float | None) -> Iterator[str]:
    """Yield the warning about pulses that exceed the full scale of the converter; headroom None: a fixed gain."""
    if saturated_pulses > SATURATED_FRACTION_WARNED * pulses:
        remedy = "lower the gain, or set agc_headroom_db" if headroom_db is None else "raise agc_headroom_db"
        yield (
            f"{saturated_pulses:,} of {pulses:,} pulses ({saturated_pulses / pulses:.1%}) exceed the full scale of "
            f"radar.receiver.converter and are clipped; {remedy}"
        )


def _velocity_seen_mps(prepared: Prepared) -> Float[np.ndarray, "3"]:
    """Return the velocity in the middle of the flight, in the antenna's frame."""
    pose = prepared.flight.pulses(np.array([len(prepared) // 2])).measured
    return pose.R_world_antenna[0].T @ pose.velocity_mps[0]


def array_warnings(
    array: MimoArray,
    half_view_rad: float,
    beamwidths_rad: tuple[float, float],
    velocity_mps: Float[np.ndarray, "3"],
    height_m: float,
    cell_m: float,
    falling: str = "",
) -> Iterator[str]:
    """Yield the warnings about an array, the angles it is looked at, and its frames on a flight.

    beamwidths_rad: half-power widths of an element's pattern, along the left and the up axis.
    velocity_mps: in the antenna's frame.
    """
    speed_mps, up_beamwidth_rad = float(np.linalg.norm(velocity_mps)), beamwidths_rad[1]
    if falling:
        yield (
            f"{falling} fills all cells in front of the ground, and an array does not separate it from ground: the "
            "map is "
            "mostly wrong by metres, as dem_sigma.tif says; fly in clear air, or take a pencil beam (sensor = 'radar')"
        )
    gap, doubled = array.widest_gap_wavelengths, int(np.count_nonzero(array.duplicates > 1))
    if gap > LARGEST_GAP and gap * 2 * np.sin(half_view_rad) > 1:
        apart_deg = float(np.rad2deg(np.arcsin(min(1.0, 1 / gap))))
        yield (
            f"a gap of {gap:.3g} wavelengths between virtual elements repeats beams {apart_deg:.0f} deg apart, within "
            f"the {np.rad2deg(half_view_rad):.0f} deg of radar.array.half_view_deg; fill it, or lower half_view_deg to "
            f"{np.rad2deg(np.arcsin(min(1.0, 0.5 / gap))):.0f}"
        )
    if len(array.duplicates) < LEAST_PLACES * array.channels:
        yield (
            f"{doubled} places of virtual elements are occupied more than once: {array.channels} channels make "
            f"{len(array.duplicates)} places; move transmitters or receivers of radar.array apart"
        )
    across = np.cross([1.0, 0.0, 0.0], velocity_mps)
    extent = float(np.ptp(array.virtual_m @ across)) / max(float(np.linalg.norm(across)), 1e-9) / array.wavelength_m
    if np.linalg.norm(across) > 0 and extent <= LARGEST_GAP:
        yield (
            f"the array extends {extent:.2g} wavelengths across the motion, which is all that tells directions of one "
            "range rate apart, such as left and right of the track; place elements apart there (a side-looking module "
            "has its left axis along the track, and its up axis across it), or turn it by radar.scan"
        )
    ahead_mps = speed_mps * float(np.sin(up_beamwidth_rad / 2))
    if (alike := folded_likeness(array, half_view_rad, beamwidths_rad, velocity_mps)) > LARGEST_LIKENESS:
        yield (
            f"range rates fold at {array.highest_rate_mps:.3g} m/s, where {alike:.0%} of the signals of some "
            "directions in the beam are those of others in view: points are left out, and where echoes are strong some "
            "lie metres off; fly slower, raise radar.chirp_rate_hz, use fewer transmitters, or lower "
            "radar.array.half_view_deg to the beam"
        )
    if 2 * ahead_mps < LEAST_RATES * array.rate_cell_mps:
        yield (
            f"range rates within the beam span {2 * ahead_mps / array.rate_cell_mps:.2g} cells of "
            f"{array.rate_cell_mps:.3g} m/s, too few to sharpen it along the track; raise radar.array.chirps or fly "
            "faster"
        )
    dwell_s = height_m * 2 * float(np.tan(up_beamwidth_rad / 2)) / max(speed_mps, 1e-9)
    if array.duration_s > dwell_s:
        yield (
            f"a frame of {1e3 * array.duration_s:.3g} ms is longer than the {1e3 * dwell_s:.3g} ms for which ground "
            "stays within the beam; lower radar.array.chirps"
        )
    elif (moved_m := ahead_mps * array.duration_s) > cell_m:
        yield (
            f"ground moves by {moved_m:.3g} m in range during a frame, more than a cell of {cell_m:.3g} m; lower "
            "radar.array.chirps or radar.bandwidth_hz"
        )


def _against_rain(prepared: Prepared, observed: Observed) -> str:
    """Return the remedy against echoes of what falls in front of the ground."""
    if prepared.local.processing.volume_clutter == "off":
        return "set processing.volume_clutter = 'auto'"
    ground_cells = prepared.plan.flown.altitude_m / prepared.receiver.chirp.range_resolution_m
    if not observed.behind_volume and ground_cells < NEAR_CELLS:
        told = "too few range cells lie before the ground to tell it from what falls"
        return f"{told}: raise radar.bandwidth_hz, or fly higher"
    return LOWER


def survey_warnings(
    prepared: Prepared,
    observed: Observed,
    points: Points,
    comparison: Comparison,
    estimate: Estimate,
    of_navigation: Raster | None,
) -> tuple[str, ...]:
    """Return the warnings about a survey's result, and log those not logged during preparation.

    of_navigation: standard deviation of the map due to stated navigation errors; None if none are stated.
    """
    local, mapper, angle, echoes = prepared.local, prepared.mapper, prepared.angle, len(observed.echoes)
    warnings = list(prepared.plan.flown.warnings)
    if echoes > 0 or not isinstance(angle, AngleEstimator):  # which says more than that there is no echo
        warnings += warnings_of(
            echoes,
            0 if observed.hits is None else observed.hits.rain_echoes,
            observed.lost,
            len(prepared),
            local.weather.filling or "air",
            None if prepared.plan.expected_ground is None else "processing.expected_ground",
            stepped_behind_volume=mapper.name == "stepped" and observed.behind_volume,
            remedy=_against_rain(prepared, observed),
            louder=_keys_that_raise_echoes(prepared),
        )
    warnings += direction_warnings(angle, prepared.flight.sample(WARNED_PULSES).measured, echoes)
    if local.processing.angle == "off" and (second := local.radar.second_receiver) is not None:
        fitting = next(name for name, kind in NEEDED.items() if kind == second.kind)
        warnings.append(f"radar.second_receiver is not used; set processing.angle = {fitting!r}, or remove it")
    warnings += _burst_warnings(prepared)
    if isinstance(angle, ArrayEstimator):
        warnings += array_warnings(
            angle.array,
            angle.half_view_rad,
            prepared.instrument.antenna.beamwidths_rad,
            _velocity_seen_mps(prepared),
            prepared.plan.flown.altitude_m,
            prepared.receiver.chirp.range_resolution_m,
            local.weather.falling,
        )
    warnings += _leakage_warnings(prepared, points)
    warnings += _doppler_warnings(prepared, points)
    headroom_db = local.radar.receiver.converter.agc_headroom_db
    warnings += saturation_warnings(observed.saturated_pulses, len(prepared), headroom_db)
    lit, louder = comparison.lit_error, _keys_that_raise_echoes(prepared)
    directed = isinstance(angle, AngleEstimator)
    spacing_m = mapper.grid.spacing_m
    warnings += map_warnings(points, len(prepared), lit.count, lit.coverage, spacing_m, louder, directed=directed)
    warnings += unexplained_warnings(estimate.uncertainty, echoes, mapper.name)
    warnings += misfit_warnings(estimate.uncertainty)
    warnings += shared_warnings(points, prepared.receiver.chirp.range_resolution_m, local.weather.filling or "air")
    warnings += steered_warnings(len(prepared.instrument.beams), mapper.name, mapper.method.profiles)
    names = [f"[[{name}]]" for name in ("vegetation", "targets", "wires", "poles", "fences") if getattr(local, name)]
    if local.lidar.model == "as_built":
        names = [name for name in names if name != "[[vegetation]]"]
    if local.sensor == "lidar" and names:
        warnings.append(
            f"the lidar does not model {' and '.join(names)} and measures the ground behind; remove them where it is "
            "compared with a radar"
        )
    warnings += _beam_warnings(prepared, estimate)
    warnings += _canopy_warnings(prepared, estimate.canopy)
    if echoes > 0:  # otherwise said above
        warnings += expected_ground_warnings(prepared)
    warnings += plant_warnings(prepared, comparison, estimate)
    warnings += interval_warnings(comparison, estimate.sigma, of_navigation)
    remedy = None if estimate.sigma is None else cover_remedy(prepared, observed)
    if remedy is not None:
        warnings += cover_warnings(cover_shifts(prepared), comparison.error, estimate.sigma, remedy)
    for warning in warnings:
        logger.warning("%s", warning)
    return (*prepared.warnings, *warnings)


def _beam_warnings(prepared: Prepared, estimate: Estimate) -> Iterator[str]:
    """Yield the warning about a beam whose bias a map neither takes out nor states."""
    mapper = prepared.mapper
    paired = len(prepared.receiver.sweeps) > 1  # without range profiles, whatever the method
    without_profiles = paired or mapper.method.profiles == "unused"
    placed_on_axis = without_profiles and prepared.angle is None and prepared.local.sensor == "radar"
    if placed_on_axis and mapper.beam is not None and maps_by_turning(prepared.flight):
        # At a wall it is not the slope that biases, and no map without steps takes that out.
        bias = beam_bias(prepared.flight, prepared.world, mapper.beam).off_walls(prepared.truth.walls)
        remedy = "radar.sweep = 'up' and dem.method = 'refined'" if paired else "dem.method = 'refined'"
        yield from unmodelled_bias_warnings(bias, estimate.sigma, remedy)


def _canopy_warnings(prepared: Prepared, canopy: CanopyMap | None) -> Iterator[str]:
    """Yield the warning about plants that are taller than what a map looks for."""
    options = prepared.local.dem.method_parameters
    tallest_m = options.max_plants_m if isinstance(options, CanopyParameters) else CanopyParameters().max_plants_m
    if canopy is not None and np.any(canopy.plants.height_m > 0.5):
        height_m = canopy.height.height_m[canopy.plants.height_m > 0.5]
        share = float(np.mean(height_m > NEAR_TALLEST * tallest_m))
        if share > MANY_TALLEST:
            yield (
                f"{share:.0%} of the cells with plants reach dem.method_parameters.max_plants_m = {tallest_m:g} m, the "
                "tallest that are looked for: under taller ones the ground comes out too high; raise it"
            )


def interval_warnings(
    comparison: Comparison, sigma: Raster | None, of_navigation: Raster | None = None
) -> Iterator[str]:
    """Yield the warning about intervals that hold far fewer true heights than they state, or miss some by far.

    sigma: of the map; of_navigation: due to stated navigation errors, beside it; None if none are stated.
    """
    if sigma is None:
        return
    compared = comparison.lit & comparison.error.filled & sigma.filled
    stated_m, files = sigma.height_m, "`dem_sigma.tif` states"
    if of_navigation is not None:
        stated_m = np.hypot(stated_m, np.where(of_navigation.filled, of_navigation.height_m, 0.0))
        files = "`dem_sigma.tif` and `dem_sigma_navigation.tif` state together"
    if compared.sum() >= LEAST_CELLS:
        error_m, sigma_m = comparison.error.height_m[compared], stated_m[compared]
        coverage = calibration(error_m, sigma_m).coverage["95"]
        rms_m, usual_m = (float(np.sqrt(np.mean(each**2))) for each in (error_m, sigma_m))
        if coverage >= LEAST_IN_95 and rms_m > TIMES_STATED_WARNED * usual_m:
            yield (
                f"the lit cells err by {rms_m:.2g} m RMS, where {files} {usual_m:.2g} m: intervals of 95 % contain "
                f"{coverage:.0%} of them, and some of the others lie far outside; `dem_uncertainty` in summary.json "
                "shows where. Narrow the beam, fly closer lines, or compare with another dem.method"
            )
        if coverage < LEAST_IN_95:
            yield (
                f"the intervals of 95 % that {files} contain {coverage:.0%} of the lit cells: errors exceed the stated "
                "uncertainty; `dem_uncertainty` in summary.json shows where. Narrow the beam, or compare with another "
                "dem.method"
            )


def _keys_that_raise_echoes(prepared: Prepared) -> str:
    """Return the keys that raise echoes over what hides them."""
    radar = prepared.local.radar
    rounding = rounding_over_noise(radar, prepared.receiver) if prepared.local.sensor == "radar" else None
    if rounding is None or rounding <= 1:
        return LOUDER.get(prepared.local.sensor, LOUDER["radar"])
    key = "bits" if radar.receiver.converter.full_scale_dbm is None else "gain_db"
    return f"radar.receiver.converter.{key} (its rounding lies {to_db(rounding):.0f} dB over the thermal noise)"
