"""Live flights as numbers, sentences and rasters."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from sionna_radar.report.study_document import StudyDocument
from sionna_radar.studies.live.flight import LiveFlight


def live_numbers(flight: LiveFlight) -> dict[str, Any]:
    """Return the numbers of a live flight."""
    return {
        "source": flight.source,
        "frames": flight.frames,
        "pulses": flight.pulses,
        "echoes": flight.echoes,
        "flown_s": flight.flown_s,
        "wall_s": flight.wall_s,
        "lag_s": None if flight.lag_s is None else dict(zip(("median", "95 %", "most"), flight.lag_s, strict=True)),
        "mapped_cells": None if flight.dem is None else int(flight.dem.filled.sum()),
        "notices": flight.notices,
        "messages": flight.messages,
    }


def _sentences(flight: LiveFlight) -> Iterable[str]:
    yield f"{flight.flown_s:.1f} s flown in {flight.wall_s:.1f} s: {flight.pulses:,} pulses, {flight.echoes:,} echoes"
    if flight.lag_s is not None:
        yield "lag {:.0f} ms in the median, {:.0f} ms for 95 %, {:.0f} ms at most".format(
            *(1e3 * s for s in flight.lag_s)
        )
    if flight.dem is not None:
        yield f"DEM: {int(flight.dem.filled.sum()):,} cells of {flight.dem.grid.spacing_m:g} m"
    for notice, count in flight.notices.items():
        yield f"{count} x: {notice}"
    if flight.messages:
        yield "messages: " + ", ".join(f"{count:,} {kind}" for kind, count in sorted(flight.messages.items()))


def _write_map(flight: LiveFlight, folder: Path) -> None:
    if flight.dem is not None:
        flight.dem.to_geotiff(folder / "dem.tif")
    if flight.sigma is not None:
        flight.sigma.to_geotiff(folder / "dem_sigma.tif")


DOCUMENT = StudyDocument[LiveFlight](
    marker="live.json", suffix="_live", numbers=live_numbers, lines=_sentences, files=(_write_map,)
)
