"""Echoes in front of the ground that stand out of a volume: of wires, poles, birds.

With speckle alone the power of a bin of L looks exceeds k times its mean with the probability Q(L, L k), Q the
regularised incomplete gamma function; of one look that is exp(-k). k is that at which all bins of a range cell together
make no more false alarms than the CFAR is given for a cell.

Ground stands out of the volume, too, but ends it: an echo is in front of the ground if the volume goes on behind it.
Of cells that are silent, from beyond the reach of a ground's echo on, the likelihood ratio of a volume in all up to
some later one exceeds 1 / p with a probability of at most p (Ville's inequality), p the false-alarm probability.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.detection.detector import Detector, detected_spans, number_within
from sionna_radar.detection.echoes import Echoes
from sionna_radar.detection.ranging.estimators import EchoSpans
from sionna_radar.detection.volume.clutter import speckle_quantile
from sionna_radar.foundation.decibels import from_db


def spans_in_front(
    detector: Detector,
    power: Float[np.ndarray, "pulse bin"],
    mean: Float[np.ndarray, "pulse bin"],
    goes_on: Float[np.ndarray, "pulse cell"],
    reach: Float[np.ndarray, "pulse cell"],
    nearest_m: Float[np.ndarray, " pulse"],
) -> EchoSpans:
    """Return the spans of echoes in front of the ground.

    Parameters
    ----------
    detector:
        The processing: false alarms, the gap that one echo bridges.
    power, mean:
        Power spectra, and their means where there is nothing but volume and noise.
    goes_on:
        Log-likelihood of a volume that fills the cells from each one to some later one.
    reach:
        Reach of a ground's echo at each cell, in cells.
    nearest_m:
        Least range that is searched in each pulse.
    """
    analyser = detector.analyser
    stride, last = analyser.zero_padding, goes_on.shape[1] - 1
    false_alarm = detector.cfar.false_alarm_probability
    low = np.searchsorted(analyser.range_m, nearest_m)
    high = np.full(len(power), goes_on.shape[1] * stride)
    least = np.full(len(power), speckle_quantile(false_alarm / stride, detector.cfar.looks))
    threshold = np.broadcast_to(least[:, None], power.shape)
    gap = int(detector.merge_gap_m / analyser.bin_m)
    row, start, stop, peak = detected_spans(power / mean, threshold, least, low, high, gap).T
    end = np.minimum(-(-stop // stride), last)
    behind = np.minimum(end + np.ceil(reach[row, end]).astype(np.int64), last)
    spans = EchoSpans(
        power=power,
        noise=mean,
        row=row,
        start=start,
        stop=stop,
        peak=peak,
        bin_m=analyser.bin_m,
        looks_per_bin=analyser.looks_per_cell / stride,
        beam=detector.beam,
    )
    return spans.rows(goes_on[row, behind] > -np.log(false_alarm))


def without_spans(
    ratio: Float[np.ndarray, "pulse cell"], spans: EchoSpans, detector: Detector
) -> Float[np.ndarray, "pulse cell"]:
    """Return powers over the volume's mean, 1 in place of echoes and of the window's main lobe around them."""
    stride = detector.analyser.zero_padding
    lobe = detector.lobe_cells
    cell = np.arange(ratio.shape[1])
    filled = ratio.copy()
    for row, start, stop in zip(spans.row, spans.start // stride - lobe, -(-spans.stop // stride) + lobe, strict=True):
        filled[row, (cell >= start) & (cell < stop)] = 1.0
    return filled


def with_echoes_in_front(
    ground: Echoes, spans: EchoSpans, detector: Detector, pulse: Int[np.ndarray, " pulse"]
) -> Echoes:
    """Return the echoes of the ground with those in front of it, which are placed on the beam's axis.

    As in clear air, echoes far weaker than the strongest of their pulse are dropped.

    spans: of the echoes in front. pulse: indices of the pulses in the survey.
    """
    power = spans.power[spans.row, spans.peak]
    strongest = np.zeros(len(pulse))
    np.maximum.at(strongest, spans.row, power)
    np.maximum.at(strongest, np.searchsorted(pulse, ground.pulse), ground.power)
    kept = spans.rows(power >= strongest[spans.row] / from_db(detector.dynamic_range_db))
    ranges, power = detector.estimator(kept), kept.power[kept.row, kept.peak]
    in_front = Echoes(
        pulse=pulse[kept.row],
        number=np.zeros(len(kept.row), dtype=np.int64),
        range_m=ranges.range_m,
        range_sigma_m=ranges.sigma_m,
        power=power,
        echo_snr_db=10 * np.log10(power / kept.noise[kept.row, kept.peak]),
        direction=np.tile([1.0, 0.0, 0.0], (len(kept.row), 1)),
        reach=np.zeros(len(kept.row)),
        shared_sigma_m=np.zeros(len(kept.row)),
    )
    both = Echoes.concatenate([in_front, ground])
    both = both.rows(np.lexsort((both.range_m, both.pulse)))
    return replace(both, number=number_within(both.pulse))
