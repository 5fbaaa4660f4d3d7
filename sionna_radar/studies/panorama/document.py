"""Panoramic images as files, table and figures."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage, imsave

from sionna_radar.foundation.decibels import decibels
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.raster_file import write_pixels
from sionna_radar.report.colours import RED
from sionna_radar.report.drawing import ReportFigure
from sionna_radar.report.files.points_table import write_laz
from sionna_radar.report.study_document import StudyDocument
from sionna_radar.studies.panorama.polar_images import IMAGES, PolarImages, Way
from sionna_radar.studies.panorama.study import Panorama

# Shown dynamic range below a level that few pixels exceed (%), dB.
SHOWN_DB, BRIGHTEST_SHARE = 45.0, 0.2
# Range of the mosaic relative to the unambiguous one, beyond which folded echoes are likely.
REACH = 2 / 3


def reach_of(images: PolarImages, reach_m: float | None) -> float:
    """Return the range up to which a turn is laid into the mosaic, at most that of its last cell."""
    last_m = float(images.range_m[-1])
    return REACH * last_m if reach_m is None else min(reach_m, last_m)


def way_of(images: PolarImages, along: str) -> Way:
    """Return the true or the measured way."""
    way = images.true if along == "true" else images.measured
    assert way is not None  # simulated
    return way


def mosaic_grid(images: PolarImages, *, spacing_m: float, reach_m: float | None, along: str) -> Grid:
    """Return the grid of the mosaic; ScenarioError for too many pixels, whether or not powers are known yet."""
    return images.grid(way_of(images, along), spacing_m, reach_of(images, reach_m))


def _level_db(power: Float[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
    level = np.full(power.shape, np.nan)
    some = np.isfinite(power) & (power > 0)
    level[some] = decibels(power[some])
    return level


def show_power(axes: Axes, power: Float[np.ndarray, "row column"], grid: Grid) -> AxesImage:
    """Draw powers on the ground in decibels."""
    level = _level_db(power)
    top = float(np.nanpercentile(level, 100 - BRIGHTEST_SHARE))
    axes.set(xlabel="East (m)", ylabel="North (m)", aspect="equal")
    return axes.imshow(
        np.ma.masked_invalid(level), origin="lower", extent=grid.extent_m, cmap="inferno", vmin=top - SHOWN_DB, vmax=top
    )


def first_turn(seen: Panorama) -> Figure:
    """Draw the first turn as if it were simultaneous, and each chirp at its own place."""
    images = seen.images
    way = way_of(images, "measured")
    grid = images.grid(way, float(images.range_m[-1]) / 400, 0.7 * reach_of(images, None), turn=0)
    figure = ReportFigure(figsize=(10.0, 5.2), layout="constrained")
    left, right = figure.subplots(1, 2, sharex=True, sharey=True)
    pictures = [show_power(axes, images.on_grid(0, grid, way, as_one=axes is left), grid) for axes in (left, right)]
    moved_m = seen.speed_mps * images.turn_s
    left.set_title(f"As one: {moved_m:.1f} m driven in the turn,\nranges off by up to {_doppler_m(seen):.2f} m",
                   fontsize="medium")  # fmt: skip
    right.set_title("Each chirp at its own place, without Doppler", fontsize="medium")
    figure.colorbar(pictures[1], ax=[left, right], label="Received power (dBW)", extend="both")
    return figure


def mosaic_figure(
    seen: Panorama, mosaic: Callable[[Panorama], tuple[Grid, Float[np.ndarray, "row column"]]], along: str
) -> Figure:
    """Draw the mosaic and the way through it."""
    grid, power = mosaic(seen)
    figure = ReportFigure(figsize=(7.5, 7.0), layout="constrained")
    axes = figure.subplots()
    picture = show_power(axes, power, grid)
    place = way_of(seen.images, along).position_m.reshape(-1, 3)
    axes.plot(place[:, 0], place[:, 1], color=RED, lw=1.2)
    axes.set_title(f"Echo amplitude of {len(seen.images)} turns, and the way", fontsize="medium")
    figure.colorbar(picture, ax=axes, label="Power, scaled to one range (dB)", extend="both", shrink=0.8)
    return figure


def _doppler_m(seen: Panorama) -> float:
    return abs(seen.images.chirp.doppler_range_s) * seen.speed_mps


def panorama_numbers(seen: Panorama, along: str, spacing_m: float, reach_m: float | None) -> dict[str, Any]:
    """Return the numbers."""
    turns, azimuths, cells = seen.images.power_w.shape
    return {
        "turns": turns,
        "azimuths": azimuths,
        "range_cells": cells,
        "turn_s": seen.images.turn_s,
        "points": len(seen.points),
        "range_resolution_m": seen.range_resolution_m,
        "azimuth_resolution_deg": np.rad2deg(seen.azimuth_resolution_rad),
        "unambiguous_range_m": seen.images.chirp.max_range_m,
        "driven_in_a_turn_m": seen.speed_mps * seen.images.turn_s,
        "doppler_shift_m": _doppler_m(seen),
        "mosaic": {"along": along, "pixel_m": spacing_m, "reach_m": reach_of(seen.images, reach_m)},
        "warnings": seen.warnings,
        "scenario": seen.scenario,
    }


def sentences(seen: Panorama) -> list[str]:
    """Return sizes, resolutions and the distortion of a turn."""
    turns, azimuths, _ = seen.images.power_w.shape
    return [
        f"{turns} turns of {azimuths} chirps, {seen.images.turn_s:.3g} s each; {len(seen.points):,} points",
        f"resolves {seen.range_resolution_m:.2g} m in range and {np.rad2deg(seen.azimuth_resolution_rad):.2g} deg in "
        f"azimuth, {50 * seen.azimuth_resolution_rad:.2g} m at 50 m; unambiguous up to "
        f"{seen.images.chirp.max_range_m:.4g} m",
        f"in a turn the vehicle drives {seen.speed_mps * seen.images.turn_s:.2g} m, and Doppler shifts ranges by up to "
        f"{_doppler_m(seen):.2g} m: pictures place each chirp from where it was sent",
    ]


def document_of(*, spacing_m: float, reach_m: float | None, along: str, every: int) -> StudyDocument[Panorama]:
    """Return the document of a panorama with its mosaic on pixels of a size, along the true or the measured way."""
    laid: dict[int, tuple[Grid, Float[np.ndarray, "row column"]]] = {}

    def mosaic(seen: Panorama) -> tuple[Grid, Float[np.ndarray, "row column"]]:
        if id(seen) not in laid:
            grid = mosaic_grid(seen.images, spacing_m=spacing_m, reach_m=reach_m, along=along)
            way, reach = way_of(seen.images, along), reach_of(seen.images, reach_m)
            laid[id(seen)] = grid, seen.images.mosaic(grid, way, reach)
        return laid[id(seen)]

    def rasters(seen: Panorama, folder: Path) -> None:
        """Write rasters of the mosaic and of every so many turns, and polar images of these turns."""
        write_power(folder / "mosaic.tif", *mosaic(seen), "echo power, scaled to one range")
        way, reach = way_of(seen.images, along), reach_of(seen.images, reach_m)
        (folder / "turns").mkdir()
        for turn in range(0, len(seen.images), every):
            grid = seen.images.grid(way, spacing_m, reach, turn=turn)
            write_power(folder / "turns" / f"turn_{turn:05}.tif", grid, seen.images.on_grid(turn, grid, way), "power")
            write_polar(folder / "turns" / f"turn_{turn:05}.png", seen.images.power_w[turn])

    return StudyDocument[Panorama](
        marker="panorama.json",
        suffix="_panorama",
        numbers=partial(panorama_numbers, along=along, spacing_m=spacing_m, reach_m=reach_m),
        opening=sentences,
        figures=lambda _: {"first_turn": first_turn, "mosaic": lambda seen: mosaic_figure(seen, mosaic, along)},
        notebook=["mosaic"],
        files=[lambda seen, folder: seen.images.write(folder / IMAGES), rasters, _write_points],
    )


def write_power(path: Path, grid: Grid, power: Float[np.ndarray, "row column"], description: str) -> None:
    """Write powers in decibels as a GeoTIFF; NaN where no turn looked."""
    place, pixels = grid.georeference, _level_db(power)[::-1].astype(np.float32)
    write_pixels(path, pixels, grid.transform, place.crs_wkt if place else None, description, "dB", {})


def write_polar(path: Path, power_w: Float[np.ndarray, "azimuth range"]) -> None:
    """Write a turn as it was received, a row for each chirp and a column for each range cell; brighter is stronger."""
    level = decibels(np.maximum(power_w, np.finfo(np.float32).tiny))
    top = float(np.percentile(level, 100 - BRIGHTEST_SHARE))
    imsave(path, level, cmap="inferno", vmin=top - SHOWN_DB, vmax=top)


def _write_points(seen: Panorama, folder: Path) -> None:
    images = seen.images
    write_laz(folder / "points.laz", seen.points, images.time_s.ravel(), seen.measured.rows, images.georeference)


DOCUMENT = document_of(spacing_m=0.5, reach_m=None, along="measured", every=50)
