"""The persistent engine: scatterers fixed to the surface."""
