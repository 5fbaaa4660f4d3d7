"""Crops by growth stage: how they are planted, how high they stand, and how much leaf they have.

Stages carry the numbers of the BBCH scale (Meier, "Growth stages of mono- and dicotyledonous plants", BBCH monograph).
Heights, leaf area indices and water contents are typical ones that a field may miss by a third; each can be set.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal


@dataclass(frozen=True, kw_only=True)
class GrowthStage:
    """A crop at one time of its season.

    bbch: number of the stage on the BBCH scale; None for plants without one.
    height_m, base_height_m: of the tops and of the lowest leaves above the ground.
    row_width_m: of the foliage across the row.
    leaf_area_index: one-sided leaf area over ground area, the gaps between rows included.
    water_content: mass of water over mass of fresh leaf.
    """

    bbch: int | None = None
    height_m: float
    base_height_m: float = 0.0
    row_width_m: float
    leaf_area_index: float
    water_content: float


@dataclass(frozen=True, kw_only=True)
class Crop:
    """A crop and its stages.

    form: whether the plants of a row are joined to a wall of leaves, or have a rounded crown each.
    height_spread: standard deviation of the height from plant to plant, over the height.
    """

    form: Literal["rows", "crowns"]
    row_spacing_m: float
    plant_spacing_m: float
    leaf_thickness_mm: float
    height_spread: float
    stages: Mapping[str, GrowthStage]


def _stages(*rows: tuple[Any, ...]) -> Mapping[str, GrowthStage]:
    """Return stages by name, from rows of a table: name, BBCH, top, lowest leaves, row width, leaf area, water."""
    keys = ("bbch", "height_m", "base_height_m", "row_width_m", "leaf_area_index", "water_content")
    return {name: GrowthStage(**dict(zip(keys, row, strict=True))) for name, *row in rows}


# Typical values; the leaf area of flowering maize is within the 2.8 to 4.6 of Edoka (dissertation, HU Berlin, 2006).
CROPS: Mapping[str, Crop] = MappingProxyType(
    {
        "maize": Crop(
            form="rows", row_spacing_m=0.75, plant_spacing_m=0.16, leaf_thickness_mm=0.2, height_spread=0.07,
            stages=_stages(
                ("leaf_development", 15, 0.35, 0.0, 0.3, 0.4, 0.85),
                ("stem_elongation", 34, 1.1, 0.0, 0.6, 2.0, 0.82),
                ("flowering", 65, 2.4, 0.0, 0.75, 4.3, 0.75),
                ("ripe", 87, 2.3, 0.0, 0.65, 2.0, 0.5),
            ),
        ),
        "wheat": Crop(
            form="rows", row_spacing_m=0.125, plant_spacing_m=0.5, leaf_thickness_mm=0.2, height_spread=0.06,
            stages=_stages(
                ("tillering", 25, 0.15, 0.0, 0.125, 1.0, 0.82),
                ("stem_elongation", 32, 0.45, 0.0, 0.125, 3.0, 0.8),
                ("flowering", 65, 0.85, 0.0, 0.125, 4.5, 0.72),
                ("ripe", 89, 0.8, 0.0, 0.125, 1.5, 0.15),
            ),
        ),
        "vines": Crop(
            form="rows", row_spacing_m=2.0, plant_spacing_m=1.0, leaf_thickness_mm=0.2, height_spread=0.05,
            stages=_stages(
                ("leaf_development", 15, 1.2, 0.7, 0.25, 0.3, 0.8),
                ("flowering", 65, 1.8, 0.6, 0.4, 1.2, 0.77),
                ("ripening", 83, 2.0, 0.6, 0.5, 1.8, 0.7),
            ),
        ),
        "orchard": Crop(
            form="crowns", row_spacing_m=3.5, plant_spacing_m=1.5, leaf_thickness_mm=0.25, height_spread=0.08,
            stages=_stages(
                ("flowering", 65, 3.2, 0.6, 1.5, 0.7, 0.75),
                ("fruit_development", 75, 3.5, 0.6, 1.8, 2.0, 0.65),
            ),
        ),
        "grass": Crop(
            form="rows", row_spacing_m=0.25, plant_spacing_m=0.25, leaf_thickness_mm=0.2, height_spread=0.15,
            stages=_stages(
                ("grazed", None, 0.08, 0.0, 0.25, 1.2, 0.8),
                ("before_cutting", 55, 0.5, 0.0, 0.25, 4.5, 0.8),
            ),
        ),
        "forest_edge": Crop(
            form="rows", row_spacing_m=4.0, plant_spacing_m=4.0, leaf_thickness_mm=0.2, height_spread=0.15,
            stages=_stages(
                ("leaf_unfolding", 13, 15.0, 0.0, 4.0, 1.5, 0.7),
                ("full_leaf", 75, 15.0, 0.0, 4.0, 5.0, 0.6),
            ),
        ),
    }
)  # fmt: skip
