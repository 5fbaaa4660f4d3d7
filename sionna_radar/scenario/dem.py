"""The elevation model that the echoes become: `[dem]`."""

from typing import Annotated

from pydantic import Field

from sionna_radar.scenario.choice import ParametersOf, name_in
from sionna_radar.scenario.parts import DEM_METHODS
from sionna_radar.scenario.table import NonNegative, Positive, Real, Table


class DemTable(Table):
    """The elevation model: its grid, and how the echoes become heights.

    method: "auto" takes "stepped" over a scenario with buildings, if the sensor has range profiles, the air holds
        nothing that would be taken for walls and the lines of a whisk-broom scan are no farther apart than two
        footprints, and "linear" elsewhere. "linear" interpolates between the located
        echoes. "smooth" lays the most probable surface through the mean ranges of the whole echoes (or through the
        points, without range profiles), each weighted by its uncertainty, under a covariance that is learned from
        them. "refined" goes on from there: it predicts every echo from the surface and the known beam, and moves the
        surface to where the measured echoes are most likely. "stepped" is for built-up ground: it first finds where
        the surface breaks, from what all echoes say for and against every height, and maps each level by itself.
        Custom methods are named here as well.
    method_parameters: of a custom method that has some.
    spacing_m: size of a cell.
    max_gap_m: farthest that a filled cell is from a measured one; without it the distance between neighbouring beams on
        level ground, and no less than two cells.
    microrelief_m: standard deviation of relief that is finer than the footprint, of which no echo tells: part of
        `dem_sigma.tif`. Without it 0.03 m over terrain from a file, as fields and forest floors have, and 0 over
        synthetic terrain, which is smooth between its posts.
    min_confidence_m: cells whose standard deviation (`dem_sigma.tif`) is more are left out; without it none is.
    shadow_incidence_deg: surfaces seen at a greater incidence count as shadow.
    """

    method: Annotated[str, name_in(DEM_METHODS, "auto")] = "auto"
    method_parameters: Annotated[Table | None, ParametersOf("method", DEM_METHODS)] = None
    spacing_m: Positive = 1.0
    max_gap_m: Positive | None = None
    microrelief_m: NonNegative = 0.0
    min_confidence_m: Positive | None = None
    shadow_incidence_deg: Annotated[Real, Field(gt=0, le=90)] = 85.0

    @property
    def map_method(self) -> str:
        """The method; of "auto", which a scenario has replaced, what fits any ground."""
        return "linear" if self.method == "auto" else self.method
