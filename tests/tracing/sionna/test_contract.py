"""What is relied on of Sionna RT by private names: each is named here, and a release without it is refused."""

import pytest

from beams import make_chirp
from sionna_radar.foundation.errors import BackendError
from sionna_radar.tracing.sionna import contract as sionna_contract
from sionna_radar.tracing.sionna import fields as sionna_fields
from sionna_radar.tracing.sionna.contract import check_sionna
from sionna_radar.tracing.sionna.material import mi


def one_path():
    column = [mi.UInt32([0]), mi.Point3f(0.0, 0.0, [0.0]), mi.UInt32([0]), mi.UInt32([0])]
    return sionna_fields.diffuse_buffer(*column, mi.Float([1.0]), mi.Bool([True]))


def test_this_release_computes_the_known_path():
    check_sionna.cache_clear()
    check_sionna()
    assert check_sionna.cache_info().currsize == 1  # nothing was raised


NAMES = (
    "_src_indices", "_tgt_indices", "_vertices_x", "_vertices_y", "_vertices_z", "_shapes", "_primitives",
    "_interaction_types", "_probs",
)  # fmt: skip


def test_every_name_that_is_filled_is_checked():
    assert set(sionna_fields.BUFFER_COLUMNS) == set(NAMES)
    assert all(hasattr(one_path(), name) for name in NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_a_release_that_renames_a_column_is_refused(name, monkeypatch):
    class Renamed(sionna_fields.PathsBuffer):
        def __init__(self, *given):
            super().__init__(*given)
            setattr(self, name + "_", getattr(self, name))
            delattr(self, name)

    monkeypatch.setattr(sionna_fields, "PathsBuffer", Renamed)
    with pytest.raises(BackendError, match=rf"its buffer has no {name}; install sionna-rt"):
        one_path()
    check_sionna.cache_clear()
    with pytest.raises(BackendError, match=name):
        check_sionna()


def test_a_release_that_computes_another_gain_is_refused(monkeypatch):
    def half(sionna, buffer, origin, angles):
        found = sionna_fields.calculate_fields(sionna, buffer, origin, angles)
        found.a[0][0] *= 0.5
        return found

    monkeypatch.setattr(sionna_contract, "calculate_fields", half)
    check_sionna.cache_clear()
    with pytest.raises(BackendError, match="gives a test path the power"):
        check_sionna()


def test_the_engines_check_before_they_trace(monkeypatch, plane, pencil):
    from sionna_radar.tracing.engines.beam.beam import BeamEngine
    from sionna_radar.tracing.engines.persistent.persistent import PersistentEngine

    def refuse():
        message = "another release"
        raise BackendError(message)

    for module in ("beam.beam", "persistent.persistent"):
        monkeypatch.setattr(f"sionna_radar.tracing.engines.{module}.check_sionna", refuse)
    with pytest.raises(BackendError, match="another release"):
        BeamEngine(plane, pencil, make_chirp(), 1, 16, 0.05)
    with pytest.raises(BackendError, match="another release"):
        PersistentEngine(plane, pencil, make_chirp(), 1, 0.1)
