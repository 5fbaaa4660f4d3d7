"""The scenario file of a plan."""

from sionna_radar.report.signed_file import SignedFile

PLAN_FILE = SignedFile(command="plan", before="# ")
