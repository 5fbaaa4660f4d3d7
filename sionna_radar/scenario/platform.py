"""The flight: `[platform]`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from sionna_radar.scenario.bases import NavigationParameters
from sionna_radar.scenario.choice import ChosenBy
from sionna_radar.scenario.navigation import NavigationTable
from sionna_radar.scenario.parts import NAVIGATIONS
from sionna_radar.scenario.table import Point2, Positive, Real, Table, refuse


class Platform(Table):
    """The flight: straight legs, level or following the terrain, with or without take-off and landing."""

    altitude_m: Annotated[Positive, Field(le=1e5)]
    speed_mps: Annotated[Positive, Field(le=1e4)]
    start_m: Point2 | None = None
    heading_deg: Real = 90.0
    length_m: Positive = 100.0
    waypoints_m: tuple[Point2, ...] = ()
    height: Literal["level", "terrain_following"] = "level"
    follow_length_m: Positive = 50.0
    profile: Literal["cruise", "full"] = "cruise"
    climb_rate_mps: Positive = 2.0
    descent_rate_mps: Positive = 2.0
    acceleration_mps2: Positive = 2.0
    takeoff_height_m: Positive = 5.0
    navigation: Annotated[NavigationParameters, ChosenBy("kind", NAVIGATIONS, "errors")] = NavigationTable()

    @model_validator(mode="after")
    def _one_track(self) -> Platform:
        fields = type(self).model_fields
        given = [k for k in ("start_m", "length_m", "heading_deg") if getattr(self, k) != fields[k].default]
        if self.waypoints_m and given:
            raise refuse("waypoints_m", f"contradicts {', '.join(given)}; give the one or the other")
        if len(self.waypoints_m) == 1:
            raise refuse("waypoints_m", "one point makes no leg; give at least two")
        for a, b in zip(self.waypoints_m[:-1], self.waypoints_m[1:], strict=True):
            if a == b:
                raise refuse("waypoints_m", f"{a} follows itself; remove the repeated point")
        if self.profile == "full" and self.takeoff_height_m >= self.altitude_m:
            raise refuse(
                "takeoff_height_m",
                f"{self.takeoff_height_m:g} is not below altitude_m = {self.altitude_m:g}; lower it",
            )
        return self
