"""Flight logs of autopilots and receivers."""
