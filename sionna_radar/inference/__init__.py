"""Inference: one likelihood of echoes over a surface, one prior of how ground varies."""
