"""From a scene and pulses to propagation paths."""
