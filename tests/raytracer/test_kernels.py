"""Kernels are compiled once, however many pulses are traced and wherever NumPy has put their arrays."""

from collections.abc import Callable

import numpy as np
import pytest

from sionna_radar.raytracer.backend import VECTOR_BYTES, aligned, aligned_room, load_mitsuba
from sionna_radar.scenario import load_scenario
from sionna_radar.studies.gradients import study as gradients
from sionna_radar.studies.gradients.study import sensitivities
from sionna_radar.survey.preparation import prepare

# The first blocks evaluate tables, which goes into their kernels.
FIRST, OTHERS = range(2, 5), range(5, 12)


def kernels_of(action: Callable[[], object]) -> set[str]:
    """Return the hashes of the kernels that an action calls in this thread."""
    load_mitsuba()
    import drjit as dr

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        action()
        return {kernel["hash"] for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT}


@pytest.mark.parametrize(
    ("terrain", "settings"),
    [("buildings", {}), ("buildings", {"tracing.speckle": "per_pulse"}), ("hills", {"tracing.speckle": "per_pulse"})],
)
def test_blocks_of_any_number_of_pulses_share_their_kernels(terrain, settings):
    prepared = prepare(load_scenario(terrain, {"platform.length_m": 20.0, **settings}))
    engine = prepared.sensor_inputs().tracer()

    def traced(count: int) -> set[str]:
        return kernels_of(lambda: engine.trace(prepared.flight.pulses(np.arange(count))))

    known = set().union(*map(traced, FIRST))
    assert known
    assert set().union(*map(traced, OTHERS)) <= known


def test_derivatives_share_their_kernels_wherever_their_arrays_lie(monkeypatch):
    monkeypatch.setattr(gradients, "DRAWS", 2)  # the kernels of all draws are the same
    prepared = prepare(load_scenario("hills", {"platform.length_m": 10.0, "tracing.paths_per_pulse": 64}))
    kept = []

    def derived(size: int) -> set[str]:
        # As long as the inputs, of three pulses and their rays: these come to lie elsewhere.
        kept.extend(
            np.empty(count, dtype) for count in (3, 192) for dtype in (np.float32, np.float64) for _ in range(size)
        )
        return kernels_of(lambda: sensitivities(prepared, [0, 20, 40], of=["mean_range", "profile"], to=["pose.up_m"]))

    known = set().union(*map(derived, FIRST))
    assert known
    # Dr.Jit may order a kernel's operations otherwise. Of inputs that lie anywhere there are 12 to 25 new ones.
    assert len(set().union(*map(derived, OTHERS)) - known) < len(OTHERS)


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.uint32])
def test_aligned_values_begin_at_a_multiple_of_the_vectors_width(dtype):
    kept = [aligned_room(count, dtype) for count in range(1, 20)]
    assert [len(room) for room in kept] == list(range(1, 20))
    assert all(room.ctypes.data % VECTOR_BYTES == 0 and room.dtype == dtype for room in kept)
    values = np.arange(40).reshape(10, 4)[:, 1]
    found = aligned(values, dtype)
    np.testing.assert_array_equal(found, values)
    assert found.ctypes.data % VECTOR_BYTES == 0
    assert aligned(found, dtype) is found
    # One that begins elsewhere is copied.
    assert aligned(found[1:], dtype).ctypes.data % VECTOR_BYTES == 0
