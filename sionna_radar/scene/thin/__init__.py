"""Thin obstacles from tables and files; what they are made of is in `scene.wires`."""
