"""Logs in the coordinates of a map: positions in any CRS become longitude and latitude.

Their headings and velocities count from grid north of that CRS, and from true north afterwards.
"""

from dataclasses import dataclass, replace

import numpy as np
from pyproj import CRS
from pyproj.exceptions import ProjError

from sionna_radar.elevation.local_frame import MapFrame, horizontal_crs_of, stated_crs
from sionna_radar.elevation.placed_raster import reproject
from sionna_radar.flight.log import FlightLog, convergence_rad, grid_from_ground
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.input_file import shown

KEY = "platform.log_crs"


@dataclass(frozen=True)
class MapCoordinates:
    """The CRS of a log's positions, easting or longitude first, and the metres of one unit of its heights."""

    crs: CRS
    unit_m: float = 1.0

    def on_the_globe(self, log: FlightLog) -> FlightLog:
        """Return a log in longitude, latitude (WGS 84) and metres; ScenarioError for positions outside the CRS."""
        x, y, height = log.positions.place.T
        try:
            lon, lat = reproject(self.crs, CRS(4326), x, y)
        except ProjError as error:
            raise ScenarioError.of(KEY, f"{self.crs.name!r} cannot be put on the globe ({error})") from error
        known = np.isfinite(lon) & np.isfinite(lat)
        if not known.any():
            first = ", ".join(f"{value:.6g}" for value in log.positions.place[0, :2])
            message = f"{self.crs.name!r} does not contain the first position ({first}); give the CRS of the log"
            raise ScenarioError.of(KEY, message)
        place = np.column_stack([np.where(known, lon, np.nan), np.where(known, lat, np.nan), self.unit_m * height])
        positions, attitudes = replace(log.positions, place=place), log.attitudes
        note = f"positions are in {self.crs.name}"
        if self.crs.is_projected:
            middle = float(np.median(lon[known])), float(np.median(lat[known]))
            J_grid_ground = grid_from_ground(MapFrame(crs=self.crs, origin_m=(0.0, 0.0)), *middle)
            convergence = convergence_rad(J_grid_ground)
            note += f", headings count from its grid north ({np.rad2deg(convergence):+.2f} deg from true north)"
            if positions.velocity_mps is not None:
                across = np.linalg.solve(J_grid_ground, positions.velocity_mps[:, :2].T).T
                positions = replace(positions, velocity_mps=np.column_stack([across, positions.velocity_mps[:, 2]]))
            attitudes = None if attitudes is None else attitudes.turned(convergence)
        return replace(log, on_map=True, positions=positions, attitudes=attitudes, notes=(note, *log.notes))


def map_coordinates(name: str) -> MapCoordinates:
    """Return the CRS that `platform.log_crs` names; ScenarioError for none that a flight can be in."""
    whole = stated_crs(name, KEY)
    crs = horizontal_crs_of(whole, KEY)
    if whole.is_bound:
        raise ScenarioError.of(KEY, f"{shown(name)} is bound to another CRS; give the CRS itself")
    heights = [axis for axis in whole.axis_info if axis.direction == "up"]
    return MapCoordinates(crs=crs, unit_m=heights[0].unit_conversion_factor if heights else 1.0)
