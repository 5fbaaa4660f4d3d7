"""Estimation of a volume, its motion and the ground behind it, from spectra of pulses sampled over a survey."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.detection.detector import RESPONSE_CELLS, Detector
from sionna_radar.detection.volume.clutter import (
    NEAR_CELLS,
    STORM_MPS,
    TYPICAL_RATE_MM_PER_H,
    VolumeCells,
    VolumeClutter,
    VolumeMotion,
    estimated_motion,
    expected_motion,
    first_guess,
    law_information,
    measured_mean,
    rain_rate_of,
)
from sionna_radar.detection.volume.detector import ThroughVolume
from sionna_radar.detection.volume.end import VolumeEnd
from sionna_radar.detection.volume.ground import GroundBehind, learned_ground, unknown_ground, with_nearby_levels
from sionna_radar.detection.volume.shapes import FINE, echo_width, widths_up_to
from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.decibels import from_db
from sionna_radar.foundation.numerics import MAX_SPECKLE
from sionna_radar.radar.chirp import Chirp

# Largest fraction of pulses that may be exceptions: their ground may lie within the cells assumed volume-only in all
# pulses, or have a longer echo than the widest compared.
MAX_GROUND_FRACTION = 0.02
# An echo stronger by this factor is the strongest of its pulse despite speckle.
MIN_STRENGTH_RATIO = 2.0


def shows_volume(detector: Detector, power: Float[np.ndarray, "pulse bin"], pulses: Pulses) -> bool:
    """Return True if spectra of pulses sampled over a survey show a volume in front of the ground."""
    return _first_guess(detector, power, pulses) is not None


def _first_guess(detector: Detector, power: Float[np.ndarray, "pulse bin"], pulses: Pulses) -> VolumeClutter | None:
    if detector.beam is None:
        return None
    stride = detector.analyser.zero_padding
    range_m = detector.analyser.range_m[::stride]
    first, last = _nearest_cell(detector), len(range_m) - 2
    power = detector.over_floor(power)
    # Motion moves echoes of farther ground, which are longer, to the tested ranges.
    pose, chirp = pulses.measured, detector.analyser.chirp
    moved_cells = np.abs(chirp.doppler_range_m(pose.boresight_range_rate_mps)) / chirp.range_resolution_m
    width = echo_width(detector.beam, first + NEAR_CELLS / 4 + moved_cells, -pose.boresight[:, 2])
    of_half_power = np.sqrt(8 * np.log(2)) * width
    narrow = bool(np.median(of_half_power) < 1)
    guess = first_guess(power[:, ::stride], range_m, first, last, narrow)
    if guess is None:
        return None
    # Thin fog or drizzle is harmless if the strongest cell of nearly every pulse exceeds the nearest volume cells by
    # so much that these cannot be taken for an echo.
    margin = MIN_STRENGTH_RATIO if detector.kept == "strongest" else from_db(detector.dynamic_range_db)
    strongest = np.quantile(power[:, ::stride][:, first:last].max(axis=1), MAX_GROUND_FRACTION)
    return None if strongest > margin * MAX_SPECKLE * guess.mean[first] else guess


def _nearest_cell(detector: Detector) -> int:
    """Return the first cell that is searched."""
    range_m = detector.analyser.range_m[:: detector.analyser.zero_padding]
    return int(np.searchsorted(range_m, detector.min_range_m))


def _first_cell(detector: Detector, motion: VolumeMotion, pulses: Pulses, sweep: Chirp) -> int:
    """Return the first cell that may contain ground behind a volume, in all pulses.

    Motion moves the nearest particles, by far the strongest, away from the range of zero, and a real signal shows those
    of negative beat frequencies at positive ones. Behind them the window's main lobe is left out.
    """
    pose, first = pulses.measured, _nearest_cell(detector)
    moved_m = sweep.doppler_range_m(pose.boresight_range_rate_mps + motion.range_rate_mps(pose.boresight))
    nearest_m = float(np.max(np.abs(moved_m) if sweep.sampling == "real" else moved_m, initial=0.0))
    return max(first, round(nearest_m / sweep.range_resolution_m) + detector.lobe_cells)


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
    guess = _first_guess(detector, power, pulses)
    if guess is None:
        return None
    cells = power[:, :: detector.analyser.zero_padding][:, : _cells(detector, pulses, sweep)]
    guess = replace(guess, mean=guess.mean[: cells.shape[1]])
    stated = detector.volume.rain_rate_mm_per_h
    rate = stated
    if rate is None:
        typical = expected_motion(sweep.carrier_hz, TYPICAL_RATE_MM_PER_H)
        once = _learned(detector, guess, typical, cells, pulses, sweep, rounds=1)
        rate = _rain_rate_mm_per_h(once.through, pulses, sweep)
    learned = _learned(detector, guess, expected_motion(sweep.carrier_hz, rate), cells, pulses, sweep)
    motion = _motion(learned.through, rate, more_power[:, :: detector.analyser.zero_padding], more_pulses, sweep)
    if not np.array_equal(motion.velocity_mps, learned.through.motion.velocity_mps):
        learned = _learned(detector, guess, motion, cells, pulses, sweep)
    return _with_shared_sigma(learned, motion, pulses, sweep)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Learned:
    """A detector through a volume, and what it was learned from.

    ground: median range of the ground, in cells. volume_only: pulses in which a cell holds nothing but volume.
    """

    through: ThroughVolume
    ground: int
    volume_only: Int[np.ndarray, " cell"]


def _learned(
    detector: Detector,
    volume: VolumeClutter,
    motion: VolumeMotion,
    cells: Float[np.ndarray, "pulse cell"],
    pulses: Pulses,
    sweep: Chirp,
    rounds: int | None = None,
) -> _Learned:
    """Estimate the volume's mean and the ground behind it alternately, for one motion and from unknown ground.

    rounds: number of alternations; None for that of the options.
    """
    # Motion shifts the ranges at which the law r^-2 of the first guess appears.
    nearest_m = detector.analyser.chirp.range_resolution_m
    middle = _first_cell(detector, motion, pulses, sweep) + NEAR_CELLS // 2
    range_m = np.maximum(_still_range_m(np.arange(len(volume.mean)), detector, motion, pulses, sweep), nearest_m)
    range_m = np.hypot(range_m, detector.near_field_m)
    law = volume.mean[middle] * (range_m[middle] / range_m) ** 2
    through = _through(detector, replace(volume, mean=law), unknown_ground(), motion, pulses, sweep)
    for _ in range(rounds or detector.volume.estimation_rounds):
        learned = _with_mean_and_ground(through, cells, pulses, sweep)
        through = learned.through
    return learned


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
    cells = _cells(detector, pulses, sweep)
    # On slopes echoes are longer than on level ground.
    width = np.exp(detector.volume.width_spread_nepers) * echo_width(
        detector.beam, np.full(len(down), float(cells)), down
    )
    widest = float(np.quantile(width, 1 - MAX_GROUND_FRACTION))
    end = VolumeEnd(
        volume=volume,
        ground=ground,
        spread_m=abs(float(sweep.doppler_range_m(motion.fall_spread_mps * down).mean())),
        beam=detector.beam,
        cell_m=analyser.chirp.range_resolution_m,
        looks=analyser.looks_per_cell,
        response=analyser.response(RESPONSE_CELLS * FINE, FINE),
        first=_first_cell(detector, motion, pulses, sweep),
        cells=cells,
        floor_share=detector.volume.floor_share,
        width_spread_nepers=detector.volume.width_spread_nepers,
        widths=widths_up_to(widest),
    )
    return ThroughVolume(detector=detector, end=end, motion=motion)


def _cells(detector: Detector, pulses: Pulses, sweep: Chirp) -> int:
    """Return the number of range cells that can contain ground.

    Approaching drops next to the radar have a negative beat frequency, which I/Q sampling shows at the far end: at most
    in half of the cells, or none would be left where sweeps are long.
    """
    analyser = detector.analyser
    count = len(analyser.range_m[:: analyser.zero_padding])
    if sweep.sampling == "real":
        return count
    approach_mps = np.abs(pulses.measured.boresight_range_rate_mps) + STORM_MPS
    folded_m = float(np.abs(sweep.doppler_range_m(approach_mps)).max())
    return max(count - int(np.ceil(folded_m / sweep.range_resolution_m)) - 2 * RESPONSE_CELLS, count // 2)


def _with_mean_and_ground(
    through: ThroughVolume, cells: Float[np.ndarray, "pulse cell"], pulses: Pulses, sweep: Chirp
) -> _Learned:
    """Estimate the volume's mean from the cells before the ground, and the level and slope of the ground."""
    end, volume, options = through.end, through.volume, through.detector.volume
    strength = volume.strength(cells, end.looks, 0)
    views = through.views(pulses, sweep, strength)
    # Of any level: what a mean that was still wrong made seldom comes back.
    of_any = replace(end, ground=replace(unknown_ground(), cell=end.ground.cell))
    likelihood, ground = of_any.by_slope_and_level(end.over_volume(cells, strength), views)
    range_cells = np.maximum(ground - views.shift_m / end.cell_m, 1.0)
    learned = learned_ground(of_any.ground, likelihood, range_cells)
    learned = with_nearby_levels(learned, of_any.ground, likelihood, range_cells * end.cell_m, pulses)
    volume_end = ground - end.before_ground(range_cells, views.down, options.widths_before) - options.cells_before
    volume_only = (np.arange(end.cells) < volume_end[:, None]) & (np.arange(end.cells) >= end.first)
    range_m = end.cell_m * np.arange(end.cells)
    mean = measured_mean(volume, cells / strength[:, None], volume_only, range_m, options.smoothed_cells)
    near = (end.first, max(int(np.quantile(volume_end, MAX_GROUND_FRACTION)), end.first))
    uniform = replace(volume, mean=mean, near=near, uneven=0.0)
    updated = replace(uniform, uneven=uniform.unevenness(cells, end.looks, options.smoothed_cells))
    made = _through(through.detector, updated, learned, through.motion, pulses, sweep)
    return _Learned(through=made, ground=int(np.median(ground)), volume_only=volume_only.sum(axis=0))


def _with_shared_sigma(learned: _Learned, motion: VolumeMotion, pulses: Pulses, sweep: Chirp) -> ThroughVolume:
    """Return the detector with the error that all pulses share, through a volume of a motion."""
    through, end = replace(learned.through, motion=motion), learned.through.end
    boresight = pulses.measured.boresight
    drift_m, drift_sigma_m = (sweep.doppler_range_m(of(boresight)) for of in (motion.range_rate_mps, motion.sigma_mps))
    shared = end.shared_sigma_cells(
        learned.ground,
        float(np.median(-boresight[:, 2])),
        len(pulses),
        law_information(end.volume, learned.volume_only, end.looks, learned.ground),
        (float(np.median(drift_m)), float(np.abs(drift_sigma_m).mean())),
    )
    return replace(through, shared_sigma_m=shared * end.cell_m)


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
        margin_m=through.detector.lobe_cells * end.cell_m,
        uneven=volume.uneven,
    )
    return estimated_motion(sweep.carrier_hz, rain_rate_mm_per_h, only)
