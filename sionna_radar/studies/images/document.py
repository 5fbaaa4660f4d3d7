"""Radar images as files, table and figures.

The netCDF files have the classic format with 64-bit offsets, readable by every netCDF reader (xarray's `open_dataset`
among them); it has no complex numbers, so an amplitude is stored as its real and imaginary parts. Following the CF
conventions, variables have the attributes `coordinates` and, if georeferenced, `grid_mapping`.
"""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from pyproj import CRS, Transformer
from rich.table import Table
from scipy.io import netcdf_file

from sionna_radar.execution.workers import versions
from sionna_radar.foundation.netcdf_file import write_variable
from sionna_radar.report.colours import EMPTY
from sionna_radar.report.drawing import ReportFigure
from sionna_radar.report.study_document import StudyDocument
from sionna_radar.report.terminal import table_of
from sionna_radar.scenario import Scenario, to_toml
from sionna_radar.studies.images.aperture import PixelGrid
from sionna_radar.studies.images.sar import SarImage
from sionna_radar.studies.images.strip import to_ground
from sionna_radar.studies.images.study import Imagery, Reflector, Response

COLOURS = "viridis"
WIDTH_IN = 8.0
# Limits of the height of an image with equal axis scales.
HEIGHTS_IN = (1.8, 4.0)
# Decibels around the median: speckle below, buildings and targets above, up to a level exceeded by few pixels (%).
DARKEST_DB, MIN_BRIGHTEST_DB, BRIGHTEST_SHARE = -12.0, 8.0, 1.0
LABEL = "Power over the median (dB)"


def slant_range(imagery: Imagery) -> Figure:
    """Draw the slant-range image of the illuminated ground."""
    strip, image = imagery.strip, imagery.slant
    edges = [strip.slant_range_m(ground) for ground in (strip.near_m, strip.far_m)]
    shown = (image.range_m >= edges[0]) & (image.range_m <= edges[1])
    height = _height_in(image.along_m, image.range_m[shown])
    figure = ReportFigure(figsize=(WIDTH_IN, height + 1.2), layout="constrained")
    axes = figure.subplots()
    level = _level_db(image.power[:, shown].T)
    picture = _show(axes, level, image.along_m, image.range_m[shown], _brightest_db(level))
    title = f"Real aperture (SLAR): resolves {_length(imagery.slar.along_m)} along the track, "
    axes.set_title(f"{title}{_length(imagery.slar.across_m)} in slant range", fontsize="medium")
    axes.set(xlabel="Along the track (m)", ylabel="Slant range (m)")
    figure.colorbar(picture, ax=axes, label=LABEL, extend="both")
    return figure


def focused(imagery: Imagery) -> Figure:
    """Draw the real-aperture image on level ground, above the focused one of the same pulses."""
    image = imagery.focused
    assert image is not None
    grid = image.grid
    ground_power = to_ground(imagery.slant, imagery.strip.height_m, grid.across_m)
    height = _height_in(grid.along_m, grid.across_m)
    figure = ReportFigure(figsize=(WIDTH_IN, 2 * height + 1.8), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, sharey=True)
    levels = _level_db(ground_power.T), _level_db(image.power)
    brightest = max(_brightest_db(level) for level in levels)
    _show(upper, levels[0], imagery.slant.along_m, grid.across_m, brightest)
    picture = _show(lower, levels[1], grid.along_m, grid.across_m, brightest)
    sar = imagery.sar
    resolution = f": resolves {_length(sar.along_m)} along the track, {_length(sar.across_m)} across it" if sar else ""
    titles = (
        f"Real aperture (SLAR): resolves {_length(imagery.slar.along_m)} along the track",
        f"The same pulses focused (SAR){resolution}",
    )
    for axes, title in zip((upper, lower), titles, strict=True):
        axes.set_title(title, fontsize="medium")
    lower.set(xlabel="Along the track (m)", xlim=(grid.along_m[0], grid.along_m[-1]))
    for axes in (upper, lower):
        axes.set_ylabel("Ground range (m)")
    figure.colorbar(picture, ax=(upper, lower), label=LABEL, extend="both")
    return figure


def _level_db(power: Float[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
    positive = np.where(power > 0, power, np.nan)
    return 10 * np.log10(positive / np.nanmedian(positive))


def _brightest_db(level: Float[np.ndarray, "row column"]) -> float:
    return max(float(np.nanpercentile(level, 100 - BRIGHTEST_SHARE)), MIN_BRIGHTEST_DB)


def _show(
    axes: Axes,
    level: Float[np.ndarray, "row column"],
    along_m: Float[np.ndarray, " column"],
    across_m: Float[np.ndarray, " row"],
    brightest_db: float,
) -> AxesImage:
    axes.set_facecolor(EMPTY)
    return axes.imshow(
        np.ma.masked_invalid(level),
        origin="lower",
        extent=(*_outline(along_m), *_outline(across_m)),
        cmap=COLOURS,
        vmin=DARKEST_DB,
        vmax=brightest_db,
        aspect="auto",
        interpolation="nearest",
    )


def _outline(centres: Float[np.ndarray, " n"]) -> tuple[float, float]:
    half = float(centres[1] - centres[0]) / 2
    return float(centres[0]) - half, float(centres[-1]) + half


def _height_in(along_m: np.ndarray, across_m: np.ndarray) -> float:
    scale = (WIDTH_IN - 2.0) / (along_m[-1] - along_m[0])
    return float(np.clip(scale * (across_m[-1] - across_m[0]), *HEIGHTS_IN))


def _length(metres: float) -> str:
    return f"{metres:.2g} m" if metres >= 0.995 else f"{100 * metres:.2g} cm"


# CF name of the variable with the CRS.
GRID_MAPPING = "crs"


def write_images(imagery: Imagery, directory: Path) -> None:
    """Write the images as netCDF."""
    write_slar(directory / "slar.nc", imagery)
    if imagery.focused is not None:
        write_sar(directory / "sar.nc", imagery, imagery.focused)


def image_numbers(imagery: Imagery) -> dict[str, Any]:
    """Return the imaged strip and the image resolutions.

    Half-power widths in metres: `theory` in the middle of the beam, and for every point target at its position next to
    `measured`, which is None if the target is not isolated, not steady or not bright enough.
    """
    strip, focused = imagery.strip, imagery.focused
    document: dict[str, Any] = {
        "scenario": imagery.scenario,
        "recording": imagery.recording.name if imagery.recording else None,
        "seed": imagery.scenario.seed if isinstance(imagery.scenario, Scenario) else None,
        "pulses": imagery.pulses,
        "strip": {
            "side": strip.side,
            "length_m": strip.length_m,
            "near_ground_range_m": strip.near_m,
            "far_ground_range_m": strip.far_m,
            "ground_height_m": strip.height_m,
            "middle_slant_range_m": strip.middle_range_m,
        },
        "slar": {
            "stretches": len(imagery.slant.along_m),
            "stretch_m": np.diff(imagery.slant.along_m[:2])[0],
            "theory": {"along_m": imagery.slar.along_m, "slant_range_m": imagery.slar.across_m},
        },
        "sar": None,
        "reflectors": [_reflector(reflector) for reflector in imagery.reflectors],
        "versions": versions(),
    }
    if focused is not None and imagery.sar is not None:
        document["sar"] = {
            "rows": focused.grid.shape[0],
            "columns": focused.grid.shape[1],
            "pixel_along_m": np.diff(focused.grid.along_m[:2])[0],
            "pixel_ground_range_m": np.diff(focused.grid.across_m[:2])[0],
            "aperture_deg": np.rad2deg(focused.aperture.width_rad),
            "window": focused.window_name,
            "theory": {"along_m": imagery.sar.along_m, "ground_range_m": imagery.sar.across_m},
        }
    return document


def _reflector(reflector: Reflector) -> dict[str, Any]:
    return {
        "position_m": reflector.position_m,
        "along_m": reflector.place.along_m,
        "ground_range_m": reflector.place.ground_m,
        "slant_range_m": reflector.place.slant_range_m,
        "slar": _response(reflector.slar, "slant_range_m"),
        "sar": None if reflector.sar is None else _response(reflector.sar, "ground_range_m"),
    }


def _response(response: Response, across: str) -> dict[str, Any]:
    return {
        name: None if widths is None else {"along_m": widths["along_m"], across: widths["across_m"]}
        for name, widths in asdict(response).items()
    }


def write_slar(path: Path, imagery: Imagery) -> None:
    """Write the slant-range image: power against along-track position and slant range."""
    image = imagery.slant
    track = imagery.strip.pixels(image.along_m, np.zeros(1))
    with netcdf_file(path, "w", version=2) as file:
        _describe(file, imagery, "Slant-range image of a side-looking radar")
        _axis(file, "along", image.along_m, "position along the track from the first pulse")
        _axis(file, "slant_range", image.range_m, "slant range, corrected for Doppler")
        write_variable(
            file, "power", image.power, ("along", "slant_range"), "W", "received power, mean over an interval"
        )
        height = image.height_m + _origin_m(imagery)[2]
        write_variable(file, "radar_height", height, ("along",), "m", "mean height of the radar, as measured")
        _places(file, imagery, track, row=0)


def write_sar(path: Path, imagery: Imagery, image: SarImage) -> None:
    """Write the focused image: complex amplitude against ground range and along-track position."""
    pixel = ("ground_range", "along")
    with netcdf_file(path, "w", version=2) as file:
        _describe(file, imagery, "Stripmap SAR image, back-projected on level ground")
        _axis(file, "along", image.grid.along_m, "position along the track from below the first pulse")
        _axis(file, "ground_range", image.grid.across_m, "distance from the track on the ground")
        write_variable(file, "amplitude_real", image.amplitude.real, pixel, "W^0.5", "real part of the amplitude")
        write_variable(file, "amplitude_imag", image.amplitude.imag, pixel, "W^0.5", "imaginary part of the amplitude")
        write_variable(
            file, "pulses", image.pulses.astype(np.int32), pixel, "1", "number of pulses focused into the pixel"
        )
        _places(file, imagery, image.grid)


def _describe(file: netcdf_file, imagery: Imagery, title: str) -> None:
    file.Conventions, file.title, file.source = "CF-1.8", title, "sionna-radar"
    # scipy encodes text as ASCII, and writes bytes unchanged.
    if imagery.recording is not None:
        file.history = f"formed of {imagery.recording.name}".encode()
    if isinstance(imagery.scenario, Scenario):
        if imagery.recording is None:
            file.history = f"simulated with seed {imagery.scenario.seed}"
        file.scenario = to_toml(imagery.scenario).encode()
    file.side = imagery.strip.side
    file.ground_height_m = imagery.strip.height_m + _origin_m(imagery)[2]
    if imagery.georeference:
        file.crs_wkt = imagery.georeference.crs_wkt.encode()
        mapping = file.createVariable(GRID_MAPPING, "i4", ())
        for name, value in CRS.from_wkt(imagery.georeference.crs_wkt).to_cf().items():
            setattr(mapping, name, value.encode() if isinstance(value, str) else value)


def _places(file: netcdf_file, imagery: Imagery, grid: PixelGrid, row: int | None = None) -> None:
    """Write the map coordinates of all pixels, or of one row, and set them as coordinates of the variables."""
    place = grid.position_m[..., :2] + np.array(_origin_m(imagery)[:2])
    dimensions: tuple[str, ...] = ("ground_range", "along")
    if row is not None:
        place, dimensions = place[row], dimensions[1:]
    measured = [v for name, v in file.variables.items() if name not in (GRID_MAPPING, *v.dimensions)]
    frame = "map" if imagery.georeference else "local"
    coordinates = ["east", "north"]
    for number, name in enumerate(coordinates):
        write_variable(file, name, place[..., number], dimensions, "m", f"{frame} {name}ing")
    if imagery.georeference:
        file.variables["east"].standard_name = "projection_x_coordinate"
        file.variables["north"].standard_name = "projection_y_coordinate"
        crs = CRS.from_wkt(imagery.georeference.crs_wkt).to_2d()
        lonlat = Transformer.from_crs(crs, 4326, always_xy=True).transform(place[..., 0], place[..., 1])
        for name, degrees, unit in zip(("longitude", "latitude"), lonlat, ("east", "north"), strict=True):
            write_variable(file, name, np.asarray(degrees), dimensions, f"degrees_{unit}", f"{name}, WGS 84")
            file.variables[name].standard_name = name
            coordinates.append(name)
    for variable in measured:
        variable.coordinates = " ".join(coordinates)
        if imagery.georeference:
            variable.grid_mapping = GRID_MAPPING


def _origin_m(imagery: Imagery) -> tuple[float, float, float]:
    return imagery.georeference.origin_m if imagery.georeference else (0.0, 0.0, 0.0)


def _axis(file: netcdf_file, name: str, values: np.ndarray, meaning: str) -> None:
    file.createDimension(name, len(values))
    write_variable(file, name, values, (name,), "m", meaning)


def sentences(imagery: Imagery) -> list[str]:
    """Return why there is no focused image; nothing if there is one."""
    if imagery.focused is not None:
        return []
    if imagery.recording is not None:
        return ["no focused image because the recording holds powers, or scatterers that change from pulse to pulse"]
    return ["no focused image because scatterers change from pulse to pulse; set tracing.speckle = 'persistent'"]


def image_table(imagery: Imagery) -> Table:
    """Return the half-power widths of the images and of point targets in them."""
    rows = [("SLAR, theory", f"{imagery.slar.along_m:.2f} m", f"{imagery.slar.across_m:.2f} m slant range")]
    if imagery.sar:
        sar = f"{1e3 * imagery.sar.along_m:.1f} mm", f"{imagery.sar.across_m:.2f} m ground range"
        rows.append(("SAR, theory", *sar))
    for number, reflector in enumerate(imagery.reflectors):
        for name, response in (("SLAR", reflector.slar), ("SAR", reflector.sar)):
            if response is not None and (measured := response.measured) is not None:
                along, across = measured.along_m / response.theory.along_m, measured.across_m / response.theory.across_m
                rows.append((f"{name}, targets.{number}", f"{along:.2f} of theory", f"{across:.2f} of theory"))
    return table_of("Half-power widths", ["", "along the track", "across it"], rows, left=[""])


def figures_of(imagery: Imagery) -> dict[str, Callable[[Imagery], Figure]]:
    """Return the drawings by name."""
    return {"slar": slant_range} | ({} if imagery.focused is None else {"sar": focused})


DOCUMENT = StudyDocument[Imagery](
    marker="image.json",
    suffix="_image",
    numbers=image_numbers,
    tables=lambda imagery: [image_table(imagery)],
    lines=sentences,
    figures=figures_of,
    notebook=["slar"],
    texts={"scenario.toml": lambda imagery: to_toml(s) if isinstance(s := imagery.scenario, Scenario) else None},
    files=[write_images],
)
