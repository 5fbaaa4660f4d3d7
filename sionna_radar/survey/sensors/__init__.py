"""Sensors that turn pulses into echoes: radar, MIMO array, lidar."""
