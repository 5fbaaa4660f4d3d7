"""Detector of ground behind volume clutter (rain, snow, dust), from single-pulse likelihoods and their neighbours.

Through a volume a pulse has at most one echo, that of the surface that ends the volume. The cells that the model
ascribes to the ground form the span of the echo; the mean of the volume left in them is part of the noise of its
estimators. Where the ground is far above the volume, the scenario's estimator gives the range; elsewhere
the posterior mean does, which also uses the end of the volume.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.detection.detector import Detections, Detector, Spectra, strongest_bins
from sionna_radar.detection.echoes import Echoes, Profiles, VolumeInFront, cut_profiles
from sionna_radar.detection.ranging.estimators import EchoSpans, Ranges
from sionna_radar.detection.volume.clutter import (
    NEAR_CELLS,
    NEIGHBOURS,
    STORM_MPS,
    TYPICAL_RATE_MM_PER_H,
    VolumeCells,
    VolumeClutter,
    VolumeMotion,
    estimated_motion,
    expected_motion,
    first_guess,
    measured_mean,
    rain_rate_of,
)
from sionna_radar.detection.volume.end import (
    FINE,
    GroundBehind,
    Views,
    VolumeEnd,
    learned_ground,
    slopes_of,
    unknown_ground,
)
from sionna_radar.detection.volume.height_track import MIN_DOWN, AxisHeights, TrackedRanges, track
from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.decibels import from_db
from sionna_radar.foundation.numerics import MAX_SPECKLE
from sionna_radar.radar.chirp import Chirp

# Minimum probability that the echo lies on the chosen surface, and that there is any ground.
MIN_PROBABILITY = 0.99
WIDTHS_OF_SPAN = 3.0
# Half-length of the window's response that spreads the shapes, in range cells.
RESPONSE_CELLS = 4
# Largest fraction of pulses whose ground may lie within the cells assumed volume-only in all pulses.
MAX_GROUND_FRACTION = 0.02
# Peak of the ground over the volume (20 dB) at which the scenario's estimator and the posterior have equal weight: side
# lobes of stronger echoes exceed the volume, and the posterior is narrower than the range cells it is computed on.
EQUAL_WEIGHT_LEVEL = 100.0
# An echo stronger by this factor is the strongest of its pulse despite speckle.
MIN_STRENGTH_RATIO = 2.0
# Log-likelihood penalty of ground outside the expected ranges, in nepers.
UNEXPECTED = float(-np.log(1 - MIN_PROBABILITY))


@dataclass(frozen=True, kw_only=True)
class ThroughVolume:
    """Detector of ground behind a volume of known mean echo."""

    detector: Detector
    end: VolumeEnd
    motion: VolumeMotion

    @property
    def volume(self) -> VolumeClutter:
        """The volume."""
        return self.end.volume

    def find(
        self,
        power: Float[np.ndarray, "pulse bin"],
        pulses: Pulses,
        sweep: Chirp,
        window_m: Float[np.ndarray, "pulse 2"] | None = None,
        on_axis: bool = False,
    ) -> Detections:
        """Return the uncorrected echoes of whole scan lines and the profiles around them.

        Parameters
        ----------
        power:
            Power spectra.
        pulses:
            Whole scan lines; only the measured pose is used.
        sweep:
            The sweep of these spectra, for the range shift by motion.
        window_m:
            Nearest and farthest range searched in each pulse; None for all ranges.
        on_axis:
            Whether ranges are those on the beam's axis; else each is in the direction where it depends least on the
            slope of the ground.

        """
        if window_m is None:
            window_m = np.tile([-np.inf, np.inf], (len(pulses), 1))
        # Line by line, so that rounding does not depend on how many lines a block holds.
        breaks = np.flatnonzero(np.diff(pulses.line)) + 1
        lines = [
            self._find_line(power[r], pulses.rows(r), sweep, window_m[r], on_axis)
            for r in np.split(np.arange(len(pulses)), breaks)
        ]
        return Detections(
            echoes=Echoes.concatenate([line.echoes for line in lines]),
            profiles=Profiles.concatenate([line.profiles for line in lines]),
        )

    def _find_line(
        self,
        power: Float[np.ndarray, "pulse bin"],
        pulses: Pulses,
        sweep: Chirp,
        window_m: Float[np.ndarray, "pulse 2"],
        on_axis: bool,
    ) -> Detections:
        end, stride = self.end, self.detector.analyser.zero_padding
        cells = power[:, ::stride][:, : end.cells]
        views = self.views(pulses, sweep, self.volume.strength(cells, end.looks, NEIGHBOURS))
        expected = _within(np.arange(cells.shape[1]) * end.cell_m, window_m)
        ratio = end.over_volume(cells, views.strength)
        # Outside the expected ranges only the end of the volume counts: where it fits better than any expected range,
        # the ground lies outside them, and no echo is reported.
        ratio = np.where(expected, ratio, np.minimum(ratio, MAX_SPECKLE))
        tilt = float(np.arctan(end.ground.slope))
        tilts = (0.0,) if on_axis else (0.0, -tilt, tilt)
        evidence = end.evidence(ratio, views, tilts) - np.where(expected, 0.0, UNEXPECTED)
        step_m = end.cell_m * self.detector.volume.height_step_cells
        heights = _heights(pulses, sweep)
        follow = partial(
            track,
            heights=heights,
            cell_m=end.cell_m,
            line=pulses.line,
            slope=end.ground.mean_slope,
            step_m=step_m,
        )
        tracked, *tilted = map(follow, evidence)
        width, peak_level = end.shape_at(ratio, np.rint(tracked.cell).astype(np.int64), views)
        strong = tracked.evidence > -np.log(self.detector.cfar.false_alarm_probability)
        accepted = strong & (tracked.probability >= MIN_PROBABILITY)
        detected = np.flatnonzero(accepted & _within(tracked.cell[:, None] * end.cell_m, window_m)[:, 0])
        place = np.arange(power.shape[1]) / stride
        in_air = end.in_air(tracked.cell, width, views.drift_m, place)
        volume = views.strength[:, None] * np.interp(place, np.arange(end.cells), self.volume.mean)
        spans = self._spans(power, volume * in_air + self.volume.noise, tracked.cell, width, detected)
        noise = spans.noise[spans.row, spans.peak]
        peak = power[spans.row, spans.peak]
        weight = 1 / (1 + (peak_level / EQUAL_WEIGHT_LEVEL) ** 4)
        moved = weight * (tilted[0].cell - tilted[1].cell) if tilted else np.zeros_like(weight)
        off_axis = self._off_axis(tracked, moved, tilt, pulses, sweep)
        ranges, reach = self._ranges(spans, off_axis, weight, detected)
        echoes = Echoes(
            pulse=pulses.index[detected],
            number=np.zeros(len(detected), dtype=np.int64),
            range_m=ranges.range_m,
            range_sigma_m=ranges.sigma_m,
            power=peak,
            echo_snr_db=10 * np.log10(peak / np.maximum(noise, np.finfo(float).tiny)),
            direction=off_axis.direction[detected],
            reach=reach,
        )
        quiet = replace(spans, noise=np.full(power.shape, self.volume.noise))
        profiles = cut_profiles(quiet, pulses.index, stride)
        in_front = VolumeInFront(
            power=profiles.of_cells(volume[:, ::stride], detected),
            in_air=profiles.of_cells(in_air[:, ::stride], detected),
            echo_m=ranges.range_m,
            echo_sigma_m=ranges.sigma_m,
            direction=off_axis.direction[detected],
            echo_reach=reach,
            drift_m=views.drift_m[detected],
            spread_m=end.spread_m,
        )
        return Detections(echoes=echoes, profiles=replace(profiles, volume=in_front))

    def _ranges(
        self,
        spans: EchoSpans,
        off_axis: "_OffAxis",
        weight: Float[np.ndarray, " pulse"],
        detected: Int[np.ndarray, " echo"],
    ) -> tuple[Ranges, Float[np.ndarray, " echo"]]:
        """Return the posterior means, blended into the scenario's estimates as the ground rises above the volume.

        weight: of the posterior means.
        Also return the correlation length of their errors, in pulses; errors of the estimates are independent.
        """
        estimated, tracked = self.detector.estimator(spans), off_axis.tracked
        cell_m, weight = self.end.cell_m, weight[detected]
        of_track, of_echo = weight * tracked.sigma[detected] * cell_m, (1 - weight) * estimated.sigma_m
        sigma = np.hypot(of_track, of_echo)
        on_axis_m = weight * tracked.cell[detected] * cell_m + (1 - weight) * estimated.range_m
        ranges = Ranges(range_m=on_axis_m + off_axis.farther_m[detected], sigma_m=sigma)
        return ranges, tracked.reach[detected] * (of_track / np.maximum(sigma, 1e-9)) ** 2

    def _off_axis(
        self,
        tracked: TrackedRanges,
        moved: Float[np.ndarray, " pulse"],
        tilt: float,
        pulses: Pulses,
        sweep: Chirp,
    ) -> "_OffAxis":
        """Return the off-axis directions in which ranges do not depend on the slope of the ground.

        Ground that rises away from the radar has a shorter echo than level ground, and ends the volume nearer. Where
        the width of a weak echo is not observable, that of level ground is assumed, and the range on the axis is too
        short, by as much as the estimated range changes when another slope is assumed. At the angle a above the axis,
        in the incidence t, the range is longer by r a tan(t), which a slope changes, too: at one angle the two cancel.
        With the variance W of ranges there that slopes make, the variance s^2 of a pulse's range is smaller by W, s^4 /
        (s^2 + W) to first order.

        moved: ranges found if ground falls by `tilt` on average less those if it rises by it, cells.
        """
        end, pose = self.end, pulses.measured
        incidence = np.arccos(np.clip(-pose.boresight[:, 2], MIN_DOWN, 1.0))[:, None] - slopes_of(end.ground.slope)
        falls, level, rises = (
            np.tan(np.minimum(incidence + turn, np.arccos(MIN_DOWN))).mean(axis=1) for turn in (tilt, 0.0, -tilt)
        )
        range_cells = np.maximum(tracked.cell, 1.0)
        per_slopes = range_cells * (falls - rises)
        angle = np.clip(-moved / per_slopes, 0.0, end.beam.sine.max())
        taken = (angle * per_slopes / 2 / tracked.alone) ** 2
        # The plane of the shapes.
        farther = range_cells * (angle * level + angle**2 * (level**2 + 0.5))
        toward = _raised(pose.boresight, angle)
        receding = pose.boresight_range_rate_mps + np.sum(pose.velocity_mps * toward, axis=1)
        return _OffAxis(
            tracked=tracked.with_variance(1 / (1 + taken)),
            direction=np.einsum("pij,pi->pj", pose.R_world_antenna, toward),
            farther_m=farther * end.cell_m - sweep.doppler_range_m(receding),
        )

    def threshold(self, spectra: Spectra) -> Float[np.ndarray, "pulse bin"]:
        """Return the greater of the CFAR's threshold and that of the volume's clutter map."""
        place = np.arange(spectra.power.shape[1]) / self.detector.analyser.zero_padding
        clutter = self.volume.clutter_threshold(self.detector.cfar.false_alarm_probability)
        return np.maximum(spectra.threshold, np.interp(place, np.arange(len(clutter)), clutter))

    def views(self, pulses: Pulses, sweep: Chirp, strength: Float[np.ndarray, " pulse"]) -> Views:
        """Return the view of volume and ground in each pulse, from its measured pose and the volume's strength."""
        boresight = pulses.measured.boresight
        return Views(
            down=-boresight[:, 2],
            drift_m=sweep.doppler_range_m(self.motion.range_rate_mps(boresight)),
            strength=strength,
        )

    def _spans(
        self,
        power: Float[np.ndarray, "pulse bin"],
        noise: Float[np.ndarray, "pulse bin"],
        cell: Float[np.ndarray, " pulse"],
        width: Float[np.ndarray, " pulse"],
        detected: Int[np.ndarray, " echo"],
    ) -> EchoSpans:
        """Return the echoes' spans, with volume and receiver noise as their noise."""
        analyser = self.detector.analyser
        stride, bins = analyser.zero_padding, power.shape[1]
        reach = WIDTHS_OF_SPAN * width + 1
        start = np.clip(np.floor((cell - reach) * stride), 0, bins - 1).astype(np.int64)
        stop = np.clip(np.ceil((cell + reach) * stride) + 1, start + 1, bins).astype(np.int64)
        return EchoSpans(
            power=power,
            noise=noise,
            row=detected,
            start=start[detected],
            stop=stop[detected],
            peak=strongest_bins(power, detected, start[detected], stop[detected]),
            bin_m=analyser.bin_m,
            looks_per_bin=analyser.looks_per_cell / stride,
            beam=self.detector.beam,
        )


@dataclass(frozen=True, kw_only=True)
class _OffAxis:
    """Tracked ranges in off-axis directions, whose ranges do not depend on the slope of the ground.

    direction: in the antenna's frame. farther_m: excess of the range there over that on the axis.
    """

    tracked: TrackedRanges
    direction: Float[np.ndarray, "pulse 3"]
    farther_m: Float[np.ndarray, " pulse"]


def _raised(
    boresight: Float[np.ndarray, "pulse 3"], angle_rad: Float[np.ndarray, " pulse"]
) -> Float[np.ndarray, "pulse 3"]:
    """Return directions raised by an angle in their vertical planes."""
    up = np.array([0.0, 0.0, 1.0]) - boresight * boresight[:, 2:]
    up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-9)
    raised: Float[np.ndarray, "pulse 3"] = np.cos(angle_rad)[:, None] * boresight + np.sin(angle_rad)[:, None] * up
    return raised


def shows_volume(detector: Detector, power: Float[np.ndarray, "pulse bin"]) -> bool:
    """Return True if spectra of pulses sampled over a survey show a volume in front of the ground."""
    return detector.beam is not None and _first_guess(detector, power) is not None


def _first_guess(detector: Detector, power: Float[np.ndarray, "pulse bin"]) -> VolumeClutter | None:
    stride = detector.analyser.zero_padding
    range_m = detector.analyser.range_m[::stride]
    first, last = _first_cell(detector), len(range_m) - 2
    guess = first_guess(power[:, ::stride], range_m, first, last)
    if guess is None:
        return None
    # Thin fog or drizzle is harmless if the strongest cell of nearly every pulse exceeds the nearest volume cells by
    # so much that these cannot be taken for an echo.
    margin = MIN_STRENGTH_RATIO if detector.kept == "strongest" else from_db(detector.dynamic_range_db)
    strongest = np.quantile(power[:, ::stride][:, first:last].max(axis=1), MAX_GROUND_FRACTION)
    return None if strongest > margin * MAX_SPECKLE * guess.mean[first] else guess


def _first_cell(detector: Detector) -> int:
    range_m = detector.analyser.range_m[:: detector.analyser.zero_padding]
    return int(np.searchsorted(range_m, detector.min_range_m))


def volume_in_front(
    detector: Detector,
    power: Float[np.ndarray, "pulse bin"],
    pulses: Pulses,
    sweep: Chirp,
    more_power: Float[np.ndarray, "more bin"],
    more_pulses: Pulses,
) -> ThroughVolume | None:
    """Return a detector through the volume seen in some spectra; None in clear air.

    Parameters
    ----------
    detector:
        The processing of the scenario.
    power:
        Spectra of pulses spread over the survey.
    pulses, sweep:
        Those pulses and their sweep.
    more_power, more_pulses:
        Further ones, which the volume's motion is estimated from.

    """
    if detector.beam is None:
        return None
    guess = _first_guess(detector, power)
    if guess is None:
        return None
    cells = power[:, :: detector.analyser.zero_padding][:, : _cells(detector, pulses, sweep)]
    guess = replace(guess, mean=guess.mean[: cells.shape[1]])
    stated = detector.volume.rain_rate_mm_per_h
    through = _learned(
        detector, guess, expected_motion(sweep.carrier_hz, stated or TYPICAL_RATE_MM_PER_H), cells, pulses, sweep
    )
    rate = stated or _rain_rate_mm_per_h(through, pulses, sweep)
    if rate not in (stated, TYPICAL_RATE_MM_PER_H):
        through = _learned(detector, guess, expected_motion(sweep.carrier_hz, rate), cells, pulses, sweep)
    motion = _motion(through, rate, more_power[:, :: detector.analyser.zero_padding], more_pulses, sweep)
    if np.array_equal(motion.velocity_mps, through.motion.velocity_mps):
        return through
    return _learned(detector, guess, motion, cells, pulses, sweep)


def _learned(
    detector: Detector,
    volume: VolumeClutter,
    motion: VolumeMotion,
    cells: Float[np.ndarray, "pulse cell"],
    pulses: Pulses,
    sweep: Chirp,
) -> ThroughVolume:
    """Estimate the volume's mean and the ground behind it alternately, for one motion and from unknown ground."""
    # Motion shifts the ranges at which the law r^-2 of the first guess appears.
    nearest_m, middle = detector.analyser.chirp.range_resolution_m, _first_cell(detector) + NEAR_CELLS // 2
    range_m = np.maximum(_still_range_m(np.arange(len(volume.mean)), detector, motion, pulses, sweep), nearest_m)
    range_m = np.hypot(range_m, detector.near_field_m)
    law = volume.mean[middle] * (range_m[middle] / range_m) ** 2
    through = _through(detector, replace(volume, mean=law), unknown_ground(), motion, pulses, sweep)
    for _ in range(detector.volume.estimation_rounds):
        through = _with_mean_and_ground(through, cells, pulses, sweep)
    return through


def _rain_rate_mm_per_h(through: ThroughVolume, pulses: Pulses, sweep: Chirp) -> float:
    """Return the rain rate whose echo is as strong as the volume's; a typical one where powers are not known in watts.

    The strength is taken from the farther half of the cells that hold volume only in nearly every pulse: there the
    shift of ranges by motion is small beside the range.
    """
    volume, echo_w = through.volume, through.detector.volume_echo_w
    cells = volume.farther
    if echo_w is None or cells.size == 0:
        return TYPICAL_RATE_MM_PER_H
    range_m = _still_range_m(cells, through.detector, through.motion, pulses, sweep)
    reflectivity_per_m = float(np.mean(volume.mean[cells] * (range_m**2 + through.detector.near_field_m**2))) / echo_w
    return rain_rate_of(reflectivity_per_m, float(range_m.mean()), sweep.carrier_hz)


def _still_range_m(
    cell: Int[np.ndarray, " cell"], detector: Detector, motion: VolumeMotion, pulses: Pulses, sweep: Chirp
) -> Float[np.ndarray, " cell"]:
    """Return the ranges of cells less the mean shift by the motion of platform and volume."""
    pose = pulses.measured
    rate_mps = pose.boresight_range_rate_mps + motion.range_rate_mps(pose.boresight)
    shift_m = float(sweep.doppler_range_m(rate_mps).mean())
    return cell * detector.analyser.chirp.range_resolution_m - shift_m


def _through(
    detector: Detector,
    volume: VolumeClutter,
    ground: GroundBehind,
    motion: VolumeMotion,
    pulses: Pulses,
    sweep: Chirp,
) -> ThroughVolume:
    analyser = detector.analyser
    assert detector.beam is not None
    down = np.maximum(-pulses.measured.boresight[:, 2], 0.0)
    end = VolumeEnd(
        volume=volume,
        ground=ground,
        spread_m=abs(float(sweep.doppler_range_m(motion.fall_spread_mps * down).mean())),
        beam=detector.beam,
        cell_m=analyser.chirp.range_resolution_m,
        looks=analyser.looks_per_cell,
        response=analyser.response(RESPONSE_CELLS * FINE, FINE),
        first=_first_cell(detector),
        cells=_cells(detector, pulses, sweep),
        floor_share=detector.volume.floor_share,
        width_spread_nepers=detector.volume.width_spread_nepers,
    )
    return ThroughVolume(detector=detector, end=end, motion=motion)


def _cells(detector: Detector, pulses: Pulses, sweep: Chirp) -> int:
    """Return the number of range cells that can contain ground.

    Approaching drops next to the radar have a negative beat frequency, which I/Q sampling shows at the far end.
    """
    analyser = detector.analyser
    count = len(analyser.range_m[:: analyser.zero_padding])
    if sweep.sampling == "real":
        return count
    approach_mps = np.abs(pulses.measured.boresight_range_rate_mps) + STORM_MPS
    folded_m = float(np.abs(sweep.doppler_range_m(approach_mps)).max())
    return count - int(np.ceil(folded_m / sweep.range_resolution_m)) - 2 * RESPONSE_CELLS


def _with_mean_and_ground(
    through: ThroughVolume, cells: Float[np.ndarray, "pulse cell"], pulses: Pulses, sweep: Chirp
) -> ThroughVolume:
    """Estimate the volume's mean from the cells before the ground, and the level and slope of the ground."""
    end, volume, options = through.end, through.volume, through.detector.volume
    strength = volume.strength(cells, end.looks, 0)
    views = through.views(pulses, sweep, strength)
    likelihood, ground = end.by_slope_and_level(end.over_volume(cells, strength), views)
    learned = replace(learned_ground(end.ground.level, likelihood), cell=int(np.median(ground)))
    spread = np.sqrt(end.beam.power @ end.beam.sine**2)
    width = ground * spread * np.sqrt(1 / np.maximum(views.down, 0.05) ** 2 - 1 + 0.1)
    volume_end = ground - options.widths_before * width - options.cells_before
    volume_only = (np.arange(end.cells) < volume_end[:, None]) & (np.arange(end.cells) >= end.first)
    range_m = end.cell_m * np.arange(end.cells)
    mean = measured_mean(volume, cells / strength[:, None], volume_only, range_m, options.smoothed_cells)
    near = (end.first, max(int(np.quantile(volume_end, MAX_GROUND_FRACTION)), end.first))
    uniform = replace(volume, mean=mean, near=near, uneven=0.0)
    updated = replace(uniform, uneven=uniform.unevenness(cells, end.looks, options.smoothed_cells))
    return _through(through.detector, updated, learned, through.motion, pulses, sweep)


def _motion(
    through: ThroughVolume,
    rain_rate_mm_per_h: float,
    cells: Float[np.ndarray, "pulse cell"],
    pulses: Pulses,
    sweep: Chirp,
) -> VolumeMotion:
    """Return the motion of the volume, about that of rain of a rate."""
    end, volume, pose = through.end, through.volume, pulses.measured
    strength = volume.strength(cells, end.looks, 0)[:, None]
    near = np.arange(*volume.near)
    only = VolumeCells(
        power=np.minimum(cells[:, near] / strength, MAX_SPECKLE * volume.background[near]),
        noise=volume.noise / strength,
        range_m=near * end.cell_m,
        shift_m=float(sweep.doppler_range_m(np.ones(1))[0]),
        boresight=pose.boresight,
        platform_mps=pose.boresight_range_rate_mps,
        looks=end.looks,
        near_field_m=through.detector.near_field_m,
        margin_m=2 * RESPONSE_CELLS * end.cell_m,
        uneven=volume.uneven,
    )
    return estimated_motion(sweep.carrier_hz, rain_rate_mm_per_h, only)


def _within(
    range_m: Float[np.ndarray, "#pulse place"] | Float[np.ndarray, " place"], window_m: Float[np.ndarray, "pulse 2"]
) -> Bool[np.ndarray, "pulse place"]:
    """Return the mask of ranges inside the window of each pulse."""
    return np.asarray((range_m >= window_m[:, :1]) & (range_m <= window_m[:, 1:]))


def _heights(pulses: Pulses, sweep: Chirp) -> AxisHeights:
    pose = pulses.measured
    shift_m = sweep.doppler_range_m(pose.boresight_range_rate_mps)
    return AxisHeights(position_m=pose.position_m, boresight=pose.boresight, shift_m=shift_m)
