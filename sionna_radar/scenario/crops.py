"""Crops by growth stage: how they are planted, how high they stand, and how much leaf they have.

Stages carry the numbers of the BBCH scale (Meier, "Growth stages of mono- and dicotyledonous plants", BBCH monograph).
Heights, leaf area indices and water contents are typical ones that a field may miss by a third; each can be set.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal


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


CROPS: Mapping[str, Crop] = MappingProxyType(
    {
        "maize": Crop(
            form="rows",
            row_spacing_m=0.75,
            plant_spacing_m=0.16,
            leaf_thickness_mm=0.2,
            height_spread=0.07,
            stages={
                "leaf_development": GrowthStage(
                    bbch=15, height_m=0.35, row_width_m=0.3, leaf_area_index=0.4, water_content=0.85
                ),
                "stem_elongation": GrowthStage(
                    bbch=34, height_m=1.1, row_width_m=0.6, leaf_area_index=2.0, water_content=0.82
                ),
                "flowering": GrowthStage(
                    bbch=65, height_m=2.4, row_width_m=0.75, leaf_area_index=4.3, water_content=0.75
                ),
                "ripe": GrowthStage(bbch=87, height_m=2.3, row_width_m=0.65, leaf_area_index=2.0, water_content=0.5),
            },
        ),
        "wheat": Crop(
            form="rows",
            row_spacing_m=0.125,
            plant_spacing_m=0.5,
            leaf_thickness_mm=0.2,
            height_spread=0.06,
            stages={
                "tillering": GrowthStage(
                    bbch=25, height_m=0.15, row_width_m=0.125, leaf_area_index=1.0, water_content=0.82
                ),
                "stem_elongation": GrowthStage(
                    bbch=32, height_m=0.45, row_width_m=0.125, leaf_area_index=3.0, water_content=0.8
                ),
                "flowering": GrowthStage(
                    bbch=65, height_m=0.85, row_width_m=0.125, leaf_area_index=4.5, water_content=0.72
                ),
                "ripe": GrowthStage(bbch=89, height_m=0.8, row_width_m=0.125, leaf_area_index=1.5, water_content=0.15),
            },
        ),
        "vines": Crop(
            form="rows",
            row_spacing_m=2.0,
            plant_spacing_m=1.0,
            leaf_thickness_mm=0.2,
            height_spread=0.05,
            stages={
                "leaf_development": GrowthStage(
                    bbch=15, height_m=1.2, base_height_m=0.7, row_width_m=0.25, leaf_area_index=0.3, water_content=0.8
                ),
                "flowering": GrowthStage(
                    bbch=65, height_m=1.8, base_height_m=0.6, row_width_m=0.4, leaf_area_index=1.2, water_content=0.77
                ),
                "ripening": GrowthStage(
                    bbch=83, height_m=2.0, base_height_m=0.6, row_width_m=0.5, leaf_area_index=1.8, water_content=0.7
                ),
            },
        ),
        "orchard": Crop(
            form="crowns",
            row_spacing_m=3.5,
            plant_spacing_m=1.5,
            leaf_thickness_mm=0.25,
            height_spread=0.08,
            stages={
                "flowering": GrowthStage(
                    bbch=65, height_m=3.2, base_height_m=0.6, row_width_m=1.5, leaf_area_index=0.7, water_content=0.75
                ),
                "fruit_development": GrowthStage(
                    bbch=75, height_m=3.5, base_height_m=0.6, row_width_m=1.8, leaf_area_index=2.0, water_content=0.65
                ),
            },
        ),
        "grass": Crop(
            form="rows",
            row_spacing_m=0.25,
            plant_spacing_m=0.25,
            leaf_thickness_mm=0.2,
            height_spread=0.15,
            stages={
                "grazed": GrowthStage(height_m=0.08, row_width_m=0.25, leaf_area_index=1.2, water_content=0.8),
                "before_cutting": GrowthStage(
                    bbch=55, height_m=0.5, row_width_m=0.25, leaf_area_index=4.5, water_content=0.8
                ),
            },
        ),
        "forest_edge": Crop(
            form="rows",
            row_spacing_m=4.0,
            plant_spacing_m=4.0,
            leaf_thickness_mm=0.2,
            height_spread=0.15,
            stages={
                "leaf_unfolding": GrowthStage(
                    bbch=13, height_m=15.0, row_width_m=4.0, leaf_area_index=1.5, water_content=0.7
                ),
                "full_leaf": GrowthStage(
                    bbch=75, height_m=15.0, row_width_m=4.0, leaf_area_index=5.0, water_content=0.6
                ),
            },
        ),
    }
)
