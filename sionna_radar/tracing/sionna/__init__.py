"""Sionna RT's side of a scene, and the contract that a release of it must keep."""
