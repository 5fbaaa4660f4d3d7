"""`python -m sionna_radar` is `sionna-radar`."""

from sionna_radar.cli import main

main()
