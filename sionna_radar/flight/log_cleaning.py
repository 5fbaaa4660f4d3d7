"""Defects of a log: some are repaired and noted, the others prevent its use.

Repaired: values that are not finite, duplicate time stamps (the last one counts), rows out of order by less than a
second, quaternions of either sign, attitudes that begin later or end earlier than the positions.
Rejected: a clock that runs backward, gaps, jumps, implausible turns, a stationary vehicle.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.spatial.transform import Rotation

from sionna_radar.flight.log import Attitudes, FlightLog, Positions, Spreads

# Logs are written in blocks, sometimes slightly out of order.
MAX_OUT_OF_ORDER_S = 1.0
# A step that exceeds twice the reported velocity by this much is a jump of the receiver or the filter.
JUMP_MPS, JUMP_M = 20.0, 3.0
# Without velocities: ratio of a step's speed to the typical speed of the flight.
JUMP_RATIO = 10.0
TURN_RAD_S, TURN_RAD = np.deg2rad(1500.0), np.deg2rad(20.0)
# Drift of a GPS fix at rest; a vehicle that stays within it for this long is at rest.
STANDSTILL_M, STANDSTILL_S = 5.0, 10.0
# Times at which rest is looked for, at most.
MAX_LOOKS = 100_000
MIN_ROWS = 4
MAX_STRETCHES = 10
Stream = TypeVar("Stream", Positions, Attitudes, Spreads)


@dataclass(frozen=True, kw_only=True)
class Finding:
    """A defect that prevents the use of a part of a log: its time, and a message with a remedy."""

    time_s: float
    message: str


@dataclass(frozen=True, kw_only=True)
class CleanLog:
    """A part of a log, repaired where possible.

    positions, attitudes, spreads: sorted by unique times; attitudes are None without any.
    findings: defects that prevent its use, in order of time; notes: repairs.
    """

    positions: Positions
    attitudes: Attitudes | None
    spreads: Spreads | None
    findings: tuple[Finding, ...]
    notes: tuple[str, ...]

    @property
    def span_s(self) -> tuple[float, float]:
        """Time span covered by positions and, if any, attitudes."""
        start, stop = float(self.positions.time_s[0]), float(self.positions.time_s[-1])
        if self.attitudes is not None:
            start = max(start, float(self.attitudes.time_s[0]))
            stop = min(stop, float(self.attitudes.time_s[-1]))
        return start, stop


def clean(log: FlightLog, start_s: float, stop_s: float, longest_gap_s: float) -> CleanLog:
    """Repair the part of a log in metres between two times, and find the defects that prevent its use."""
    findings: list[Finding] = []
    notes: list[str] = []
    finite = np.isfinite(log.positions.place).all(axis=1)
    if log.positions.velocity_mps is not None:
        finite &= np.isfinite(log.positions.velocity_mps).all(axis=1)
    positions = _in_order(log.positions.rows(finite), start_s, stop_s, "positions", findings, notes)
    if not finite.all():
        notes.append(f"{np.sum(~finite):,} positions are no numbers, and left out")
    attitudes = spreads = None
    if log.attitudes is not None:
        finite_times = np.isfinite(log.attitudes.time_s)
        # Include one attitude beyond each end for interpolation.
        attitudes = _in_order(
            log.attitudes.rows(finite_times),
            start_s - longest_gap_s,
            stop_s + longest_gap_s,
            "attitudes",
            findings,
            notes,
        )
        if len(attitudes.time_s) < 2:
            attitudes = None
    if log.spreads is not None:
        finite_times = np.isfinite(log.spreads.time_s)
        spreads = _in_order(log.spreads.rows(finite_times), -np.inf, np.inf, "", [], [])
    if len(positions.time_s) < MIN_ROWS:
        message = f"has {len(positions.time_s)} distinct time stamps between {start_s:.3g} and {stop_s:.6g} s"
        findings.append(Finding(time_s=max(start_s, 0.0), message=f"{message}; widen log_start_s and log_stop_s"))
    else:
        findings += _gaps(positions.time_s, "position", longest_gap_s) + _jumps(positions)
        findings += _standstill(positions, log)
    if attitudes is not None and len(positions.time_s) >= MIN_ROWS:
        findings += _attitude_findings(attitudes, positions.time_s, longest_gap_s)
    ordered = tuple(sorted(findings, key=lambda finding: finding.time_s))
    return CleanLog(positions=positions, attitudes=attitudes, spreads=spreads, findings=ordered, notes=tuple(notes))


def stretches(log: FlightLog, start_s: float, stop_s: float, longest_gap_s: float) -> tuple[tuple[float, float], ...]:
    """Return start and end times of the longest usable parts of a log in metres, in order of time."""
    log_part = clean(log, start_s, stop_s, longest_gap_s)
    time_s = log_part.positions.time_s
    broken = np.diff(time_s) > longest_gap_s
    broken[_jump_rows(log_part.positions)[0]] = True
    if log_part.attitudes is not None:
        attitude_s = log_part.attitudes.time_s
        for row in np.flatnonzero((np.diff(attitude_s) > longest_gap_s) | _reset(log_part.attitudes)):
            broken[
                max(np.searchsorted(time_s, attitude_s[row], side="right") - 1, 0) : np.searchsorted(
                    time_s, attitude_s[row + 1]
                )
            ] = True
    edges = np.concatenate([[0], np.flatnonzero(broken) + 1, [len(time_s)]])
    intervals = [(float(time_s[a]), float(time_s[b - 1])) for a, b in pairwise(edges) if b - a >= MIN_ROWS]
    longest = sorted(intervals, key=lambda ends: ends[0] - ends[1])[:MAX_STRETCHES]
    return tuple(sorted(ends for ends in longest if not clean(log, *ends, longest_gap_s).findings))


def _in_order(
    stream: Stream, start_s: float, stop_s: float, name: str, findings: list[Finding], notes: list[str]
) -> Stream:
    """Return the rows between two times, sorted by unique times."""
    stream = stream.rows((stream.time_s >= start_s) & (stream.time_s <= stop_s))
    time_s = stream.time_s
    lag_s = np.maximum.accumulate(time_s) - time_s if len(time_s) else time_s
    if np.any(lag_s > MAX_OUT_OF_ORDER_S):
        row = int(np.argmax(lag_s > MAX_OUT_OF_ORDER_S))
        message = (
            f"time runs back by {lag_s[row]:.3g} s in row {row + 1} of the {name}; start after it with log_start_s = "
            f"{time_s[row] + lag_s[row] + 0.01:.2f}, or keep one flight in the file"
        )
        findings.append(Finding(time_s=float(time_s[row]), message=message))
    elif np.any(lag_s > 0):
        notes.append(f"{np.sum(lag_s > 0):,} {name} are out of order by up to {lag_s.max():.2g} s, and sorted")
    order = np.argsort(time_s, kind="stable")
    unique: Bool[np.ndarray, " n"] = np.append(np.diff(time_s[order]) > 0, True)[: len(order)]
    if not unique.all() and name:
        notes.append(f"{np.sum(~unique):,} {name} have the time of the next one, and are left out")
    return stream.rows(order[unique])


def _gaps(time_s: Float[np.ndarray, " n"], name: str, longest_s: float) -> list[Finding]:
    """Return the first gap, with the number of gaps."""
    step = np.diff(time_s)
    gaps = np.flatnonzero(step > longest_s)
    if not len(gaps):
        return []
    row = gaps[0]
    count_note = f" ({len(gaps) - 1:,} more, the longest of all {step.max():.3g} s)" if len(gaps) > 1 else ""
    message = (
        f"no {name} for {step[row]:.3g} s, longer than log_gap_s = {longest_s:g}{count_note}; end before it with "
        f"log_stop_s, start after it with log_start_s = {time_s[row + 1]:.2f}, or raise log_gap_s"
    )
    return [Finding(time_s=float(time_s[row]), message=message)]


def _jump_rows(positions: Positions) -> tuple[Int[np.ndarray, " jump"], Float[np.ndarray, "step 3"]]:
    """Return the rows before implausible steps, and all steps."""
    step_s = np.diff(positions.time_s)
    step = np.diff(positions.place, axis=0)
    if positions.velocity_mps is None:
        speed = np.linalg.norm(step, axis=1) / step_s
        excess = speed - JUMP_RATIO * np.median(speed)
        off_m = np.linalg.norm(step, axis=1)
    else:
        velocity = (positions.velocity_mps[1:] + positions.velocity_mps[:-1]) / 2
        off_m = np.linalg.norm(step - velocity * step_s[:, None], axis=1)
        excess = off_m / step_s - 2 * np.linalg.norm(velocity, axis=1)
    return np.flatnonzero((excess > JUMP_MPS) & (off_m > JUMP_M)), step


def _jumps(positions: Positions) -> list[Finding]:
    """Return the first implausible step, with the number of such steps."""
    jumps, step = _jump_rows(positions)
    step_s = np.diff(positions.time_s)
    if not len(jumps):
        return []
    row = jumps[0]
    count_note = f" ({len(jumps) - 1:,} more)" if len(jumps) > 1 else ""
    message = (
        f"the position jumps by {np.linalg.norm(step[row]):.1f} m in {step_s[row]:.2g} s, a reset of the receiver or "
        f"the filter{count_note}; end before it with log_stop_s, or start after it with log_start_s"
    )
    return [Finding(time_s=float(positions.time_s[row + 1]), message=message)]


def _standstill(positions: Positions, log: FlightLog) -> list[Finding]:
    """Return the finding of a part in which the vehicle is at rest, with the times at which it moves in the log."""
    reach = np.ptp(positions.place[:, :2], axis=0)
    if float(np.hypot(*reach)) > STANDSTILL_M:
        return []
    known = np.isfinite(log.positions.place).all(axis=1) & np.isfinite(log.positions.time_s)
    whole = _in_order(log.positions.rows(known), -np.inf, np.inf, "", [], [])
    moving = [f"{start:.2f} to {stop:.2f} s" for start, stop in moving_spans(whole)]
    message = (
        f"vehicle stationary, within {np.hypot(*reach):.2g} m, from {positions.time_s[0]:.2f} to "
        f"{positions.time_s[-1]:.2f} s; "
    )
    remedy = f"choose a moving stretch by log_start_s and log_stop_s: {', '.join(moving[:MAX_STRETCHES])}"
    return [
        Finding(
            time_s=float(positions.time_s[0]),
            message=message + (remedy if moving else "it moves nowhere in this log; give the log of a flight"),
        )
    ]


def moving_spans(positions: Positions) -> tuple[tuple[float, float], ...]:
    """Return start and end times of the parts in which a vehicle moves, between those in which it is at rest.

    positions: finite, at increasing times.
    """
    time_s = positions.time_s
    if len(time_s) < MIN_ROWS or time_s[-1] <= time_s[0]:
        return ()
    step_s = max(STANDSTILL_S / 10, float(time_s[-1] - time_s[0]) / MAX_LOOKS)
    at_s = np.append(np.arange(time_s[0], time_s[-1], step_s), time_s[-1])
    place = np.column_stack([np.interp(at_s, time_s, column) for column in positions.place[:, :2].T])
    half = int(np.ceil(STANDSTILL_S / step_s / 2))
    looks = 2 * half + 1
    reach = maximum_filter1d(place, looks, axis=0) - minimum_filter1d(place, looks, axis=0)
    within = np.hypot(*reach.T) <= STANDSTILL_M
    within[:half] = within[-half:] = False  # whole windows alone
    resting = maximum_filter1d(within, looks, mode="constant", cval=0)
    edges = np.flatnonzero(np.diff(np.concatenate([[True], resting, [True]]).astype(int)))
    return tuple((float(at_s[first]), float(at_s[end - 1])) for first, end in edges.reshape(-1, 2) if end - first > 1)


def one_time(log: FlightLog) -> str:
    """Return the remark on a log whose positions all have one time."""
    count, moment_s = len(log.positions.time_s), float(log.positions.time_s[0])
    return f"only one distinct time stamp ({moment_s:g} s, of {count:,} positions); export the track with its times"


def _turns_rad(attitudes: Attitudes) -> Float[np.ndarray, " step"]:
    turned = Rotation.from_quat(attitudes.quaternion)
    return np.asarray((turned[:-1].inv() * turned[1:]).magnitude())


def _reset(attitudes: Attitudes) -> Bool[np.ndarray, " step"]:
    """Return the mask of steps whose turn exceeds both the angle and the rate of any aircraft."""
    angle = _turns_rad(attitudes)
    return np.asarray((angle > TURN_RAD) & (angle > TURN_RAD_S * np.diff(attitudes.time_s)))


def _attitude_findings(
    attitudes: Attitudes, position_s: Float[np.ndarray, " n"], longest_gap_s: float
) -> list[Finding]:
    time_s = attitudes.time_s
    findings = []
    for delay_s, edge_s, verb in (
        (time_s[0] - position_s[0], position_s[0], "begin"),
        (position_s[-1] - time_s[-1], time_s[-1], "end"),
    ):
        if delay_s > longest_gap_s:
            message = f"attitudes {verb} {delay_s:.3g} s {'after' if verb == 'begin' else 'before'} the positions; "
            remedy = f"set log_start_s = {time_s[0]:.2f}" if verb == "begin" else f"set log_stop_s = {time_s[-1]:.2f}"
            findings.append(Finding(time_s=float(edge_s), message=message + remedy))
    overlap = (time_s >= position_s[0] - longest_gap_s) & (time_s <= position_s[-1] + longest_gap_s)
    findings += _gaps(time_s[overlap], "attitude", longest_gap_s)
    angle = _turns_rad(attitudes)
    resets = np.flatnonzero(_reset(attitudes) & overlap[1:])
    for row in resets[:1]:
        count_note = f" ({len(resets) - 1:,} more)" if len(resets) > 1 else ""
        message = (
            f"the attitude turns by {np.rad2deg(angle[row]):.0f} deg within {time_s[row + 1] - time_s[row]:.2g} s, a "
            f"reset of the filter{count_note}; end before it with log_stop_s, or start after it with log_start_s"
        )
        findings.append(Finding(time_s=float(time_s[row + 1]), message=message))
    return findings
