"""R-SLAM: the way of a panoramic radar, and the map around it, from its images (Rouveure et al. 2017, Fig. 1).

Peaks of each turn make up small surfaces (`surfaces`). Turn after turn is laid on those before it, with its distortion
and Doppler shift (`registration`); then all turns are solved at once (`trajectory`), places that the drive comes back
to are found (`loops`), and all are solved again. The way is east and north of the first turn, or from where the
recording says that it began. An odometer and a gyroscope are taken in if given (`odometry`).
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.progress import advance, stage
from sionna_radar.studies.panorama.polar_images import PolarImages, Way
from sionna_radar.studies.slam.drift import Drift, drift_of
from sionna_radar.studies.slam.loops import candidates, close
from sionna_radar.studies.slam.motion import Motion
from sionna_radar.studies.slam.odometry import Increments, Odometry
from sionna_radar.studies.slam.registration import Registered, register
from sionna_radar.studies.slam.surfaces import MIN_PEAKS, Peaks, Surfaces, peaks_of, rotation, surfaces_of
from sionna_radar.studies.slam.trajectory import Solved, solve

logger = logging.getLogger("sionna_radar")

# Speeds from which the first turn is tried, m/s, up to this one; a drive may begin backward.
FASTEST_MPS, SLOWEST_MPS = 30.0, -3.0
# Changes of the yaw rate that are tried where the expected one does not fit, in typical ones.
YAW_TRIES = (0.0, 0.7, -0.7, 1.4, -1.4, 2.1, -2.1)
ROUNDS = 2
# Turn of the vehicle after which it sees the same anew.
ELSEWHERE_RAD = float(np.deg2rad(10.0))
# Unevenness of a small surface over its size, as standard deviation: a uniform one over all of it has 0.29.
UNEVEN = 1 / 12
# Largest small surface, relative to the farthest range that counts, and the smallest that is not warned of, in range
# cells. Over 102 turns in the stadium and 36 around a block (138 m, cells of 0.6 m), 71 to 98 % of all errors lie
# within 95 % with surfaces of 3 to 20 m, 42 and 76 % with 30 m, 7 and 34 % with 50 m. With 2 m a third of the surfaces
# is left: turns are lost, and 13 and 73 % lie within.
MAX_SURFACE_RANGE, MIN_SURFACE_CELLS = 1 / 8, 5.0
# Of a falling sweep's shift of ranges per range rate over the time of a turn: at 0.2 to 0.3 the way is found as by a
# rising one, at 0.5 one of three drives lost turns, at 1.3 all five were lost, of which a rising one lost none.
LARGEST_FALLING = 0.4
# Of loops: farthest place, over the range of the images; and the distance at which a heading is a place.
LOOP_REACH, ALIKE_M = 0.25, 30.0


@dataclass(frozen=True, kw_only=True)
class SlamOptions:
    """Options of `slam`.

    threshold_db: of peaks over the mean around them. near_m, far_m: ranges that count; None for nine tenths of all.
    surface_m: size of the small surfaces, and farthest distance of two that may be one.
    neighbours: turns before each that it is compared with.
    least_score: share of a turn that must lie on the map; below it the turn is lost, and the way goes on as it did.
    loop_score: of a place that the drive comes back to.
    independent: weight of pairs of turns against the motion.
    motion: how the vehicle accelerates.
    loops: whether places that the drive comes back to are looked for.
    """

    threshold_db: float = 10.0
    near_m: float = 5.0
    far_m: float | None = None
    surface_m: float = 3.5
    neighbours: int = 4
    least_score: float = 0.4
    loop_score: float = 0.55
    independent: float = 0.1
    motion: Motion = field(default_factory=Motion)
    loops: bool = True


@dataclass(frozen=True, kw_only=True)
class Slam:
    """A way and its uncertainty.

    images: from which they are made. time_s: middle of each turn.
    state: east and north, m, heading clockwise from north, rad, velocity ahead and to the right, m/s, yaw rate, rad/s.
    sigma: standard deviations of east, north (m) and heading (rad), given the first.
    lost: turns that lie on nothing seen before. loops: pairs of turns at one place.
    odometer: scale error of the odometer and bias of the gyroscope, rad/s, as estimated; None without odometry.
    true_state: of a simulated drive, as `state`; drift: against it; None without.
    """

    images: PolarImages
    time_s: Float[np.ndarray, " turn"]
    state: Float[np.ndarray, "turn 6"]
    sigma: Float[np.ndarray, "turn 3"]
    lost: Bool[np.ndarray, " turn"]
    loops: tuple[tuple[int, int], ...]
    odometer: Float[np.ndarray, " 2"] | None
    true_state: Float[np.ndarray, "turn 6"] | None
    drift: Drift | None

    @property
    def way_m(self) -> float:
        """Length of the way."""
        return float(np.linalg.norm(np.diff(self.state[:, :2], axis=0), axis=1).sum())

    def __repr__(self) -> str:
        return f"Slam: {len(self.state)} turns over {self.way_m:.0f} m, {len(self.loops)} loops, {self.lost.sum()} lost"

    @property
    def way(self) -> Way:
        """Place, velocity and bearing of every chirp."""
        since = self.images.time_s - self.time_s[:, None]
        ahead, right, yaw = (self.state[:, i, None] for i in (3, 4, 5))
        half = self.state[:, 2, None] + yaw * since / 2
        heading = self.state[:, 2, None] + yaw * since
        place = self.state[:, None, :2] + _turned(ahead * since, right * since, half)
        velocity = _turned(ahead + 0 * since, right + 0 * since, heading)
        level = np.zeros((*since.shape, 1))
        return Way(
            position_m=np.concatenate([place, level], axis=2),
            velocity_mps=np.concatenate([velocity, level], axis=2),
            bearing_rad=np.unwrap(self.images.scan_rad + heading, axis=1),
        )


def _turned(
    ahead: Float[np.ndarray, "turn azimuth"],
    right: Float[np.ndarray, "turn azimuth"],
    heading: Float[np.ndarray, "turn azimuth"],
) -> Float[np.ndarray, "turn azimuth 2"]:
    """Return east and north of components ahead and to the right."""
    sin, cos = np.sin(heading), np.cos(heading)
    return np.stack([ahead * sin + right * cos, ahead * cos - right * sin], axis=2)


@on_one_thread
def slam(images: PolarImages, options: SlamOptions | None = None, odometry: Odometry | None = None) -> Slam:
    """Return the way of a panoramic radar, and its uncertainty, from its images.

    Parameters
    ----------
    images:
        Of successive turns, as `panorama` makes and `read_images` reads them.
    options:
        Thresholds, sizes, and how the vehicle moves.
    odometry:
        Speeds of an odometer, yaw rates of a gyroscope, or both. The odometer's scale and the gyroscope's bias are
        estimated with the way.

    Returns
    -------
    Pose and velocity in the middle of each turn, with standard deviations, the turns that are lost, and the loops.

    Raises
    ------
    InputFileError
        Fewer than three turns, a gap between them, a first turn without surroundings, or odometry that does not span
        the turns.
    ScenarioError
        Surfaces larger than an eighth of the range.

    Examples
    --------
    >>> drive = {"platform.waypoints_m": [[-104.0, -60.0], [-104.0, -10.0]], "fences": []}
    >>> found = slam(panorama(load_scenario("stadium", drive)).images)
    >>> bool(abs(found.state[-1, 1] - found.true_state[-1, 1]) < 2.0), int(found.lost.sum())
    (True, 0)
    """
    options = options or SlamOptions()
    return _Slam(images, options, odometry).result()


class _Slam:
    """The steps of `slam`; states are north, east and heading, so that ahead and right turn as they do."""

    def __init__(self, images: PolarImages, options: SlamOptions, odometry: Odometry | None) -> None:
        self._images, self._options = images, options
        self._time_s = images.time_s.mean(axis=1)
        self._far_m = farthest_m(images, options)
        self._odometry = check_drive(images, options, odometry)
        # Half a range cell, or the unevenness of what stands in a square, whichever is more.
        self._sigma_m = max(images.chirp.range_resolution_m / 2, options.surface_m * UNEVEN)
        with stage("peaks", len(images)):
            self._peaks = [self._peaks_of(turn) for turn in range(len(images))]

    def _peaks_of(self, turn: int) -> Peaks:
        advance()
        options = self._options
        return peaks_of(self._images, turn, threshold_db=options.threshold_db, near_m=options.near_m, far_m=self._far_m)

    def _surfaces(self, turn: int, twist: Float[np.ndarray, " 3"]) -> Surfaces:
        return surfaces_of(self._peaks[turn], twist, size_m=self._options.surface_m, sigma_m=self._sigma_m)

    def result(self) -> Slam:
        """Return the way."""
        states, lost = self._one_after_the_other()
        near = [(turn, k) for turn in range(1, len(states)) for k in self._before(turn, list(states))]
        # The surfaces are made anew with the twists that all turns together tell.
        solved = self._solved(self._solved(states, near).states, near)
        loops: list[tuple[int, int]] = []
        for _ in range(ROUNDS if self._options.loops else 0):
            found, anchors = self._loops(solved)
            if found == loops:
                break
            loops = found
            drawn = self._solved(solved.states, near, anchors)
            solved = self._solved(drawn.states, near + loops)
        scores = solved.scores[len(near) :]
        kept = tuple(pair for pair, score in zip(loops, scores, strict=True) if score >= self._options.least_score)
        return self._as_slam(solved, lost, kept)

    def _one_after_the_other(self) -> tuple[Float[np.ndarray, "turn 6"], Bool[np.ndarray, " turn"]]:
        """Return the states that follow from laying each turn on those before it, and which do not."""
        options, count = self._options, len(self._peaks)
        states, lost = [self._first()], np.zeros(count, dtype=bool)
        with stage("turns", count - 1):
            for turn in range(1, count):
                before = self._before(turn, states)
                around = Surfaces.concatenate([self._surfaces(k, states[k][3:]).moved(states[k][:3]) for k in before])
                found = self._laid(turn, around, states[-1], float(self._time_s[turn] - self._time_s[turn - 1]))
                lost[turn] = found.score < options.least_score
                expected = options.motion.ahead(states[-1], float(self._time_s[turn] - self._time_s[turn - 1])).mean
                states.append(expected if lost[turn] else found.state)
                advance()
        return np.array(states), lost

    def _before(self, turn: int, states: Sequence[Float[np.ndarray, " 6"]]) -> list[int]:
        """Return the turns that one is compared with: the last, and earlier ones that saw the same from elsewhere."""
        chosen = [turn - 1]
        for k in range(turn - 2, -1, -1):
            if len(chosen) == self._options.neighbours:
                break
            away = states[k][:3] - states[chosen[-1]][:3]
            if np.hypot(away[0], away[1]) > self._options.surface_m or abs(away[2]) > ELSEWHERE_RAD:
                chosen.append(k)
        return chosen

    def _first(self) -> Float[np.ndarray, " 6"]:
        """Return the first state: at the origin, with the twist with which the second turn lies on the first best."""
        step_s = float(self._time_s[1] - self._time_s[0])
        best: tuple[float, Float[np.ndarray, " 6"]] | None = None
        for speed in np.arange(SLOWEST_MPS, FASTEST_MPS + 0.5):
            state = np.array([0.0, 0.0, 0.0, speed, 0.0, 0.0])
            found = self._laid(1, self._surfaces(0, state[3:]), state, step_s, tries=(0.0,))
            if best is None or found.score > best[0]:
                best = found.score, found.state
        assert best is not None
        if best[0] < self._options.least_score:
            raise InputFileError(
                "the second turn does not lie on the first at any speed: nothing stands out there; "
                "lower threshold_db, or begin elsewhere"
            )
        return np.concatenate([np.zeros(3), best[1][3:]])

    def _laid(
        self,
        turn: int,
        around: Surfaces,
        before: Float[np.ndarray, " 6"],
        step_s: float,
        tries: Sequence[float] = YAW_TRIES,
    ) -> Registered:
        """Return the state in which a turn lies best on what is around it."""
        options = self._options
        prior = options.motion.ahead(before, step_s)
        best: Registered | None = None
        for change in tries:
            yaw = change * options.motion.yaw_acceleration_rad_s2 * step_s
            start = prior.mean + np.array([0.0, 0.0, yaw * step_s / 2, 0.0, 0.0, yaw])
            for _ in range(ROUNDS):
                surfaces = self._surfaces(turn, start[3:])
                found = register(surfaces, around, prior, reach_m=options.surface_m, twist=start[3:], start=start)
                start = found.state
            if best is None or found.score > best.score:
                best = found
            if best.score > 0.5 * (1 + options.least_score):
                break
        assert best is not None
        return best

    def _solved(
        self,
        states: Float[np.ndarray, "turn 6"],
        pairs: Sequence[tuple[int, int]],
        anchors: Sequence[tuple[int, int, Float[np.ndarray, " 3"]]] = (),
    ) -> Solved:
        options, twists = self._options, states[:, 3:]
        turns = [self._surfaces(turn, twist) for turn, twist in enumerate(twists)]
        with stage("solving", 1):
            solved = solve(
                turns,
                twists,
                states,
                self._time_s,
                pairs,
                options.motion,
                self._odometry,
                reach_m=options.surface_m,
                view_m=2 * self._far_m,
                share=options.independent,
                least_score=options.least_score,
                anchors=anchors,
            )
            advance()
        return solved

    def _loops(self, solved: Solved) -> tuple[list[tuple[int, int]], list[tuple[int, int, Float[np.ndarray, " 3"]]]]:
        """Return pairs of turns that lie on each other though far apart in time, and where the later ones lie.

        A place is taken for another where both look alike: a loop is one of which the turn before or after says the
        same, within the size of a surface and the heading that it tells.
        """
        options, states, far_m = self._options, solved.states, float(self._images.range_m[-1])
        maps = [self._surfaces(k, state[3:]) for k, state in enumerate(states)]
        sought = candidates(
            states, solved.covariance, apart_m=far_m, near_m=LOOP_REACH * far_m, step_m=options.surface_m
        )
        found: dict[int, Float[np.ndarray, " 3"]] = {}
        shift = np.zeros(6)
        with stage("loops", len(sought)):
            for number, (later, earlier) in enumerate(sought):
                advance()
                there = [maps[k].moved(states[k][:3]) for k in self._around(earlier)]
                between = np.maximum(np.diag(solved.covariance[later] - solved.covariance[earlier]), 0.0)
                sigma = float(np.sqrt(between[0] + between[1])), float(np.sqrt(between[2]))
                laid = close(maps[later], there, states[later] + shift, sigma, reach_m=options.surface_m)
                if laid is not None and laid.score >= options.loop_score and self._tells_place(laid):
                    found[number] = laid.state[:3]
                    shift[:3] = laid.state[:3] - states[later][:3]
        moves = {number: pose - states[sought[number][0]][:3] for number, pose in found.items()}
        pairs, anchors = [], []
        for number, pose in found.items():
            beside = [moves[n] for n in (number - 1, number + 1) if n in moves]
            if any(np.all(np.abs(moves[number] - other) < self._alike) for other in beside):
                later, earlier = sought[number]
                pairs += [(later, n) for n in self._around(earlier)]
                place = rotation(states[earlier][2]).T @ (pose[:2] - states[earlier][:2])
                anchors.append((later, earlier, np.array([*place, pose[2] - states[earlier][2]])))
        return pairs, anchors

    @property
    def _alike(self) -> Float[np.ndarray, " 3"]:
        """Largest difference of two successive loops."""
        return np.array([1.0, 1.0, 1.0 / ALIKE_M]) * self._options.surface_m / 2

    def _tells_place(self, laid: Registered) -> bool:
        """Whether a turn lies at one place of a map only: not, along a street of smooth walls."""
        known = np.linalg.eigvalsh(laid.seen[:2, :2] * self._options.independent)
        return bool(known[0] > (2 / self._options.surface_m) ** 2)

    def _around(self, earlier: int) -> range:
        """Return the turns around an earlier one that a later one is laid on."""
        return range(max(0, earlier - 2), earlier + 3)

    def _as_slam(self, solved: Solved, lost: Bool[np.ndarray, " turn"], loops: tuple[tuple[int, int], ...]) -> Slam:
        images, states = self._images, solved.states.copy()
        true = None if images.true is None else states_of(images.true, images)
        start = true if true is not None else None if images.measured is None else states_of(images.measured, images)
        if start is not None:
            # From where, and in the direction in which, the recording says that it began.
            turn = start[0, 2] - states[0, 2]
            states[:, :2] = states[:, :2] @ rotation(turn).T + start[0, 1::-1]
            states[:, 2] += turn
            covariance = rotation(turn) @ solved.covariance[:, :2, :2] @ rotation(turn).T
        else:
            covariance = solved.covariance[:, :2, :2]
        sigma = np.sqrt(np.column_stack([covariance[:, 1, 1], covariance[:, 0, 0], solved.covariance[:, 2, 2]]))
        state = np.column_stack([states[:, 1], states[:, 0], np.unwrap(states[:, 2]), states[:, 3:]])
        return Slam(
            images=images,
            time_s=self._time_s,
            state=state,
            sigma=np.maximum(sigma, 0.0),
            lost=lost,
            loops=loops,
            odometer=None if self._odometry is None else solved.odometer,
            true_state=true,
            drift=None if true is None else drift_of(state, true),
        )


def states_of(way: Way, images: PolarImages) -> Float[np.ndarray, "turn 6"]:
    """Return the states in the middle of each turn of a known way, as those of `Slam`."""
    states = []
    for turn, time_s in enumerate(images.time_s):
        middle_s = time_s.mean()
        place = [np.interp(middle_s, time_s, way.position_m[turn, :, i]) for i in range(2)]
        heading = np.unwrap(way.bearing_rad[turn] - images.scan_rad[turn])
        east, north = (np.interp(middle_s, time_s, way.velocity_mps[turn, :, i]) for i in range(2))
        at = np.interp(middle_s, time_s, heading)
        yaw = (heading[-1] - heading[0]) / (time_s[-1] - time_s[0])
        ahead, right = east * np.sin(at) + north * np.cos(at), east * np.cos(at) - north * np.sin(at)
        states.append([*place, at, ahead, right, yaw])
    found = np.array(states)
    found[:, 2] = np.unwrap(found[:, 2])
    return found


def farthest_m(images: PolarImages, options: SlamOptions) -> float:
    """Return the farthest range that counts."""
    return options.far_m or 0.9 * float(images.range_m[-1])


def check_drive(images: PolarImages, options: SlamOptions, odometry: Odometry | None) -> Increments | None:
    """Return the increments of the odometry from turn to turn; None without odometry.

    Raises InputFileError for too few turns, gaps between them, and odometry that does not span them; ScenarioError for
    surfaces too large for the images. Powers need not be known yet.
    """
    most_m = MAX_SURFACE_RANGE * farthest_m(images, options)
    if options.surface_m > most_m:
        message = (
            f"{options.surface_m:g} m is more than an eighth of the range, {most_m / MAX_SURFACE_RANGE:.0f} m: such a "
            "square holds walls of several directions, and their mean moves with the vehicle; "
            f"give at most {np.floor(10 * most_m) / 10:g} m"
        )
        raise ScenarioError.of_option("--surface", message)
    least_m = MIN_SURFACE_CELLS * images.chirp.range_resolution_m
    if options.surface_m < least_m:
        logger.warning(
            "--surface: %g m is less than %g range cells: few such squares hold the %d peaks of a surface, turns may "
            "be lost, and the way may be off by more than is stated; give %.2g m or more",
            *(options.surface_m, MIN_SURFACE_CELLS, MIN_PEAKS, least_m),
        )
    if -images.chirp.doppler_range_s > LARGEST_FALLING * images.turn_s:
        logger.warning(
            "a falling sweep shows what is ahead farther by %.2g m per m/s, which over turns of %.2g s looks as "
            "standing back does: the way may be lost, and stated far too well; let it rise (radar.sweep = 'up'), or "
            "raise radar.chirp_rate_hz or radar.bandwidth_hz",
            -images.chirp.doppler_range_s,
            images.turn_s,
        )
    time_s = images.time_s.mean(axis=1)
    if len(time_s) < 3:
        raise InputFileError(f"{len(time_s)} turns: give three or more")
    steps = np.diff(time_s)
    gap = int(np.argmax(steps))
    if steps[gap] > 2.5 * np.median(steps):
        raise InputFileError(
            f"{steps[gap]:.3g} s pass between turns {gap} and {gap + 1}, {steps[gap] / np.median(steps):.1f} turns; "
            "give a recording without gaps"
        )
    return None if odometry is None else odometry.between(time_s)
