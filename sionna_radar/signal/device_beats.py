"""Beat signals on the device: sums over paths in the ray tracer's memory.

The phase of a path is that of `signal.beat`, drift included. Each sample of a pulse adds its paths in their order,
without atomic operations: the result does not depend on the number of parallel samples. Phases are reduced to
a cycle in double precision, and their sine and cosine computed in single precision.
"""

from typing import Any

import numpy as np
from scipy.constants import speed_of_light

from sionna_radar.radar.chirp import Chirp
from sionna_radar.raytracer.backend import flushed_denormals
from sionna_radar.signal.beat import sampled_band_hz
from sionna_radar.tracing.paths import DevicePaths
from sionna_radar.tracing.sionna.material import mi

# isort: split
# Loads libLLVM, which the import above has selected.
import drjit as dr


@flushed_denormals()
def device_beats(paths: DevicePaths, chirp: Chirp) -> Any:
    """Return the noise-free beat signals of a block as a Dr.Jit tensor, one row per pulse; see `synthesise`.

    I/Q samples have a last axis of real and imaginary parts.
    """
    rows, samples = len(paths.pulses), chirp.samples
    total = _sums(paths, chirp) if dr.width(paths.delay_s) else dr.zeros(mi.Complex2f, rows * samples)
    if chirp.sampling == "real":
        return mi.TensorXf(np.sqrt(2) * total.real, (rows, samples))
    return mi.TensorXf(dr.ravel(total), (rows, samples, 2))


def _sums(paths: DevicePaths, chirp: Chirp) -> Any:
    """Return the sum over the paths of each pulse at each sample, pulse by pulse."""
    frequency, drift, weight = _terms(paths, chirp)
    samples = chirp.samples
    lane = dr.arange(mi.UInt32, len(paths.pulses) * samples)
    pulse = lane // samples
    n = mi.Float64(mi.Int32(lane - pulse * samples) - samples // 2)
    real, imaginary = dr.zeros(mi.Float64, dr.width(lane)), dr.zeros(mi.Float64, dr.width(lane))

    def has_more(path: Any, last: Any, real: Any, imaginary: Any) -> Any:
        return path < last

    def add_path(path: Any, last: Any, real: Any, imaginary: Any) -> tuple[Any, ...]:
        """Add one path to a sample."""
        turns = dr.gather(mi.Float64, frequency, path) * n + dr.gather(mi.Float64, drift, path) * n * n
        sine, cosine = dr.sincos(mi.Float(turns - dr.floor(turns)) * dr.two_pi)
        path_weight = dr.gather(mi.Complex2f, weight, path)
        real += mi.Float64(path_weight.real * cosine - path_weight.imag * sine)
        imaginary += mi.Float64(path_weight.real * sine + path_weight.imag * cosine)
        return path + 1, last, real, imaginary

    for first, last in paths.spans:
        start, end = (dr.gather(mi.UInt32, mi.UInt32(bounds.astype(np.uint32)), pulse) for bounds in (first, last))
        _, _, real, imaginary = dr.while_loop(state=(start, end, real, imaginary), cond=has_more, body=add_path)
    total = mi.Complex2f(mi.Float(real), mi.Float(imaginary))
    dr.eval(total)
    return total


def _terms(paths: DevicePaths, chirp: Chirp) -> tuple[Any, Any, Any]:
    """Return each path's cycles per sample, cycles per sample squared, and weight."""
    slope, sign, double = chirp.slope_hz_s, float(chirp.direction), mi.Float64
    stretch = double(paths.range_rate_mps) * (2 / speed_of_light)
    delay = paths.delay_s - chirp.gate_s + chirp.centre_s * stretch
    frequency = sign * (chirp.carrier_hz * stretch + slope * delay - slope * delay * stretch)
    drift = sign * (slope * stretch - slope * stretch * stretch / 2)
    turns = sign * (chirp.carrier_hz * delay - slope * delay * delay / 2)
    sine, cosine = dr.sincos(mi.Float(turns - dr.floor(turns)) * dr.two_pi)
    least_hz, most_hz = sampled_band_hz(chirp)
    passes = dr.select((frequency >= least_hz) & (frequency < most_hz), mi.Float(1.0), mi.Float(0.0))
    # An up-sweep's beat has the conjugate of a path's gain.
    real, imaginary = passes * paths.gain.real, -sign * passes * paths.gain.imag
    weight = mi.Complex2f(real * cosine - imaginary * sine, real * sine + imaginary * cosine)
    frequency, drift = frequency / chirp.sampling_rate_hz, drift / chirp.sampling_rate_hz**2
    # Evaluated now: the sums gather from each.
    dr.eval(frequency, drift, weight)
    return frequency, drift, weight
