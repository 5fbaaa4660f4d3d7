"""Adapter of Sionna RT's field calculator for monostatic single-bounce paths."""

from importlib import metadata
from typing import Any

from sionna_radar.foundation.errors import BackendError
from sionna_radar.tracing.sionna.material import mi
from sionna_radar.tracing.sionna.scene import SionnaScene

# isort: split
# These load libLLVM, which the import above has selected.
import drjit as dr
import sionna.rt as rt
from sionna.rt.path_solvers.field_calculator import FieldCalculator
from sionna.rt.path_solvers.paths_buffer import PathsBuffer

# Columns filled by `diffuse_buffer`. Setting a name that a release does not use would leave its own column empty.
BUFFER_COLUMNS = (
    "_src_indices",
    "_tgt_indices",
    "_vertices_x",
    "_vertices_y",
    "_vertices_z",
    "_shapes",
    "_primitives",
    "_interaction_types",
    "_probs",
)


def diffuse_buffer(row: Any, position: Any, shape: Any, primitive: Any, probability: Any, valid: Any) -> Any:
    """Return Sionna's path buffer for one diffuse bounce back to where each path came from.

    row: pulse of each path in its block: both source and target.
    position, shape, primitive: where it bounces, on which shape (its pointer as an integer), on which triangle.
    probability: 4 pi over the solid angle that the path represents, with one sample per source.
    valid: which paths exist.

    Raises BackendError if this release of Sionna RT stores its paths differently.
    """
    count = dr.width(row)
    size = (count, 1)
    buffer = PathsBuffer(count, 1, False)
    missing = [name for name in BUFFER_COLUMNS if not hasattr(buffer, name)]
    if missing:
        raise BackendError(
            f"sionna-rt {metadata.version('sionna-rt')} stores its paths differently from the tested releases: "
            f"its buffer has no {', '.join(missing)}; install sionna-rt~=2.2.0"
        )
    buffer.valid = valid
    # Sionna fills these columns path by path; here all of them are known at once.
    buffer._src_indices = buffer._tgt_indices = row
    buffer._vertices_x = mi.TensorXf(position.x, size)
    buffer._vertices_y = mi.TensorXf(position.y, size)
    buffer._vertices_z = mi.TensorXf(position.z, size)
    buffer._shapes = mi.TensorXu(shape, size)
    buffer._primitives = mi.TensorXu(primitive, size)
    buffer._interaction_types = mi.TensorXu(dr.full(mi.UInt32, rt.InteractionType.DIFFUSE, count), size)
    buffer._probs = mi.TensorXf(probability, size)
    return buffer


def calculate_fields(
    sionna: SionnaScene, buffer: Any, origin: Any, angles: Any, *, differentiable: bool = False
) -> Any:
    """Return the buffer with channel gains and delays, from Sionna's field calculator; `differentiable` is slower."""
    # Evaluated now: the calculator gathers from each array, and would otherwise recompute all of them for each.
    dr.eval(
        buffer.valid,
        buffer.source_indices,
        buffer.probs,
        buffer.shapes,
        buffer.primitives,
        buffer.vertices_x,
        buffer.vertices_y,
        buffer.vertices_z,
    )
    calculator = FieldCalculator()
    calculator.loop_mode = "evaluated" if differentiable else "symbolic"
    return calculator(
        wavelength=sionna.wavelength,
        paths=buffer,
        samples_per_src=1,
        diffraction=False,
        src_positions=origin,
        tgt_positions=origin,
        src_orientations=angles,
        tgt_orientations=angles,
        src_antenna_patterns=sionna.pattern.patterns,
        tgt_antenna_patterns=sionna.receive_pattern.patterns,
    )
