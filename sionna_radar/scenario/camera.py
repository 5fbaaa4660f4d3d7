"""Table `[camera]`: lens, light and exposure of a camera that flies at the place of the radar."""

from typing import Annotated

from pydantic import Field

from sionna_radar.scenario.table import Conflicts, Real, Table

# A film of the largest and most frames takes 1 GB in memory.
Pixels = Annotated[int, Field(strict=True, ge=2, le=1024)]


class CameraTable(Table):
    """A camera at the place of the radar, which looks along the heading: `sionna-radar camera`."""

    field_of_view_deg: Annotated[Real, Field(ge=1, le=150)] = 60.0
    """Horizontal field of view of the lens, a pinhole."""
    pixels: tuple[Pixels, Pixels] = (640, 480)
    """Number of columns and rows of a frame; pixels are square."""
    frames: Annotated[int, Field(strict=True, ge=1, le=100)] = 6
    """Number of frames, evenly spread from the first pulse to the last."""
    depression_deg: Annotated[Real, Field(ge=0, le=90)] = 20.0
    """Angle of the axis below the horizon: 0 looks ahead, 90 straight down."""
    sun_elevation_deg: Annotated[Real, Field(ge=5, le=90)] = 40.0
    """Elevation of the sun."""
    sun_azimuth_deg: Annotated[Real, Field(ge=0, le=360)] = 135.0
    """Azimuth of the sun, clockwise from north."""
    night: bool = Field(default=False, strict=True)
    """Whether starlight of a clear sky takes the place of the sun."""
    exposure_ms: Annotated[Real, Field(ge=1e-3, le=1e4)] | None = None
    """Exposure time. Default: automatic, by the brightest pixels, up to 33 ms and with a gain beyond."""
    full_well: Annotated[int, Field(strict=True, ge=100, le=1_000_000)] = 10_000
    """Number of electrons that fill a pixel; it sets the shot noise."""
    albedos: dict[str, Annotated[Real, Field(ge=0, le=1)]] = {}
    """Visible albedos of surfaces by the names of their materials. Default: typical ones of known names, and short
    grass for all others."""

    def _conflicts(self) -> Conflicts:
        changed = self.changed("sun_elevation_deg", "sun_azimuth_deg")
        if self.night and changed:
            yield changed[0], f"{getattr(self, changed[0]):g} has no effect at night; remove it, or set night = false"
