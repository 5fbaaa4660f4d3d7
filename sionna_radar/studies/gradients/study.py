"""How echoes answer to a parameter: derivatives of power, mean range and range profile of single pulses.

A parameter is a number of the scenario by its dotted key (of a material, of the antenna, of the flight), or one of the
pose that no key names: a shift of the radar (`pose.east_m`, `pose.north_m`, `pose.up_m`), a turn of the antenna about
the level axes of the flight (`pose.roll_deg`, `pose.pitch_deg`, `pose.heading_deg`, as an error of its mounting is),
and a bias of ranges (`range_bias_m`). The survey is prepared for a key just below and just above its value: how poses
and the tables of pattern and materials change is the direction in which Dr.Jit differentiates the fields
(`tracing.engines.beam.frozen`).

The echo is an integral over the beam, which rays sample. Derivatives are exact for these rays; as those of the integral
they have a sampling error, which is stated. Rays come in pairs of opposite directions about the beam's axis: what is
odd over the beam, most of the scatter, cancels. Sets of pairs are drawn anew some times, and the standard error of
their mean derivative is that of independent draws.

Each derivative is held against the difference of the same echoes between the two prepared surveys, which knows nothing
of automatic differentiation. Surface that comes into view or is hidden is in the difference of surveys traced anew
alone; `retraced=True` says how large that is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.numerics import is_number
from sionna_radar.scenario.overrides import value_at
from sionna_radar.scenario.radar import refuse_squint
from sionna_radar.survey.preparation import Prepared, prepare

if TYPE_CHECKING:  # the ray tracer is loaded by the call alone
    from sionna_radar.tracing.engines.beam.beam import BeamEngine
    from sionna_radar.tracing.engines.beam.frozen import Direction, FrozenEchoes, RangeCells
    from sionna_radar.tracing.engines.beam.rays import CutRays, GridRays

Quantity = Literal["echo_power", "mean_range", "profile"]
_Values = dict[str, Float[np.ndarray, "pulse ..."]]
SHIFTS = {"pose.east_m": 0, "pose.north_m": 1, "pose.up_m": 2}
TURNS = {"pose.roll_deg": 0, "pose.pitch_deg": 1, "pose.heading_deg": 2}
RANGE_BIAS = "range_bias_m"
# Step of a key as a share of its value, and of one that is zero; of turns, deg; of shifts, m, and where phases turn
# with them, a share of the wavelength: rounding and curvature of difference quotients are both small.
STEP, MIN_STEP, TURN_DEG, SHIFT_M, SHIFT_WAVELENGTHS = 1e-3, 1e-3, 1e-3, 1e-2, 1e-3
# Steps of surveys traced anew are larger by this, so that the scatter of their rays is small in the quotient.
RETRACED_STEPS = 50.0
# Half-length of the window's response in profiles, range cells; it fades out over the last two, so that profiles are
# smooth where a target passes from cell to cell.
RESPONSE_CELLS = 6
# Largest RMS difference between derivative and difference quotient, over the RMS of the latter.
TOLERANCE = 0.01
# Independent draws of the rays of a pulse: the standard error is known within a quarter.
DRAWS = 8
# RMS rounding of a quantity, over its RMS: single precision, summed over the places of a pulse.
ROUNDING = 1e-5


@dataclass(frozen=True, kw_only=True)
class Sensitivities:
    """Derivatives of quantities of pulses.

    values: each quantity: `echo_power` over the transmitted power, `mean_range` m, (pulse), `profile` over the
        transmitted power, (pulse, cell).
    derivatives: of each quantity by each parameter, per unit of the parameter (dB for keys in dB), of the same shape.
    standard_errors: of each derivative, from the sampling of the beam by rays, of the same shape; zeros with fixed
        speckle, whose scatterers are the surface.
    deviations: RMS of the derivative less the difference quotient of the same rays, over the RMS of the latter.
    left_out: the same with surveys traced anew, which meet other facets, and surface that comes into view or is hidden;
        empty unless asked for.
    range_m: ranges of the profile's cells.
    """

    values: Mapping[str, Float[np.ndarray, "pulse ..."]]
    derivatives: Mapping[tuple[str, str], Float[np.ndarray, "pulse ..."]]
    standard_errors: Mapping[tuple[str, str], Float[np.ndarray, "pulse ..."]]
    deviations: Mapping[tuple[str, str], float]
    left_out: Mapping[tuple[str, str], float]
    range_m: Float[np.ndarray, " cell"]

    def __getitem__(self, names: tuple[str, str]) -> Float[np.ndarray, "pulse ..."]:
        """Return the derivative of a quantity by a parameter."""
        return self.derivatives[names]


@dataclass(frozen=True)
class _State:
    """The radar at one value of a parameter: its engine, the poses of the pulses, the bias of its ranges."""

    engine: "BeamEngine"
    pulses: Pulses
    range_bias_m: float = 0.0


def sensitivities(
    prepared: Prepared,
    pulses: Int[np.ndarray, " pulse"] | Sequence[int],
    *,
    of: Sequence[Quantity] = ("echo_power", "mean_range"),
    to: Sequence[str],
    speckle: Literal["expected", "fixed"] = "expected",
    retraced: bool = False,
) -> Sensitivities:
    """Return derivatives of the echoes of some pulses.

    Surfaces alone, one way there and back: no mirrors, targets, plants, rain or loss of the air, and no noise.

    Parameters
    ----------
    prepared:
        The survey, with the antenna of one beam.
    pulses:
        Their running numbers, increasing.
    of:
        Quantities: "echo_power", "mean_range", "profile".
    to:
        Parameters: dotted keys of numbers in the scenario, shifts and turns of the radar ("pose.up_m",
        "pose.pitch_deg", ...), "range_bias_m".
    speckle:
        Mean power in the cells of a profile, or that of one draw of the scatterers' phases.
    retraced:
        Also trace surveys anew on both sides of each parameter, for what rays of one tracing leave out.

    Returns
    -------
    Quantities by pulse, and their derivatives per unit of each parameter (dB for keys in dB), of the same shape.

    Raises
    ------
    ScenarioError
        No such number, a key that moves the ground or changes the kind of antenna or material, a derivative that
        differs from the difference quotient by more than 1 %, such as one that is zero where that is not.

    Examples
    --------
    >>> prepared = prepare(load_scenario("hills", {"platform.length_m": 10.0, "tracing.paths_per_pulse": 64}))
    >>> found = sensitivities(prepared, [0, 50], of=["mean_range"], to=["pose.up_m"])
    >>> bool((found["mean_range", "pose.up_m"] > 1).all())  # a metre higher, and more than a metre farther on a slant
    True

    """
    if unknown := sorted(set(of) - set(get_args(Quantity))):
        raise ValueError(f"of = {unknown}: give {', '.join(get_args(Quantity))}")
    refuse_squint(prepared.local.radar, "a derivative")
    from sionna_radar.tracing.engines.beam.rays import wide_beam_rays

    index = np.asarray(pulses, dtype=np.int64)
    here = _state(prepared, index)
    cells, fixed = _range_cells(prepared), speckle == "fixed"
    draws = 1 if fixed else DRAWS
    to_sides = partial(_sides, prepared, here, index, fixed)
    sides = {name: to_sides(name) for name in to}
    directions = [_direction(name, here, *side) for name, side in sides.items()]
    trace = partial(_frozen, rays=wide_beam_rays(prepared.instrument.antenna), cells=cells, fixed=fixed, draws=draws)
    frozen = trace(here)
    values = _evaluated(frozen, here, of)
    found = [[f.derivatives(here.engine.sionna, here.pulses.true, directions, of) for f in pair] for pair in frozen]
    derivatives: dict[tuple[str, str], Float[np.ndarray, "pulse ..."]] = {}
    standard_errors: dict[tuple[str, str], Float[np.ndarray, "pulse ..."]] = {}
    deviations: dict[tuple[str, str], float] = {}
    left_out: dict[tuple[str, str], float] = {}
    for number, (name, (low, high, step)) in enumerate(sides.items()):
        quotients = _quotients(_evaluated(frozen, low, of), _evaluated(frozen, high, of), step)
        for quantity in of:
            each = np.array([np.mean([one[number][quantity] for one in pair], axis=0) for pair in found])
            rates = each.mean(axis=0)
            derivatives[quantity, name] = rates
            standard_errors[quantity, name] = each.std(axis=0, ddof=1 if draws > 1 else 0) / np.sqrt(draws)
            deviations[quantity, name] = _deviation(
                rates, quotients[quantity], ROUNDING * _rms(values[quantity]) / step
            )
            if deviations[quantity, name] > TOLERANCE:
                raise ScenarioError.of(name, _why_refused(quantity, rates, quotients[quantity]))
        if retraced:
            low, high, step = to_sides(name, RETRACED_STEPS)
            anew = _quotients(_evaluated(trace(low), low, of), _evaluated(trace(high), high, of), step)
            for quantity in of:
                rounding = ROUNDING * _rms(values[quantity]) / step
                left_out[quantity, name] = _deviation(derivatives[quantity, name], anew[quantity], rounding)
    return Sensitivities(
        values=values,
        derivatives=derivatives,
        standard_errors=standard_errors,
        deviations=deviations,
        left_out=left_out,
        range_m=(cells.chirp.first_cell + np.arange(cells.count)) * cells.chirp.range_resolution_m,
    )


def _state(prepared: Prepared, index: Int[np.ndarray, " pulse"]) -> _State:
    if prepared.instrument.beams:
        message = "an electronic scan has an antenna for each beam; take a survey with one"
        raise ScenarioError.of("radar.scan.mode", message)
    from sionna_radar.tracing.engines.beam.beam import BeamEngine

    inputs, table = prepared.engine_inputs(), prepared.local.tracing
    engine = BeamEngine(
        inputs.scene, inputs.antenna, inputs.chirp, inputs.seed, table.paths, table.side_lobe_share, inputs.caster
    )
    return _State(engine, prepared.flight.pulses(index))


def _range_cells(prepared: Prepared) -> "RangeCells":
    """Return the cells of the spectrum, and the amplitude of a target in them."""
    from sionna_radar.tracing.engines.beam.frozen import RangeCells

    analyser = prepared.instrument.detector.analyser
    count = len(analyser.range_m[:: analyser.zero_padding])
    return RangeCells(chirp=analyser.chirp, count=count, response=_response(analyser.window.tobytes()))


@lru_cache(maxsize=4)
def _response(window: bytes) -> Float[np.ndarray, " step"]:
    """Return the amplitude of a target in the cells around it; window: that over the samples, as bytes of float64."""
    from sionna_radar.tracing.engines.beam.frozen import STEPS_PER_CELL

    weight = np.frombuffer(window)
    step = np.arange(-RESPONSE_CELLS * STEPS_PER_CELL, RESPONSE_CELLS * STEPS_PER_CELL + 1) / STEPS_PER_CELL
    sample = np.arange(len(weight)) - len(weight) // 2
    response = np.cos(2 * np.pi * np.outer(step, sample) / len(weight)) @ weight
    response *= np.cos(np.pi / 4 * np.clip(np.abs(step) - (RESPONSE_CELLS - 2.5), 0.0, 2.0)) ** 2
    return response


def _frozen(
    state: _State, rays: "CutRays | GridRays", cells: "RangeCells", *, fixed: bool, draws: int
) -> list[list["FrozenEchoes"]]:
    """Return the echoes on the places of each draw of rays: two with opposite rays, or one with fixed speckle."""
    from sionna_radar.tracing.engines.beam.frozen import FrozenEchoes

    if fixed:
        return [[FrozenEchoes(state.engine, state.pulses, cells, fixed_speckle=True)]]
    return [
        [
            FrozenEchoes(state.engine.with_rays(rays, draw, opposite=side), state.pulses, cells, fixed_speckle=False)
            for side in (False, True)
        ]
        for draw in range(draws)
    ]


def _evaluated(frozen: Sequence[Sequence["FrozenEchoes"]], state: _State, of: Sequence[str]) -> _Values:
    """Return the mean of quantities over all draws of rays."""
    sionna, pose, bias_m = state.engine.sionna, state.pulses.true, state.range_bias_m
    each = [one.evaluate(sionna, pose, of, bias_m) for pair in frozen for one in pair]
    return {name: np.mean([values[name] for values in each], axis=0) for name in of}


def _sides(
    prepared: Prepared, here: _State, index: Int[np.ndarray, " pulse"], fixed: bool, name: str, steps: float = 1.0
) -> tuple[_State, _State, float]:
    """Return the radar below and above the value of a parameter, and the step between them."""
    wavelength_m = float(here.engine.sionna.wavelength[0])
    if name == RANGE_BIAS:
        step = steps * SHIFT_M
        return replace(here, range_bias_m=-step), replace(here, range_bias_m=step), 2 * step
    if name in SHIFTS or name in TURNS:
        step = steps * (TURN_DEG if name in TURNS else SHIFT_WAVELENGTHS * wavelength_m if fixed else SHIFT_M)
        low, high = (replace(here, pulses=_moved(here.pulses, name, sign * step)) for sign in (-1, 1))
        return low, high, 2 * step
    if not is_number(value := value_at(prepared.scenario, name)):
        message = f"is {value!r} in the scenario, not a number; state one there, or give another key"
        raise ScenarioError.of(name, message)
    step = STEP * abs(value) or MIN_STEP
    if name.startswith(("platform.", "radar.scan.")):
        moving_m = SHIFT_WAVELENGTHS * wavelength_m if fixed else SHIFT_M
        step = min(step, 10 * TURN_DEG if name.endswith("_deg") else moving_m)
    step *= steps
    ends = [prepare(prepared.scenario.replace({name: value + sign * step}), prepared.custom) for sign in (-1, 1)]
    for end in ends:
        surfaces = zip(prepared.world.scene.surfaces, end.world.scene.surfaces, strict=False)
        if not all(ours is theirs or np.array_equal(ours.vertices_m, theirs.vertices_m) for ours, theirs in surfaces):
            message = (
                "moves the ground or a building, which rays have met; give a material's, antenna's or flight's key"
            )
            raise ScenarioError.of(name, message)
    low, high = (_state(end, index) for end in ends)
    if any(np.any(side.pulses.time_s != here.pulses.time_s) for side in (low, high)):
        raise ScenarioError.of(name, "changes when pulses are sent; differentiate by a shift of the pose instead")
    return low, high, 2 * step


def _moved(pulses: Pulses, name: str, amount: float) -> Pulses:
    """Return pulses with the radar shifted in the world (m), or turned about the flight's level axes (deg)."""
    pose = pulses.true
    if name in SHIFTS:
        shift_m = amount * np.eye(3)[SHIFTS[name]]
        return replace(pulses, true=replace(pose, position_m=pose.position_m + shift_m))
    forward = pose.velocity_mps * [1.0, 1.0, 0.0]
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    down = np.tile([0.0, 0.0, -1.0], (len(forward), 1))
    axis = (forward, np.cross(down, forward), down)[TURNS[name]]
    turn = Rotation.from_rotvec(np.deg2rad(amount) * axis).as_matrix()
    return replace(pulses, true=replace(pose, R_world_antenna=turn @ pose.R_world_antenna))


def _direction(name: str, here: _State, low: _State, high: _State, step: float) -> "Direction":
    """Return the rates of change of poses and tables per unit of a parameter."""
    from sionna_radar.tracing.engines.beam.frozen import Direction
    from sionna_radar.tracing.sionna.pattern import sionna_angles

    ours, theirs = ([np.array(table, dtype=np.float64) for table in s.engine.sionna.tables] for s in (low, high))
    kept = [len(table) for table in here.engine.sionna.tables]
    if len(ours) != len(kept) or len(theirs) != len(kept):
        message = "changes what the pattern or a material consists of; give a key that changes its numbers alone"
        raise ScenarioError.of(name, message)
    tables = [
        (_resampled(after, length) - _resampled(before, length)) / step
        for before, after, length in zip(ours, theirs, kept, strict=True)
    ]
    before, after = low.pulses.true, high.pulses.true
    turned_rad = sionna_angles(after.R_world_antenna) - sionna_angles(before.R_world_antenna)
    return Direction(
        position_m=(after.position_m - before.position_m) / step,
        angles_rad=((turned_rad + np.pi) % (2 * np.pi) - np.pi) / step,
        velocity_mps=(after.velocity_mps - before.velocity_mps) / step,
        tables=tables,
        range_bias_m=(high.range_bias_m - low.range_bias_m) / step,
    )


def _resampled(table: Float[np.ndarray, " n"], length: int) -> Float[np.ndarray, " length"]:
    """Return a table over the same span with another number of samples, as narrower beams have more."""
    if len(table) == length:
        return table
    return np.interp(np.linspace(0.0, 1.0, length), np.linspace(0.0, 1.0, len(table)), table)


def _quotients(before: _Values, after: _Values, step: float) -> _Values:
    """Return the difference quotient of each quantity."""
    return {quantity: (after[quantity] - before[quantity]) / step for quantity in before}


def _rms(value: Float[np.ndarray, "pulse ..."]) -> float:
    return float(np.sqrt(np.mean(value**2)))


def _deviation(
    rate: Float[np.ndarray, "pulse ..."], quotient: Float[np.ndarray, "pulse ..."], rounding: float
) -> float:
    """Return the RMS difference beyond rounding, over the RMS of the quotient."""
    return max(_rms(rate - quotient) - rounding, 0.0) / max(_rms(quotient), rounding, np.finfo(float).tiny)


def _why_refused(quantity: str, rate: Float[np.ndarray, "pulse ..."], quotient: Float[np.ndarray, "pulse ..."]) -> str:
    if not np.any(rate):
        return (
            f"{quantity} changes by {_rms(quotient):.3g} per unit (RMS), and automatic differentiation gives zero: the "
            "key acts beside the tables of antenna and materials (wavelength of the carrier, exponent of an element), "
            "or the axis points down, where angles are singular"
        )
    return (
        f"the derivative of {quantity} differs from the difference quotient by {_rms(rate - quotient):.3g} of "
        f"{_rms(quotient):.3g} per unit (RMS): it is not smooth there"
    )
