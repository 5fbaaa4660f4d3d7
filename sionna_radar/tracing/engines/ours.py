"""The engines by name; each is loaded when it is built, so that none needs the libraries of another."""

from sionna_radar.tracing.engine import Engine, EngineInputs, register_engine


@register_engine("sionna")
def sionna_engine(given: EngineInputs) -> Engine:
    """Return Sionna RT's fields inside the beam, with speckle that is new in each pulse or persists on the surface."""
    table = given.tracing
    if table.speckle == "persistent":
        from sionna_radar.tracing.engines.persistent import PersistentEngine

        return PersistentEngine(
            given.scene, given.antenna, given.chirp, given.seed, table.scatterers_per_m2, given.region_m
        )
    from sionna_radar.tracing.engines.beam import BeamEngine

    return BeamEngine(given.scene, given.antenna, given.chirp, given.seed, table.paths_per_pulse, table.side_lobe_share)


@register_engine("gamma")
def gamma_engine(given: EngineInputs) -> Engine:
    """Return the paper's facet model, which is independent of Sionna."""
    from sionna_radar.tracing.engines.facets import GammaEngine

    return GammaEngine(given.scene, given.antenna, given.chirp, given.seed, given.caster, speckle=given.tracing.speckle)


@register_engine("path_solver")
def stock_engine(given: EngineInputs) -> Engine:
    """Return Sionna's stock path solver, for checks."""
    from sionna_radar.tracing.engines.stock import PathSolverEngine

    return PathSolverEngine(given.scene, given.antenna, given.chirp, given.seed, samples=given.tracing.paths_per_pulse)
