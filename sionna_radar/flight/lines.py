"""Several lines over one area, to and fro, and the ways between them."""

import numpy as np

from sionna_radar.flight.turns import CurvedTrack, Segment, shortest_way
from sionna_radar.scenario.platform import LinesTable

Place = tuple[float, float, float]


def lines_track(table: LinesTable, heading_rad: float, radius_m: float | None, lead_m: float = 0.0) -> CurvedTrack:
    """Return the track over all lines.

    Parameters
    ----------
    table:
        The lines.
    heading_rad:
        Of the first one.
    radius_m:
        Of the turns between them, outside of the lines; None for straight ways with instantaneous turns.
    lead_m:
        Straight flight before and after each line, in which the aircraft rolls level.

    """
    lines = _lines(table, heading_rad)
    if table.crossing:
        # A quarter to the right of the last line, or to the left: whichever set begins nearer.
        last = lines[-1][1]
        turns = (np.pi / 2, -np.pi / 2)
        sets = [_lines(table, heading_rad + turn, mirrored=mirrored) for turn in turns for mirrored in (False, True)]
        ways_m = [np.hypot(first[0][0] - last[0], first[0][1] - last[1]) for first, *_ in sets]
        lines += sets[int(np.argmin(ways_m))]
    segments: list[Segment] = []
    for start, end in lines:
        length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
        if segments:
            segments += _between(segments[-1].end, start, radius_m, lead_m)
        segments.append(Segment(start_m=start[:2], heading_rad=start[2], length_m=length))
    return CurvedTrack(segments=tuple(segments))


def _lines(table: LinesTable, heading_rad: float, *, mirrored: bool = False) -> list[tuple[Place, Place]]:
    """Return the ends of parallel lines, with their headings."""
    centre = np.array(table.centre_m or (0.0, 0.0))
    forward = np.array([np.sin(heading_rad), np.cos(heading_rad)])
    right = np.array([forward[1], -forward[0]]) * (-1 if mirrored else 1)
    found = []
    for number in range(table.count):
        sign = 1 - 2 * (number % 2)
        middle = centre + (number - (table.count - 1) / 2) * table.spacing_m * right
        heading = heading_rad if sign > 0 else heading_rad + np.pi
        ends = [middle + along * sign * table.length_m / 2 * forward for along in (-1, 1)]
        places = [(float(end[0]), float(end[1]), float(heading)) for end in ends]
        found.append((places[0], places[1]))
    return found


def _between(start: Place, end: Place, radius_m: float | None, lead_m: float) -> list[Segment]:
    """Return the way from the end of a line to the start of the next."""
    if radius_m is None:
        east, north = end[0] - start[0], end[1] - start[1]
        length = float(np.hypot(east, north))
        if length == 0:
            return []
        heading = float(np.arctan2(east, north))
        return [Segment(start_m=start[:2], heading_rad=heading, length_m=length, on_line=False)]
    out = [Segment(start_m=start[:2], heading_rad=start[2], length_m=lead_m, on_line=False)] if lead_m else []
    left = out[-1].end if out else start
    back = (end[0] - lead_m * np.sin(end[2]), end[1] - lead_m * np.cos(end[2]), end[2])
    way = [*out, *shortest_way(left, (float(back[0]), float(back[1]), back[2]), radius_m)]
    if lead_m:
        way.append(Segment(start_m=back[:2], heading_rad=end[2], length_m=lead_m, on_line=False))
    return way
