"""Parameters of the DEM methods: tables `[dem.method_parameters]`. Sensitivity: `docs/theory/sensitivity.md`."""

from typing import Annotated

from pydantic import Field

from sionna_radar.scenario.table import Parameters, Positive, Real

Share = Annotated[Real, Field(gt=0, lt=1)]


class LinearParameters(Parameters):
    """Parameters of "linear": the triangles between points that are interpolated, and walls."""

    longest_side_gaps: Positive = 3.0
    """Longest side of a triangle, in units of `max_gap_m`."""
    wall_slope: Positive = 1.0
    """Least slope, rise over run, of a triangle that may belong to a wall; half of it is the least slope by which a
    side of a wall exceeds the ground beyond both of its ends."""
    wall_contrast: Positive = 2.0
    """Least ratio of a wall's slope to that of the surrounding ground."""
    wall_sigmas: Positive = 4.0
    """Least height of a wall, in standard deviations of the points' ranges."""
    wall_diagonal: Positive = 1.5
    """Longest side along which no echo is missing, in units of `max_gap_m`; along longer ones any jump is taken for a
    shadow."""
    wall_rounds: Annotated[int, Field(strict=True, ge=1, le=20)] = 3
    """Iterations between the ground's slopes and the set of wall triangles, which depend on each other."""


class SmoothParameters(Parameters):
    """Parameters of "smooth" and "refined": the surface through the mean ranges."""

    rounds: Annotated[int, Field(strict=True, ge=1, le=20)] = 2
    """Number of successive surfaces through the mean ranges; over each, the effect of the beam on the mean ranges is
    predicted anew."""
    similar_pulses: Annotated[int, Field(strict=True, ge=1, le=1000)] = 9
    """Number of neighbouring pulses with echoes of like shape over which the speckle error of a mean range is
    averaged."""
    outlier_sigmas: Positive = 4.0
    """Largest distance of an echo's mean range from the surface, in standard deviations as they scatter; echoes beyond
    it are left out, and so are those as far from a plane of stepped ground."""
    window_heights: Annotated[int, Field(strict=True, ge=8, le=1000)] = 40
    """Number of neighbouring heights from which the roughness of the ground around a place is estimated."""
    tile_m: Positive = 160.0
    """Longest side of a tile of the map; each tile has a terrain model of its own."""
    overlap_m: Positive = 30.0
    """Width over which neighbouring tiles are blended, and distance beyond a tile to which its echoes lie."""


class CanopyParameters(SmoothParameters):
    """Parameters of "canopy": the surface through the mean ranges, from which ground and plants are told apart."""

    max_plants_m: Annotated[Real, Field(ge=0.2, le=10)] = 4.0
    """Height of the tallest plants that are looked for; the time of a map grows with its square."""
    plant_types: Annotated[int, Field(strict=True, ge=1, le=20)] = 4
    """Number of kinds of plants (extinction, cover, brightness, height of the lowest leaves) that a survey holds, the
    likeliest of 96; the time of a map grows with it."""


class SteppedParameters(SmoothParameters):
    """Parameters of "stepped": the levels of the surface, and the steps between them."""

    tile_m: Positive = 240.0
    """Longest side of a tile of the map; each tile has levels of its own about a plane through its echoes."""
    jump_nepers: Positive = 3.0
    """Penalty on neighbours on both sides of a step: at 3, one in twenty is. In coarse maps a third of it is that on
    neighbours that differ by one level."""
    tie_nepers: Positive = 0.5
    """Largest excess of a level's cost over the best, along each direction, that counts as a tie; of tied levels the
    highest is taken."""
    reflectivity_ratio: Annotated[Real, Field(gt=1, le=100)] = 4.0
    """Ratio between successive reflectivities that are tried for a cell; 4 is 6 dB."""
    min_gain: Share = 0.02
    """Least two-way gain, relative to that of the axis, at which an echo counts as evidence for a patch."""
    step_levels: Positive = 4.0
    """Least height of a step, in levels, which are a range resolution apart or more; a step is never flatter than 45
    deg."""
    max_other_side: Share = 0.1
    """Largest probability of a cell to belong to the other side of a step; cells beyond it are left empty."""
    single_m: Positive = 5.0
    """Width of the windows in which single wrong cells of the coarse map are outvoted."""

    @property
    def pair_nepers(self) -> float:
        """Penalty on a pair of neighbours, of eight each: the side of a cell cuts three, two of them diagonal."""
        return self.jump_nepers / 3


LINEAR, SMOOTH, CANOPY, STEPPED = LinearParameters(), SmoothParameters(), CanopyParameters(), SteppedParameters()
