"""Seeded detail below the spacing of an elevation file, for a surface that is not smooth between its posts.

The detail is a Gaussian surface whose power spectrum falls as k^-(2 H + 2), as that of natural terrain (a self-affine
surface of Hurst exponent H; Turcotte 1997, "Fractals and Chaos in Geology and Geophysics", ch. 7), from the wavelength
of two posts of the file down: what the file shows is left as it is. It depends on the place and the seed alone, and not
on the part of the terrain that is cut out.
"""

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.raster import Grid

# White noise is drawn in tiles of so many cells, each with a generator of its own.
TILE = 256
# The kernel that shapes it reaches so many posts of the file: less than 2e-5 of its energy lies beyond (computed for
# Hurst exponents of 0.2 to 0.95 and 2 to 20 cells a post).
REACH_POSTS, MOST_REACH = 6, 384


def detail_on(grid: Grid, post_m: float, hurst: float, rms_m: float, seed: int) -> Float[np.ndarray, "row column"]:
    """Return heights of the detail on a grid, of zero mean.

    Parameters
    ----------
    grid:
        The cells; a whole multiple of their spacing leads from one grid to another with the same detail.
    post_m:
        Spacing of the file: there is no detail at wavelengths above twice this.
    hurst, rms_m:
        Exponent, and root mean square of the detail.
    seed:
        Of the detail.

    Raises
    ------
    ScenarioError
        The grid is too coarse for any detail.

    """
    if grid.spacing_m > post_m / 2:
        message = (
            f"cells of {grid.spacing_m:g} m have no room for detail below the file's {post_m:.3g} m; set "
            f"terrain.spacing_m = {post_m / 4:.2g} or less"
        )
        raise ScenarioError([Problem("terrain.roughen", message)])
    kernel = _kernel(grid.spacing_m / post_m, hurst)
    reach = len(kernel) // 2
    # The map's own cells are counted from its origin, so that neighbouring cut-outs agree.
    column, row = (round(edge / grid.spacing_m) for edge in (grid.west_m, grid.south_m))
    noise = _noise(row - reach, column - reach, grid.rows + 2 * reach, grid.columns + 2 * reach, seed)
    # It takes as long to import as many a survey to simulate.
    from scipy.signal import fftconvolve

    shaped: Float[np.ndarray, "row column"] = fftconvolve(noise, kernel, mode="valid")
    return rms_m * shaped


def _kernel(cells_per_post: float, hurst: float) -> Float[np.ndarray, "k k"]:
    """Return the kernel that turns white noise of variance one into detail of variance one."""
    reach = min(MOST_REACH, int(np.ceil(REACH_POSTS / cells_per_post)))
    size = 2 * reach + 1
    wavenumber = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.fftfreq(size)[None])  # cycles per cell
    lowest = cells_per_post / 2
    with np.errstate(divide="ignore"):
        spectrum = np.where(wavenumber >= lowest, wavenumber ** -(hurst + 1), 0.0)
    # A sharp edge in the spectrum would ring far beyond the kernel.
    rise = np.clip(wavenumber / lowest - 1, 0.0, 1.0)
    spectrum *= np.sin(np.pi / 2 * rise) ** 2
    kernel = np.fft.fftshift(np.fft.ifft2(spectrum).real)
    taper = np.hanning(size + 2)[1:-1]
    kernel = kernel * np.outer(taper, taper)
    return kernel / np.sqrt((kernel**2).sum())


def _noise(row: int, column: int, rows: int, columns: int, seed: int) -> Float[np.ndarray, "row column"]:
    """Return white noise at cells of an endless plane, from the tiles that they lie in."""
    first, last = (row // TILE, column // TILE), ((row + rows - 1) // TILE, (column + columns - 1) // TILE)
    whole = np.empty(((last[0] - first[0] + 1) * TILE, (last[1] - first[1] + 1) * TILE), dtype=np.float32)
    for i in range(first[0], last[0] + 1):
        for j in range(first[1], last[1] + 1):
            generator = np.random.default_rng([seed, i + 2**31, j + 2**31])
            place = (i - first[0]) * TILE, (j - first[1]) * TILE
            whole[place[0] : place[0] + TILE, place[1] : place[1] + TILE] = generator.standard_normal(
                (TILE, TILE), dtype=np.float32
            )
    top, left = row - first[0] * TILE, column - first[1] * TILE
    return whole[top : top + rows, left : left + columns].astype(np.float64)
