"""Sensors: from pulses to echoes."""
