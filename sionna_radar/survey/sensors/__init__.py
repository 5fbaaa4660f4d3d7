"""The sensors that a survey can carry: from pulses to echoes."""
