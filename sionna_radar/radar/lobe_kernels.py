"""The main lobe of a separable antenna around many directions, as machine code."""

from typing import no_type_check

from sionna_radar.foundation.compiled import compiled


@compiled
@no_type_check
def voltage_at(voltage, cosine):
    """Return a `Cut` at a direction cosine."""
    position = (min(max(cosine, -1.0), 1.0) + 1.0) * ((len(voltage) - 1) / 2)
    below = min(int(position), len(voltage) - 2)
    share = position - below
    return voltage[below] * (1 - share) + voltage[below + 1] * share


@compiled
@no_type_check
def within(direction, azimuth, elevation, level, inside):
    """Mark the unit vectors at which the two-way power, relative to the peak, is at least a level."""
    for n in range(len(direction)):
        voltage = voltage_at(azimuth, direction[n, 1]) * voltage_at(elevation, direction[n, 2])
        gain = voltage * voltage * max(direction[n, 0], 0.0)
        inside[n] = gain * gain >= level
