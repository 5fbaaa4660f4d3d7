"""The engines by name; each is loaded when it is built, so that none needs the libraries of another."""

from dataclasses import replace

import numpy as np

from sionna_radar.tracing.engine import Engine, EngineInputs
from sionna_radar.tracing.engines.persistent.density import DensityMap, filled_beam, footprint_density


def sionna_engine(given: EngineInputs) -> Engine:
    """Return Sionna RT's fields inside the beam, with speckle that is new in each pulse or persists on the surface."""
    table = given.tracing
    if table.speckle == "persistent":
        from sionna_radar.tracing.engines.persistent.persistent import PersistentEngine

        rays = max(1, round(table.paths_per_pulse * table.side_lobe_share))
        return PersistentEngine(
            given.scene,
            given.antenna,
            given.chirp,
            given.seed,
            table.scatterers_per_m2 or _density(given, table.paths_per_pulse - rays),
            given.region_m,
            outer_rays=rays,
            decorrelation_time_s=table.decorrelation_time_s,
            caster=given.caster,
            bounces=table.bounces,
        )
    from sionna_radar.tracing.engines.beam.beam import BeamEngine

    return BeamEngine(
        given.scene,
        given.antenna,
        given.chirp,
        given.seed,
        table.paths_per_pulse,
        table.side_lobe_share,
        given.caster,
        table.bounces,
    )


def _density(given: EngineInputs, scatterers: int) -> DensityMap:
    beams = [filled_beam(antenna) for antenna in given.beams or (given.antenna,)]
    looks = given.looks if given.beams else replace(given.looks, beam=np.zeros(len(given.looks), dtype=np.int64))
    return footprint_density(looks, beams, given.chirp.range_resolution_m, scatterers)


def gamma_engine(given: EngineInputs) -> Engine:
    """Return the paper's facet model, which is independent of Sionna."""
    from sionna_radar.tracing.engines.gamma.facets import GammaEngine

    return GammaEngine(
        given.scene,
        given.antenna,
        given.chirp,
        given.seed,
        given.caster,
        speckle=given.tracing.speckle,
        decorrelation_time_s=given.tracing.decorrelation_time_s,
    )


def stock_engine(given: EngineInputs) -> Engine:
    """Return Sionna's stock path solver, for checks."""
    from sionna_radar.tracing.engines.stock import PathSolverEngine

    return PathSolverEngine(given.scene, given.antenna, given.chirp, given.seed, samples=given.tracing.paths_per_pulse)
