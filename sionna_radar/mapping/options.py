"""Options of the DEM methods: tables `[dem.method_parameters]`. What each decides: `docs/theory/sensitivity.md`."""

from typing import Annotated

from pydantic import Field

from sionna_radar.scenario.table import Parameters, Positive, Real

Share = Annotated[Real, Field(gt=0, lt=1)]


class LinearParameters(Parameters):
    """Which triangles between points are ground."""

    longest_side_gaps: Positive = 3.0
    """longest side of a triangle, in `max_gap_m`."""
    wall_slope: Positive = 1.0
    """slope, rise over run, from which a triangle may be a wall's; half of it is what the sides of one exceed the
    ground beyond both of their ends by."""
    wall_contrast: Positive = 2.0
    """and how many times as steep as the ground beside it it is."""
    wall_sigmas: Positive = 4.0
    """least height of a wall, in standard deviations of the points' ranges."""
    wall_diagonal: Positive = 1.5
    """longest side along which no echo is missing, in `max_gap_m`: along longer ones any jump is a shadow's."""
    wall_rounds: Annotated[int, Field(strict=True, ge=1, le=20)] = 3
    """slopes of the ground are found from triangles without walls, which are found from slopes: so often."""


class SmoothParameters(Parameters):
    """How mean ranges become a surface."""

    rounds: Annotated[int, Field(strict=True, ge=1, le=20)] = 2
    """surfaces through the mean ranges; over each, what the beam does to these is predicted anew."""
    similar_pulses: Annotated[int, Field(strict=True, ge=1, le=1000)] = 9
    """neighbouring pulses whose echoes are alike in shape: the speckle error of a mean range is averaged over them."""
    outlier_sigmas: Positive = 4.0
    """echoes whose mean range is farther from the surface, in standard deviations as they scatter, are left out,
    and so are those farther from a plane of stepped ground."""
    window_heights: Annotated[int, Field(strict=True, ge=8, le=1000)] = 40
    """neighbouring heights that tell how rough the ground is around a place."""
    tile_m: Positive = 160.0
    """longest side of the tiles of a map, each with a terrain model of its own."""
    overlap_m: Positive = 30.0
    """width over which neighbouring tiles are blended, and how far beyond a tile its echoes lie."""


class SteppedParameters(SmoothParameters):
    """Where the surface may break, and how its levels are found."""

    change_nepers: Positive = 1.0
    """penalty on neighbours that differ by one level: at 1, one in three does."""
    jump_nepers: Positive = 3.0
    """penalty on neighbours that differ by more: at 3, one in twenty does."""
    tie_nepers: Positive = 0.5
    """levels whose cost exceeds the best by no more, along each direction, are as good; the highest is taken."""
    level_margin_m: Positive = 3.0
    """how far the levels reach beyond the located echoes, above and below."""
    block_m: Positive = 120.0
    """side of the blocks that have levels of their own about a plane through their echoes."""
    block_margin_m: Positive = 24.0
    """ground around each block whose echoes count in it."""
    reflectivity_ratio: Annotated[Real, Field(gt=1, le=100)] = 4.0
    """between the reflectivities that are tried for a cell; 4 is 6 dB."""
    min_patch_share: Share = 0.3
    """least power of a patch of one cell, over that of a whole echo."""
    min_gain: Share = 0.02
    """least two-way gain, over that of the axis, at which an echo speaks for a patch."""
    leak_cells: Annotated[int, Field(strict=True, ge=1, le=64)] = 4
    """range cells over which the window leaks a strong power."""
    spill_share: Share = 0.25
    """a range cell of less than this share of the power that leaks into it holds no echo."""
    step_levels: Positive = 4.0
    """height of a step, in levels, which are a range resolution apart or more; never less than 45 deg."""
    min_part_m2: Positive = 6.0
    """smaller parts between steps join the nearest."""
    beside_m: Positive = 2.0
    """heights as near to a step are biased toward its other side, and tell nothing of the plane of a part."""
    single_m: Positive = 5.0
    """width of the windows in which single wrong cells of the coarse map are outvoted."""

    def min_cells(self, spacing_m: float) -> int:
        """Return the least number of cells of a part."""
        return max(1, round(self.min_part_m2 / spacing_m**2))


LINEAR, SMOOTH, STEPPED = LinearParameters(), SmoothParameters(), SteppedParameters()
