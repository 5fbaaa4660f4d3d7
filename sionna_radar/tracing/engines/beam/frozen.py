"""Differentiable echoes: profiles as functions of radar, antenna and materials over fixed ray hits.

The echo of a pulse is an integral over the illuminated surface. Rays find its places once; then fields are evaluated
again by Sionna's field calculator for a radar that moves, turns, or has another pattern, over other materials.

* Mean power: rays keep their directions in the antenna, and so their solid angles, and their ends slide along the
  planes of their facets. What is left out are the borders: surface that comes into view or is hidden (shadows,
  silhouettes of walls), and the jump of the incidence from facet to facet, which constant gamma does not see.
* Fixed speckle: scatterers stay where they are on the surface, with the piece dA of it that each stands for, so that
  their solid angles dA cos(t) / r^2, gains and phases change. What is left out is visibility. As an estimate of mean
  powers that would be noisy: the beam moves over few places.

Derivatives are those of Dr.Jit, forward along each direction in the space of inputs: positions, orientations and
velocities of the pulses, a bias of ranges, and the tables of the pattern and of the materials. Sionna's loops carry
them in "evaluated" mode only.

Quantities, all without noise and without the loss of the air:

    echo_power   sum of |a|^2 over the places of a pulse, received over transmitted power
    mean_range   their mean range, weighted by |a|^2, m
    profile      mean power in each range cell, sum of |a|^2 w(cell - r)^2, with w the response of the window and r with
                 the shift by Doppler; with fixed speckle |sum of a exp(j phase - 2 j k (r - r0)) w(cell - r)|^2
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.foundation.randomness import Stream, pulse_uniforms
from sionna_radar.radar.chirp import Chirp
from sionna_radar.raytracer.backend import aligned
from sionna_radar.tracing.engines.beam.beam import BeamEngine, RayHits, point_of, vector_of
from sionna_radar.tracing.sionna.fields import calculate_fields, diffuse_buffer
from sionna_radar.tracing.sionna.material import mi
from sionna_radar.tracing.sionna.pattern import sionna_angles
from sionna_radar.tracing.sionna.scene import SionnaScene

# isort: split
# Loads libLLVM, which an import above has selected.
import drjit as dr
from sionna.rt.utils import rotation_matrix

_DOUBLE = dr.float64_array_t(mi.Point3f)
# Samples of the window's response in a range cell.
STEPS_PER_CELL = 256


@dataclass(frozen=True, kw_only=True)
class RangeCells:
    """The range axis of profiles.

    response: amplitude of a point target against the distance in range cells, `STEPS_PER_CELL` samples each, symmetric.
    """

    chirp: Chirp
    count: int
    response: Float[np.ndarray, " step"]

    @property
    def half(self) -> int:
        """Range cells on each side of a target that its response reaches."""
        return len(self.response) // (2 * STEPS_PER_CELL)


@dataclass(frozen=True, kw_only=True)
class Direction:
    """A direction in the space of inputs, per unit of a parameter: rates of change of poses and tables."""

    position_m: Float[np.ndarray, "pulse 3"]
    angles_rad: Float[np.ndarray, "pulse 3"]
    velocity_mps: Float[np.ndarray, "pulse 3"]
    tables: Sequence[Float[np.ndarray, " n"]]
    range_bias_m: float = 0.0


class FrozenEchoes:
    """The echoes of some pulses on the places that their rays met."""

    def __init__(self, engine: BeamEngine, pulses: Pulses, cells: RangeCells, *, fixed_speckle: bool) -> None:
        self._cells, self._count = cells, len(pulses)
        hits, sionna = engine.cast(pulses), engine.sionna
        self._hits, self._place = hits, _DOUBLE(hits.place)
        away = self._place - dr.gather(_DOUBLE, _double(pulses.true.position_m), hits.row)
        self._range_m = dr.norm(away)
        turned = dr.gather(mi.Matrix3f, rotation_matrix(point_of(sionna_angles(pulses.true.R_world_antenna))), hits.row)
        self._direction = turned.T @ mi.Vector3f(away / self._range_m)
        self._cosine = dr.abs(dr.dot(hits.normal, mi.Vector3f(away))) / mi.Float(self._range_m)
        self._surface = mi.UInt32(aligned(np.maximum(sionna.surface_of_shape[hits.shape.numpy()], 0), np.uint32))
        self._turns = None
        if fixed_speckle:
            drawn = pulse_uniforms(engine.seed, Stream.SPECKLE, pulses.index, dr.width(hits.row) // len(pulses))
            self._turns = mi.Float(aligned(drawn.ravel()))
        self._table = mi.Float(cells.response.astype(np.float32))
        dr.eval(self._range_m, self._cosine, self._direction, self._surface, self._table)

    def evaluate(
        self, sionna: SionnaScene, pose: Pose, of: Sequence[str], range_bias_m: float = 0.0
    ) -> dict[str, Float[np.ndarray, "pulse ..."]]:
        """Return quantities for a radar at other poses, with the antenna and the materials of a scene."""
        return self._read(self._outputs(sionna, *_inputs(pose), mi.Float64(range_bias_m), of), of)

    def derivatives(
        self, sionna: SionnaScene, pose: Pose, directions: Sequence[Direction], of: Sequence[str]
    ) -> list[dict[str, Float[np.ndarray, "pulse ..."]]]:
        """Return the derivatives of quantities along directions in the space of inputs."""
        poses, tables = _inputs(pose), sionna.tables
        bias = mi.Float64(0.0)
        inputs = [*poses, bias, *tables]
        dr.enable_grad(inputs)
        try:
            outputs = self._outputs(sionna, *poses, bias, of)
            wanted = list(outputs.values())
            derivatives_of = []
            for direction in directions:
                dr.clear_grad(inputs)
                # Every gradient is written, a zero as well: the last direction's would stay.
                rates = (
                    _double(direction.position_m),
                    point_of(direction.angles_rad),
                    vector_of(direction.velocity_mps),
                )
                for value, rate in zip(poses, rates, strict=True):
                    dr.set_grad(value, rate)
                dr.set_grad(bias, mi.Float64(direction.range_bias_m))
                for table, rate in zip(tables, direction.tables, strict=True):
                    dr.set_grad(table, mi.Float(aligned(rate)))
                dr.forward_to(*wanted, flags=dr.ADFlag.ClearInterior | dr.ADFlag.AllowNoGrad)
                rate_of = {name: dr.grad(value).numpy().astype(np.float64) for name, value in outputs.items()}
                derivatives_of.append(self._rates({n: dr.detach(v) for n, v in outputs.items()}, rate_of, of))
                dr.clear_grad(wanted)
        finally:
            dr.disable_grad(inputs)
        return derivatives_of

    def _outputs(
        self, sionna: SionnaScene, origin: Any, angles: Any, velocity: Any, bias: Any, of: Sequence[str]
    ) -> dict[str, Any]:
        """Return sums over the places of each pulse, on the device."""
        hits: RayHits = self._hits
        shape = dr.gather(mi.UInt32, mi.UInt32(sionna.shape_of_surface.astype(np.uint32)), self._surface)
        place, fixed = self._place, self._turns is not None
        start = dr.gather(_DOUBLE, origin, hits.row)
        if not fixed:
            ahead = _DOUBLE(dr.gather(mi.Matrix3f, rotation_matrix(angles), hits.row) @ self._direction)
            normal = _DOUBLE(hits.normal)
            slid = start + ahead * (dr.dot(normal, place - start) / dr.dot(normal, ahead))
            place = dr.select(hits.valid, slid, place)
        buffer = diffuse_buffer(hits.row, mi.Point3f(place), shape, hits.face, hits.probability, hits.valid)
        gain = calculate_fields(sionna, buffer, mi.Point3f(origin), angles, differentiable=True).a[0][0]
        # Twice the precision: phases turn by a half over a quarter of the wavelength.
        away = place - start
        range_m = dr.norm(away)
        away /= range_m
        wider: Any = 1.0
        if fixed:
            cosine = dr.abs(dr.dot(hits.normal, mi.Vector3f(away)))
            wider = (cosine / self._cosine) * mi.Float(dr.square(self._range_m / range_m))
        power = dr.select(hits.valid, dr.squared_norm(gain) * wider, 0.0)
        sums = {"power": self._sum(power, hits.row, self._count)}
        if "mean_range" in of:
            sums["moment"] = self._sum(power * mi.Float(range_m + bias), hits.row, self._count)
        if "profile" in of:
            rate_mps = -dr.dot(dr.gather(mi.Vector3f, velocity, hits.row), mi.Vector3f(away))
            sums |= self._profile(gain, wider, range_m, bias, rate_mps)
        return sums

    def _profile(self, gain: Any, wider: Any, range_m: Any, bias: Any, rate_mps: Any) -> dict[str, Any]:
        """Return the power of each range cell of each pulse, or with fixed speckle the two parts of its field."""
        cells, hits = self._cells, self._hits
        shift_m = cells.chirp.doppler_range_s * rate_mps
        place = (range_m + bias + shift_m) / cells.chirp.range_resolution_m - cells.chirp.first_cell
        nearest = mi.Int32(dr.round(dr.detach(place)))
        if self._turns is None:
            parts = {"profile": dr.squared_norm(gain) * wider}
        else:
            moved_m = mi.Float(self._range_m - range_m)
            turn = 2 * dr.pi * self._turns + moved_m * (4 * np.pi / cells.chirp.wavelength_m)
            field = gain * (dr.exp(mi.Complex2f(0, turn)) * dr.sqrt(wider))
            parts = {"real": field.real, "imaginary": field.imag}
        sums = {name: dr.zeros(mi.Float, self._count * cells.count) for name in parts}
        for offset in range(-cells.half + 1, cells.half):
            cell = nearest + offset
            weight = self._response(mi.Float(cell - place))
            inside = hits.valid & (cell >= 0) & (cell < cells.count)
            index = hits.row * cells.count + mi.UInt32(dr.clip(cell, 0, cells.count - 1))
            for name, value in parts.items():
                seen = value * (dr.square(weight) if self._turns is None else weight)
                dr.scatter_reduce(dr.ReduceOp.Add, sums[name], seen, index, inside)
        return sums

    def _response(self, distance: Any) -> Any:
        """Return the amplitude of a target at a distance in range cells."""
        position = (distance + self._cells.half) * STEPS_PER_CELL
        below = mi.UInt32(dr.clip(dr.detach(position), 0, dr.width(self._table) - 2))
        low, high = dr.gather(mi.Float, self._table, below), dr.gather(mi.Float, self._table, below + 1)
        return dr.lerp(low, high, position - mi.Float(below))

    def _sum(self, value: Any, row: Any, count: int) -> Any:
        total = dr.zeros(mi.Float, count)
        dr.scatter_reduce(dr.ReduceOp.Add, total, value, row)
        return total

    def _read(self, sums: dict[str, Any], of: Sequence[str]) -> dict[str, Float[np.ndarray, "pulse ..."]]:
        """Return the quantities of sums."""
        value = {name: array.numpy().astype(np.float64) for name, array in sums.items()}
        read = {"echo_power": value["power"]}
        if "moment" in value:
            read["mean_range"] = value["moment"] / value["power"]
        if "profile" in of:
            profile = value["profile"] if self._turns is None else value["real"] ** 2 + value["imaginary"] ** 2
            read["profile"] = profile.reshape(self._count, self._cells.count)
        return {name: read[name] for name in of}

    def _rates(
        self, sums: dict[str, Any], rates: dict[str, Float[np.ndarray, " n"]], of: Sequence[str]
    ) -> dict[str, Float[np.ndarray, "pulse ..."]]:
        """Return the derivatives of the quantities from those of the sums."""
        value = {name: array.numpy().astype(np.float64) for name, array in sums.items()}
        read = {"echo_power": rates["power"]}
        if "moment" in value:
            mean = value["moment"] / value["power"]
            read["mean_range"] = (rates["moment"] - mean * rates["power"]) / value["power"]
        if "profile" in of:
            fixed = [2 * value[part] * rates[part] for part in ("real", "imaginary") if part in value]
            profile = sum(fixed) if fixed else rates["profile"]
            read["profile"] = np.asarray(profile).reshape(self._count, self._cells.count)
        return {name: read[name] for name in of}


def _inputs(pose: Pose) -> tuple[Any, Any, Any]:
    angles = point_of(sionna_angles(pose.R_world_antenna))
    return _double(pose.position_m), angles, vector_of(pose.velocity_mps)


def _double(array: Float[np.ndarray, "n 3"]) -> Any:
    return _DOUBLE(*(aligned(axis, np.float64) for axis in array.T))
