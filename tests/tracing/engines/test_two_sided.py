"""A sheet that encloses nothing echoes from either side, whatever its winding."""

from dataclasses import replace

import numpy as np
import pytest

from beams import make_antenna, make_chirp
from flights import make_pulses
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.engines.beam.beam import BeamEngine
from sionna_radar.tracing.engines.gamma.facets import GammaEngine
from worlds import make_scene, make_surface

SHEET = make_surface(lambda x, y: 0 * x, size_m=120.0, spacing_m=4.0)
TURNED = replace(SHEET, faces=SHEET.faces[:, ::-1], two_sided=True)


def gamma(scene):
    return GammaEngine(scene, make_antenna(2.0, 2.0), make_chirp(), 1, RayCaster(scene.surfaces))


def beam(scene):
    return BeamEngine(scene, make_antenna(2.0, 2.0), make_chirp(), 1, 512, 0.05)


def power(paths):
    return float(np.sum(np.abs(paths.gain.astype(complex)) ** 2))


@pytest.mark.parametrize("engine", [gamma, beam])
def test_a_sheet_turned_over_echoes_as_strongly(engine):
    pulses = make_pulses(50, incidence_deg=30.0)
    right, turned = (engine(make_scene(sheet)).trace(pulses) for sheet in (SHEET, TURNED))
    assert len(turned) > 0
    # Not exactly: facets are divided from another corner.
    assert power(turned) == pytest.approx(power(right), rel=0.02)
    np.testing.assert_allclose(turned.incidence_rad.mean(), right.incidence_rad.mean(), atol=1e-3)


def test_a_solid_turned_inside_out_is_not_seen_by_facets_and_so_is_repaired_when_read():
    assert len(gamma(make_scene(replace(TURNED, two_sided=False))).trace(make_pulses(5))) == 0
