"""Points of an array's frames: bounds, resolution, gain, side lobes, ambiguities and false alarms."""

import numpy as np
import pytest

from modules import CHIRP, DOWN, estimator_of, frame_of, line_of, middle, seen_at
from sionna_radar.detection.angle.array_arrival import SCANNED, ArrayEstimator
from sionna_radar.detection.angle.frame_map import FrameMap
from sionna_radar.flight.pulses import Pose


def with_noise(beats, power, seed):
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((2, *beats.shape))
    return beats + np.sqrt(power / 2) * (noise[0] + 1j * noise[1])


def cell_noise(estimator):
    """Return the noise of a channel of a cell over that of a sample."""
    return np.sum(estimator.analyser.window**2) * np.sum(estimator.rate_weights**2)


@pytest.mark.parametrize("code", ["tdm", "ddm", "bpm"])
@pytest.mark.parametrize("fold", [0, 1])
def test_a_point_is_found_where_it_is(code, fold):
    """Whatever the code, and though the radar moves between transmitters; folded range rates included."""
    estimator, motion = estimator_of(line_of(3, 4, code=code)), (20.0, 0.0, 0.0)
    place, direction = seen_at(estimator, 3, 42, 0.3, motion, fold)
    beats = frame_of(estimator.array, place, [1.0], velocity_mps=motion)
    echoes = estimator.find(with_noise(beats, 1e-3, 1), 7, middle(motion))
    strongest = np.argmax(echoes.power)
    assert np.abs(echoes.direction[strongest] - direction).max() < 2e-3
    # Folded ones are cones of other transmitters' phases, and the array knows which.
    shift_m = CHIRP.doppler_range_m(np.array([-20 * direction[2]]))[0]
    range_m = np.linalg.norm(place - middle().position_m[0])
    assert echoes.range_m[strongest] - shift_m == pytest.approx(range_m, abs=0.02)
    assert echoes.pulse[strongest] == 7


# Both windows at both ends, and one between them.
@pytest.mark.parametrize(
    ("window", "snr_db"), [("hann", 10.0), ("hann", 40.0), ("boxcar", 10.0), ("boxcar", 25.0), ("boxcar", 40.0)]
)
def test_angles_reach_their_bound(window, snr_db):
    """Within 1.3 of the Cramer-Rao bound of a cell, which of uniform windows is that of the whole frame.

    The ratio is that of a channel. The scatter of 40 errors is known to 11 %.
    """
    estimator = estimator_of(line_of(3, 4), window=window)
    place, direction = seen_at(estimator, 2, 42, 0.2)
    clean = frame_of(estimator.array, place, [1.0])
    array, channels = estimator.array, estimator.array.channels
    noise = 1 / (10 ** (snr_db / 10) * cell_noise(estimator))
    errors, stated = [], []
    for seed in range(40):
        found = estimator.map(with_noise(clean, noise, seed))
        sources = estimator.sources(found, middle())
        nearest = np.flatnonzero((sources.cell == 42) & (found.rate_mps[sources.rate] == 2 * array.rate_cell_mps))
        if len(nearest) == 0:
            continue
        best = nearest[np.argmax(sources.power[nearest])]
        errors.append(sources.direction[best, 1] - direction[1])
        stated.append(sources.phi_sigma_rad[best])
    assert len(errors) > 33
    # Of an evenly spaced line: 6 / (4 pi^2 d^2 N (N^2 - 1) R), d in wavelengths.
    bound = np.sqrt(6 / (np.pi**2 * channels * (channels**2 - 1) * 10 ** (snr_db / 10)))
    scatter = np.sqrt(np.mean(np.square(errors)))
    assert scatter < 1.3 * bound
    # phi turns the direction cosine by the sine of the cone and the cosine of phi.
    lever = direction[0]
    assert np.median(stated) * lever == pytest.approx(bound, rel=0.2)


# Each code with a narrow and a wide window, weak and strong.
@pytest.mark.parametrize(
    ("code", "window", "snr_db"),
    [("tdm", "hann", 38.0), ("tdm", "boxcar", 25.0), ("bpm", "hann", 15.0), ("bpm", "blackman", 35.0)],
)
def test_angles_and_ranges_anywhere_in_a_cell_reach_their_bound(code, window, snr_db):
    """Half a cell off the middle transmitters in turn see a phase that is no angle, and a range is not its cell's.

    The bound is that of the power in the cell, which is less off its middle; half a cell of range is 0.19 m. The
    RMS of 40 errors is known to 11 %.
    """
    estimator = estimator_of(line_of(3, 4, blocks=24, code=code), window=window)
    noise = 1 / (10 ** (snr_db / 10) * cell_noise(estimator))
    errors, stated, ranges, turns = [], [], [], []
    for seed in range(40):
        rng = np.random.default_rng(1000 + seed)
        row, cell, cosine = 2 + rng.uniform(-0.5, 0.5), 31 + rng.uniform(-0.5, 0.5), rng.uniform(-0.4, 0.4)
        place, direction = seen_at(estimator, row, cell, cosine)
        found = estimator.map(with_noise(frame_of(estimator.array, place, [1.0]), noise, seed))
        sources = estimator.sources(found, middle())
        best = np.argmax(sources.power)
        errors.append(sources.direction[best, 1] - direction[1])
        stated.append(sources.phi_sigma_rad[best] * direction[0])
        turns.append(sources.direction[best, 2] - direction[2])
        ranges.append(sources.range_m[best] - cell * CHIRP.range_resolution_m)
    assert np.sqrt(np.mean(np.square(np.array(errors) / stated))) < 1.3
    # Cramer-Rao bounds of a frequency of all channels' blocks or samples, in cells; windows and neighbours take more.
    whole = 10 ** (snr_db / 10) * estimator.array.gain
    # The motion bends the phase over the frame, by some thousandths of a cell.
    bound_cells = np.hypot(np.sqrt(6 / (4 * np.pi**2 * whole)), 2e-3)
    cell_of_direction = estimator.array.rate_cell_mps / 10.0
    assert np.sqrt(np.mean(np.square(ranges))) < 3 * bound_cells * CHIRP.range_resolution_m
    assert np.sqrt(np.mean(np.square(turns))) < 3 * bound_cells * cell_of_direction


def test_two_points_a_beam_apart_are_two():
    """In one cell of range and range rate, at the Rayleigh limit of the virtual array, N d."""
    estimator = estimator_of(line_of(3, 4))
    limit = 1 / (12 * 0.5)
    places, directions = zip(*(seen_at(estimator, 0, 42, side * limit / 2) for side in (-1, 1)), strict=True)
    errors = []
    for seed in range(20):
        gain = np.exp(2j * np.pi * np.random.default_rng(seed).random(2))
        clean = frame_of(estimator.array, np.array(places), gain)
        found = estimator.map(with_noise(clean, 12 / (1e3 * cell_noise(estimator)), seed))
        sources = estimator.sources(found, middle())
        own = sources.direction[(sources.cell == 42) & (found.rate_mps[sources.rate] == 0), 1]
        assert len(own) == 2
        errors.append(np.sort(own) - [d[1] for d in directions])
    assert np.abs(errors).max() < limit / 4
    assert np.sqrt(np.mean(np.square(errors))) < limit / 10


def capon(estimator, found, row, cell, cosine):
    """Return Capon's spectrum of a cell, its covariance that of three by three cells, loaded with their noise."""
    beams = estimator.array.steering(
        np.column_stack([np.sqrt(1 - cosine**2), cosine, 0 * cosine]), 0 * cosine, found.range_m[cell]
    )
    x = found.channel[row - 1 : row + 2, cell - 1 : cell + 2].reshape(9, -1)
    inverse = np.linalg.inv(x.T @ x.conj() / 9 + found.noise * np.eye(x.shape[1]))
    return 1 / np.einsum("gc,cd,gd->g", beams.conj(), inverse, beams).real


@pytest.mark.parametrize(("apart_cells", "better"), [(0.0, "projection"), (0.5, "capon")])
def test_two_points_by_neighbouring_cells(apart_cells, better):
    """Capon's beams tell two points only where neighbouring cells hold them in other shares, as those of ground do not.

    Three quarters of a beam apart; found are those whose peaks lie within a quarter of that from both.
    """
    estimator, cosine = estimator_of(line_of(3, 4)), np.linspace(-0.5, 0.5, 801)
    apart = 0.75 / 6
    places = [seen_at(estimator, 0, 42 + side * apart_cells / 2, side * apart / 2) for side in (-1, 1)]
    place, truth = (np.array(column) for column in zip(*places, strict=True))
    hits = {"projection": 0, "capon": 0}
    for seed in range(20):
        gain = np.exp(2j * np.pi * np.random.default_rng(seed).random(2))
        noise = 1e-3 / cell_noise(estimator)
        found = estimator.map(with_noise(frame_of(estimator.array, place, gain), noise, seed))
        level = capon(estimator, found, 8, 42, cosine)
        peaks = 1 + np.flatnonzero((level[1:-1] > level[:-2]) & (level[1:-1] > level[2:]))
        sources = estimator.sources(found, middle())
        own = sources.direction[(sources.cell == 42) & (found.rate_mps[sources.rate] == 0), 1]
        for name, left in (("projection", own), ("capon", cosine[peaks[np.argsort(-level[peaks])[:2]]])):
            near = len(left) == 2 and np.abs(np.sort(left) - truth[:, 1]).max() < apart / 4
            hits[name] += int(near)
    assert max(hits, key=lambda name: hits[name]) == better
    assert hits["projection"] >= 14
    assert hits["capon"] == (20 if better == "capon" else pytest.approx(0, abs=6))


def test_channels_add_their_gain():
    """10 log N over one channel, in signal and noise as received."""
    estimator = estimator_of(line_of(3, 4, blocks=32))
    array = estimator.array
    place, direction = seen_at(estimator, 0, 30, 0.25)
    a = array.steering(direction[None], np.zeros(1), 30 * CHIRP.range_resolution_m)[0]
    signal = estimator.map(frame_of(array, place, [1.0])).channel[16, 30]
    silence = np.zeros((array.chirps, 4, CHIRP.samples), dtype=np.complex128)
    noise = np.concatenate([estimator.map(with_noise(silence, 1.0, s)).channel.reshape(-1, 12) for s in range(12)])

    def ratio(weights):
        return np.abs(weights.conj() @ signal) ** 2 / np.mean(np.abs(noise @ weights.conj()) ** 2)

    single = np.mean([ratio(np.eye(12)[n] * a) for n in range(12)])
    assert 10 * np.log10(ratio(a) / single) == pytest.approx(10 * np.log10(12), abs=0.1)


def test_side_lobes_are_those_of_the_virtual_array():
    """Of a point, through signal and maps: sin(N x / 2) / (N sin(x / 2))."""
    estimator = estimator_of(line_of(3, 4))
    place, direction = seen_at(estimator, 0, 42, 0.0)
    x = estimator.map(frame_of(estimator.array, place, [1.0])).channel[8, 42]
    cosine = (np.arange(1, 6) + 0.5) / 6.0  # near the peaks of the lobes
    toward = np.column_stack([np.sqrt(1 - cosine**2), cosine, np.zeros(5)])
    beams = estimator.array.steering(toward, np.zeros(5), 42 * CHIRP.range_resolution_m)
    found = np.abs(beams.conj() @ x) / np.abs(estimator.array.steering(direction[None], np.zeros(1)).conj() @ x)
    half = np.pi * cosine / 2
    assert 20 * np.log10(found) == pytest.approx(
        20 * np.log10(np.abs(np.sin(12 * half) / (12 * np.sin(half)))), abs=0.2
    )


def silent(estimator, seed):
    """Return the map of a frame of noise."""
    array = estimator.array
    silence = np.zeros((array.chirps, len(array.receiver_m), CHIRP.samples), dtype=np.complex128)
    return estimator.map(with_noise(silence, 1.0, seed))


@pytest.mark.parametrize("code", ["tdm", "bpm"])
def test_false_alarms_are_at_most_as_many_as_asked_for(code):
    """The bound sums over all scanned directions, eight to a beam; and noise seldom has one direction alone."""
    estimator = estimator_of(line_of(3, 4, blocks=32, code=code), false_alarm_probability=1e-2)
    alarms = tested = 0
    for seed in range(20):
        found = silent(estimator, seed)
        alarms += len(np.unique(np.column_stack([(s := estimator.sources(found, middle())).rate, s.cell]), axis=0))
        tested += found.power[:, found.range_m >= 2.0].size
    assert 0 < alarms < 1e-2 * tested


def test_scanned_cells_are_a_known_share_of_noise():
    estimator = estimator_of(line_of(3, 4, blocks=32))
    share = [
        len(estimator.scanned(found)[0]) / found.power[:, found.range_m >= 2.0].size
        for found in (silent(estimator, seed) for seed in range(20))
    ]
    assert np.mean(share) == pytest.approx(SCANNED, rel=0.1)


def test_ground_in_most_of_a_map_raises_its_noise_little():
    estimator = estimator_of(line_of(3, 4, blocks=32))
    rng = np.random.default_rng(1)
    for seed in range(10):
        found = silent(estimator, seed)
        channel = found.channel.copy()
        channel[:, 20:60] += 20 * np.sqrt(found.noise) * rng.standard_normal((32, 40, 12))
        raised = estimator._noise(
            FrameMap(channel=channel, noise=np.inf, rate_mps=found.rate_mps, range_m=found.range_m)
        )
        assert found.noise < raised < 10**0.2 * found.noise


def test_the_spread_of_a_cell_is_that_of_its_window():
    """A Hann window's power response has a second moment of a third of a cell squared."""
    hann = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(256) / 256)
    assert ArrayEstimator.spread_cells(hann) == pytest.approx(1 / np.sqrt(3), rel=1e-3)


def test_points_of_neighbouring_cells_are_averaged():
    single, double = (estimator_of(line_of(3, 4), average_cells=cells) for cells in ((1, 1), (2, 2)))
    place, _ = seen_at(single, 1, 42, 0.3)
    beats = with_noise(frame_of(single.array, place, [1.0]), 1e-3, 2)
    many, few = (estimator.find(beats, 0, middle()) for estimator in (single, double))
    assert len(few) < len(many)
    # Noise of cells side by side correlates by 2 / 3 after a Hann window: four are worth less than two.
    assert double._shared(np.array([1, 4])) == pytest.approx([1.0, (1 + 4 / 9) ** 2])
    assert np.all(np.diff(few.range_m) >= 0)


def test_a_module_that_does_not_move_finds_nothing():
    estimator = estimator_of(line_of(3, 4))
    place, _ = seen_at(estimator, 0, 42, 0.3)
    still = Pose(position_m=np.zeros((1, 3)), velocity_mps=np.zeros((1, 3)), R_world_antenna=DOWN[None])
    assert len(estimator.find(with_noise(frame_of(estimator.array, place, [1.0]), 1e-3, 1), 0, still)) == 0
