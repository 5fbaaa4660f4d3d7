"""Antennas from files of their patterns."""

from sionna_radar.foundation.decibel import from_db
from sionna_radar.radar.antenna import Antenna, antenna_of, register_antenna
from sionna_radar.radar.pattern_files.reader import read_pattern
from sionna_radar.scenario.radar import PatternAntennaTable


@register_antenna("pattern", PatternAntennaTable)
def measured_antenna(table: PatternAntennaTable) -> Antenna:
    """Return the antenna of a scenario's table.

    Raises InputFileError for a file that cannot be read.
    """
    sent = read_pattern(table.pattern, "radar.antenna.pattern", table.boresight)
    heard = None
    if table.receive_pattern is not None:
        heard = read_pattern(table.receive_pattern, "radar.antenna.receive_pattern", table.boresight)
    return antenna_of(
        sent,
        heard,
        polarization=table.polarization,
        receives=table.receive_polarization,
        axial_ratio_db=table.axial_ratio_db,
        efficiency=from_db(table.efficiency_db),
    )
