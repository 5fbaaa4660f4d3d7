"""Engines, and the focusing of images, against the least work that each of them is."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from sionna_radar.foundation.threads import over_rows
from sionna_radar.imaging.aperture import whole_beam
from sionna_radar.imaging.grid import ground_pixels
from sionna_radar.imaging.sar import ZERO_PADDING, BackProjection
from sionna_radar.scenario import load_scenario
from sionna_radar.studies.ratio import Ratio
from sionna_radar.studies.side_by_side import Action, bare_casting, side_by_side
from sionna_radar.survey.preparation import Prepared, prepare

ENGINE_RATIOS = 3
FLOOR_BOUND = 2.0
REPEATS = 7
# Pixels beside the track, m, and steps between them.
ALONG_M, ACROSS_M, STEP_M = (-3.0, 3.0), (24.0, 32.0), 0.04


def measure_engines(pulses: int) -> Iterator[Ratio]:
    """Yield what tracing and focusing take over their floors, ENGINE_RATIOS of them."""
    wide, facets = (
        prepare(load_scenario("hills", settings))
        for settings in ({"radar.antenna.beamwidth_deg": 8.0}, {"tracing.engine": "gamma"})
    )
    yield _ratio("persistent scatterers, 8 deg / bare rays to them", *_tracing(wide, pulses))
    yield _ratio("gamma engine / its facets touched once, in NumPy", *_facets(facets, pulses // 4))
    yield _ratio("SAR focusing / its samples summed, nearest ones", *_focusing(pulses))


def _ratio(name: str, action: Action, floor: Action) -> Ratio:
    times = side_by_side([action, floor], REPEATS).min(axis=0)
    return Ratio(name=name, value=float(times[0] / times[1]), bound=FLOOR_BOUND, at_most=True)


def _tracing(prepared: Prepared, count: int) -> tuple[Action, Action]:
    tracer, pulses = prepared.sensor_inputs().tracer(), prepared.flight.pulses(np.arange(min(count, len(prepared))))
    return partial(tracer.trace, pulses), bare_casting(prepared, tracer.trace(pulses), pulses)


def _facets(prepared: Prepared, count: int) -> tuple[Action, Action]:
    """Return the tracing of facets, and their distances, gains, phases and ray tests by whole arrays."""
    tracer, pulses = prepared.sensor_inputs().tracer(), prepared.flight.pulses(np.arange(min(count, len(prepared))))
    paths = tracer.trace(pulses)
    row = paths.pulse - pulses.index[0]
    chirp, antenna, caster = prepared.receiver.chirp, prepared.antenna, prepared.scene.caster

    def touch() -> None:
        origin, point = pulses.true.position_m[row], paths.hit_m.astype(np.float64)
        away = point - origin
        range_m = np.linalg.norm(away, axis=1)
        ahead = np.einsum("ni,nij->nj", away / range_m[:, None], pulses.true.R_world_antenna[row])
        amplitude = antenna.gain(ahead) * np.sqrt(np.cos(paths.incidence_rad)) / range_m**2
        amplitude * np.exp(4j * np.pi * np.mod(range_m / chirp.wavelength_m, 1.0))
        caster.visible(origin, point)

    return partial(tracer.trace, pulses), touch


def _focusing(count: int) -> tuple[Action, Action]:
    """Return the focusing of pixels, and the sum of the nearest samples of the same spectra."""
    # Numba takes half a second to import.
    from sionna_radar.studies.floor_kernels import nearest_samples

    prepared = prepare(load_scenario("slar"))
    chirp, aperture = prepared.receiver.chirp, whole_beam(prepared.antenna)
    middle = (len(prepared) - min(count, len(prepared))) // 2
    pulses = prepared.flight.pulses(np.arange(middle, len(prepared) - middle))
    pose = pulses.measured
    along_m, across_m = (np.arange(low, high, STEP_M) for low, high in (ALONG_M, ACROSS_M))
    pixels = ground_pixels(pose, "right", 0.0, along_m + _length_m(pose.position_m) / 2, across_m)
    beats = prepared.receiver.beat(prepared.sensor_inputs().tracer().trace(pulses), pulses)
    projection = BackProjection(chirp, pixels, aperture)
    spectra = projection.spectra(beats)
    place, image = pixels.position_m.reshape(-1, 3), np.empty(pixels.position_m.size // 3, dtype=np.complex128)
    scales = (ZERO_PADDING / chirp.range_resolution_m, 2 / chirp.wavelength_m)

    def add() -> None:
        over_rows(
            lambda low, high: nearest_samples(
                low, high, place, pose.position_m, spectra, *scales, aperture.reach, pixels.along, image
            ),
            len(place),
        )

    return partial(projection.add, beats, pose), add


def _length_m(position_m: np.ndarray) -> float:
    return float(np.linalg.norm(position_m[-1] - position_m[0]))
