"""Detector of ground behind volume clutter (rain, snow, dust), from single-pulse likelihoods and their neighbours.

Through a volume a pulse has at most one echo of the ground, which ends the volume. The cells that the model
ascribes to the ground form the span of the echo; the mean of the volume left in them is part of the noise of its
estimators. Where the ground is far above the volume, the scenario's estimator gives the range; elsewhere
the posterior mean does, which also uses the end of the volume.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.detection.detector import Detections, Detector, Spectra, strongest_bins
from sionna_radar.detection.echoes import Echoes, Profiles, VolumeInFront, cut_profiles
from sionna_radar.detection.ranging.estimators import EchoSpans, Ranges
from sionna_radar.detection.volume.clutter import NEIGHBOURS, VolumeClutter, VolumeMotion
from sionna_radar.detection.volume.end import ByWidth, Views, VolumeEnd
from sionna_radar.detection.volume.ground import SLOPES, mean_tangent
from sionna_radar.detection.volume.height_track import AxisHeights, TrackedRanges, line_likelihood, track
from sionna_radar.detection.volume.in_front import spans_in_front, with_echoes_in_front, without_spans
from sionna_radar.detection.volume.shapes import FINE
from sionna_radar.flight.frames import MIN_GRAZING_SINE
from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.numerics import MAX_SPECKLE
from sionna_radar.radar.chirp import Chirp

# Minimum probability that the echo lies on the chosen surface, and that there is any ground.
MIN_PROBABILITY = 0.99
WIDTHS_OF_SPAN = 3.0
# Peak of the ground over the volume (20 dB) at which the scenario's estimator and the posterior have equal weight: side
# lobes of stronger echoes exceed the volume, and the posterior is narrower than the range cells it is computed on.
EQUAL_WEIGHT_LEVEL = 100.0
# Log-likelihood penalty of ground outside the expected ranges, in nepers.
UNEXPECTED = float(-np.log(1 - MIN_PROBABILITY))


@dataclass(frozen=True, kw_only=True)
class ThroughVolume:
    """Detector of ground behind a volume of known mean echo.

    shared_sigma_m: standard deviation of a range error that all pulses share; see `VolumeEnd.shared_sigma_cells`.
    """

    detector: Detector
    end: VolumeEnd
    motion: VolumeMotion
    shared_sigma_m: float = 0.0

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
            Whether only the ground is returned, with ranges on the beam's axis; else each of its ranges is in the
            direction where it depends least on the slope of the ground.

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
        in_front = None
        if self.detector.behind_volume == "all" and not on_axis:
            in_front = self._in_front(power, ratio, views, pulses, sweep, window_m)
            ratio = without_spans(ratio, in_front, self.detector)
        # Outside the expected ranges only the end of the volume counts: where it fits better than any expected range,
        # the ground lies outside them, and no echo is reported. Among folded particles, single near ones stand out of
        # the volume's mean as ground does, so that only its end counts as well.
        told = expected & (np.arange(cells.shape[1]) * end.cell_m >= self._folded_m(views)[:, None])
        ratio = np.where(told, ratio, np.minimum(ratio, MAX_SPECKLE))
        step_m = end.cell_m * self.detector.volume.height_step_cells
        heights = _heights(pulses, sweep)
        level_weight = end.ground.level_weight_in(pulses)
        by_width, unexpected = end.by_width(ratio, views, level_weight), np.where(expected, 0.0, UNEXPECTED)
        end = self._with_slope(by_width, views, unexpected, heights, step_m)
        slope = end.ground.slope
        tilt = float(np.arctan(slope))
        tracked, *tilted = (
            track(evidence - unexpected, heights, end.cell_m, pulses.line, slope, step_m)
            for turn in ((0.0,) if on_axis else (0.0, -tilt, tilt))
            for evidence in end.evidence(by_width, views, end.ground.slope_weight[None], turn)
        )
        width, peak_level = end.shape_at(ratio, np.rint(tracked.cell).astype(np.int64), views, level_weight)
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
        off_axis = self._off_axis(tracked, moved, slope, pulses, sweep)
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
            shared_sigma_m=np.full(len(detected), self.shared_sigma_m),
        )
        if in_front is not None:
            echoes = with_echoes_in_front(echoes, in_front, self.detector, pulses.index)
        quiet = replace(spans, noise=np.full(power.shape, self.volume.noise))
        profiles = cut_profiles(quiet, pulses.index, stride)
        volume_in_front = VolumeInFront(
            power=profiles.of_cells(volume[:, ::stride], detected),
            in_air=profiles.of_cells(in_air[:, ::stride], detected),
            echo_m=ranges.range_m,
            echo_sigma_m=ranges.sigma_m,
            direction=off_axis.direction[detected],
            echo_reach=reach,
            drift_m=views.drift_m[detected],
            spread_m=end.spread_m,
        )
        return Detections(echoes=echoes, profiles=replace(profiles, volume=volume_in_front))

    def _with_slope(
        self,
        by_width: ByWidth,
        views: Views,
        unexpected: Float[np.ndarray, "pulse cell"],
        heights: AxisHeights,
        step_m: float,
    ) -> VolumeEnd:
        """Return the end of the volume over ground of the slopes that one scan line's heights and widths tell."""
        end = self.end
        of_slopes = [
            line_likelihood(evidence - unexpected, heights, end.cell_m, slope, step_m)
            for slope, evidence in zip(SLOPES, end.evidence(by_width, views, np.eye(len(SLOPES))), strict=True)
        ]
        return replace(end, ground=end.ground.given(np.array(of_slopes)))

    def _in_front(
        self,
        power: Float[np.ndarray, "pulse bin"],
        ratio: Float[np.ndarray, "pulse cell"],
        views: Views,
        pulses: Pulses,
        sweep: Chirp,
        window_m: Float[np.ndarray, "pulse 2"],
    ) -> EchoSpans:
        """Return the echoes in front of the ground; the volume's mean is moved as each pulse's motion moves ranges.

        Nothing is searched where ranges of the nearest particles may have the wrong sign, nor as far beside it as the
        window spreads those, the strongest; and the volume goes on behind a ground as far as particles move from there.
        """
        end, volume = self.end, self.volume
        moved_m = views.drift_m + views.shift_m
        cell = np.arange(end.cells)
        place = np.arange(power.shape[1]) / self.detector.analyser.zero_padding
        mean = np.interp(place - (moved_m - moved_m.mean())[:, None] / end.cell_m, cell, volume.mean)
        mean = views.strength[:, None] * mean + volume.noise
        nearest_m = np.maximum(np.maximum(window_m[:, 0], self.detector.min_range_m), self._folded_m(views))
        behind = (np.maximum(views.drift_m, 0.0) + WIDTHS_OF_SPAN * end.spread_m) / end.cell_m
        range_cells = np.maximum(cell - views.shift_m[:, None] / end.cell_m, 1.0)
        reach = WIDTHS_OF_SPAN * end.ground_width(range_cells, views.down[:, None]) + behind[:, None] + 1
        return spans_in_front(self.detector, power, mean, end.goes_on(ratio, views.strength), reach, nearest_m)

    def _folded_m(self, views: Views) -> Float[np.ndarray, " pulse"]:
        """Return the range up to which the nearest particles may fold, with the reach of the window beside them."""
        window_reach_m = len(self.end.response) // 2 * self.end.cell_m / FINE
        return np.abs(views.drift_m + views.shift_m) + WIDTHS_OF_SPAN * self.end.spread_m + window_reach_m

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
        slope: float,
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

        moved: ranges found if ground falls by the slope on average less those if it rises by it, cells.
        """
        end, pose, tilt = self.end, pulses.measured, np.arctan(slope)
        incidence = np.arccos(np.clip(-pose.boresight[:, 2], MIN_GRAZING_SINE, 1.0))
        falls, level, rises = (mean_tangent(incidence + turn, slope) for turn in (tilt, 0.0, -tilt))
        range_cells = np.maximum(tracked.cell - sweep.doppler_range_m(pose.boresight_range_rate_mps) / end.cell_m, 1.0)
        per_slopes = range_cells * (falls - rises)
        flattest = np.maximum(np.arccos(MIN_GRAZING_SINE) - np.arctan(level), 0.0)
        angle = np.clip(-moved / per_slopes, 0.0, np.minimum(end.beam.sine.max(), flattest))
        taken = (angle * per_slopes / 2 / tracked.alone) ** 2
        # The plane of the shapes: 1 / (cos(a) - tan(t) sin(a)) = cos(t) / cos(t + a).
        farther = range_cells * (1 / (np.cos(angle) - level * np.sin(angle)) - 1)
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
        cfar = self.detector.cfar
        clutter = self.volume.clutter_threshold(cfar.false_alarm_probability, cfar.looks)
        return np.maximum(spectra.threshold, np.interp(place, np.arange(len(clutter)), clutter))

    def views(self, pulses: Pulses, sweep: Chirp, strength: Float[np.ndarray, " pulse"]) -> Views:
        """Return the view of volume and ground in each pulse, from its measured pose and the volume's strength."""
        boresight = pulses.measured.boresight
        return Views(
            down=-boresight[:, 2],
            shift_m=sweep.doppler_range_m(pulses.measured.boresight_range_rate_mps),
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


def _within(
    range_m: Float[np.ndarray, "#pulse place"] | Float[np.ndarray, " place"], window_m: Float[np.ndarray, "pulse 2"]
) -> Bool[np.ndarray, "pulse place"]:
    """Return the mask of ranges inside the window of each pulse."""
    return np.asarray((range_m >= window_m[:, :1]) & (range_m <= window_m[:, 1:]))


def _heights(pulses: Pulses, sweep: Chirp) -> AxisHeights:
    pose = pulses.measured
    shift_m = sweep.doppler_range_m(pose.boresight_range_rate_mps)
    return AxisHeights(position_m=pose.position_m, boresight=pose.boresight, shift_m=shift_m)
