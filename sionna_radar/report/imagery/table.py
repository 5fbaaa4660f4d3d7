"""The resolutions of a side-looking survey's images, for the terminal."""

from rich.table import Table

from sionna_radar.report.terminal import console
from sionna_radar.studies.images import Imagery, Response


def print_image(imagery: Imagery) -> None:
    """Print the resolution of the images: in theory in the middle of the beam, and as measured at point targets."""
    out = console()
    out.print(image_table(imagery))
    if imagery.focused is None:
        out.print(
            "no focused image because scatterers change from pulse to pulse; set tracing.speckle = 'persistent'",
            soft_wrap=True,
        )


def image_table(imagery: Imagery) -> Table:
    """Return the half-power widths of the images and of point targets in them."""
    table = Table(title="Half-power widths", title_justify="left")
    for name in ("", "along the track", "across it"):
        table.add_column(name, justify="left" if name == "" else "right")
    table.add_row("SLAR, theory", f"{imagery.slar.along_m:.2f} m", f"{imagery.slar.across_m:.2f} m slant range")
    if imagery.sar:
        table.add_row(
            "SAR, theory", f"{1e3 * imagery.sar.along_m:.1f} mm", f"{imagery.sar.across_m:.2f} m ground range"
        )
    for number, reflector in enumerate(imagery.reflectors):
        for name, response in (("SLAR", reflector.slar), ("SAR", reflector.sar)):
            if response is not None and response.measured is not None:
                table.add_row(f"{name}, targets.{number}", *_compared(response))
    return table


def _compared(response: Response) -> tuple[str, str]:
    measured, theory = response.measured, response.theory
    if measured is None:
        return "", ""
    along = measured.along_m / theory.along_m
    across = measured.across_m / theory.across_m
    return f"{along:.2f} of theory", f"{across:.2f} of theory"
