"""The table of range-Doppler maps, for the terminal."""

from rich.table import Table

from sionna_radar.report.terminal import console, number
from sionna_radar.studies.range_doppler import Frames


def print_frames(frames: Frames) -> None:
    """Print the cells of the maps, and where the targets of the scenario were found."""
    out, analyser = console(), frames.analyser
    out.print(
        f"{frames.frames} frames of {analyser.chirps} chirps: cells of {frames.last.chirp.range_resolution_m:.3g} m "
        f"and {analyser.rate_cell_mps:.3g} m/s, range rates up to {analyser.highest_rate_mps:.3g} m/s",
        soft_wrap=True,
    )
    out.print(
        f"windows: {analyser.noise_loss_db:.2f} dB against noise, at worst {analyser.straddling_loss_db:.2f} dB "
        "between cells",
        soft_wrap=True,
    )
    out.print(f"still ground in the beam changes by {frames.smear_cells:.2g} cells of range rate during a frame")
    out.print(
        f"detected: {frames.detected.mean():.3%} of the cells over their ring, {frames.changed.mean():.3%} over "
        f"earlier frames; {len(frames.movers)} peaks",
        soft_wrap=True,
    )
    if frames.targets:
        out.print(targets_table(frames))


def targets_table(frames: Frames) -> Table:
    """Return where the targets of the scenario are, and where peaks were found."""
    table = Table(title="Targets in the last frame", title_justify="left")
    for name in ("target", "range\nm", "found\nm", "range rate\nm/s", "found\nm/s"):
        table.add_column(name, justify="right")
    for target in frames.targets:
        table.add_row(
            str(target.number),
            f"{target.range_m:.3f}",
            number(target.found_range_m, ".3f"),
            f"{target.range_rate_mps:.4f}",
            number(target.found_rate_mps, ".4f"),
        )
    return table
