"""Readers of foreign formats, by what they return; none is loaded before a file needs it.

The package `readers` is above all that simulates: who deletes it loses these files alone.
"""

from sionna_radar.scenario.registry import Deferred

# A path, the key that names it, columns and CRS of a CSV file -> `flight.FlightLog`.
FLIGHT_LOG = Deferred("readers.logs.reader.read_log")
# A path, the key that names it, and the boresight -> a pattern; a path -> the frequencies that a pattern file states.
ANTENNA_PATTERN = Deferred("readers.antennas.reader.read_pattern")
ANTENNA_FREQUENCY = Deferred("readers.antennas.frequency.file_frequency_hz")
# A TOML file -> a context manager of `survey.recordings.described` signals or ranges.
DESCRIBED_RECORDING = Deferred("readers.recordings.description.open_described")
# A raw capture -> its frames; and a raw capture that grows.
CAPTURED_FRAMES = Deferred("readers.captures.capture_file.open_capture")
CAPTURE_WRITER = Deferred("readers.captures.capture_file.CaptureWriter")
