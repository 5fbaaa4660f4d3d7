"""Evidence of whole echoes for a layer of plants over the ground: the likelihood of both of its heights.

The mean profile of a layer is a sum over heights. Let b(u) be the profile of a surface at the height u over a reference
surface: that of the reference, moved by u times the change of its range with height. With the ground at g, the top at
t, the incidence i, the layer's extinction k (of power, one way, 1/m), the share c of the footprint that plants cover
and the backscatter a of a deep layer over that of the ground,

    mu = n + A [(1 - c + c T(g)) b(g) + a c int_g^t 2 k / cos i T(u) b(u) du],   T(u) = exp(-2 k (t - u) / cos i),

the water-cloud model (Attema and Ulaby 1978), resolved in range, with gaps. Between gaps as wide as plants are tall a
ray passes 1 + tan i of them, so that of the gaps seen straight down, 1 - c_0, there remain (1 - c_0)^(1 + tan i): the
binomial model of Nilson 1971 ("A theoretical analysis of the frequency of gaps in plant stands"). The level A of each
echo is fitted, so that reflectivity need not be known. Powers are exponential about mu, as everywhere in
`inference.echo`.
"""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Float32

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.numerics import MAX_SPECKLE
from sionna_radar.foundation.threads import over_rows
from sionna_radar.inference.echo.kernels import BEYOND
from sionna_radar.inference.echo.likelihood import Sightings, footprints, spline_taps
from sionna_radar.inference.echo.power_kernels import beam_samples, spread_power

# Shifts of a template within a range cell; between two of them it is linear.
SHIFTS = 4
# Power that no layer explains, relative to the strongest cell of an echo: side lobes, few scatterers.
PEDESTAL = 2e-3
LEVEL_STEPS = 2


@dataclass(frozen=True, kw_only=True)
class LayerType:
    """Plants of one kind.

    extinction_per_m: one way, of power; cover: share of the ground under them, seen straight down.
    backscatter: sigma0 of a deep stand over that of the ground; clear_m: height of the lowest leaves.
    """

    extinction_per_m: float
    cover: float
    backscatter: float
    clear_m: float = 0.0


@dataclass(frozen=True, kw_only=True)
class LayerHeights:
    """The heights, over the reference surface, that are tried for the ground and for the top: `low_m`, step, count."""

    low_m: float
    step_m: float
    count: int

    @property
    def height_m(self) -> Float[np.ndarray, " height"]:
        """All heights."""
        return self.low_m + self.step_m * np.arange(self.count)


def layer_evidence(
    sightings: Sightings,
    surface: Heightfield,
    looks: Float[np.ndarray, " pulse"],
    heights: LayerHeights,
    types: "tuple[LayerType, ...]",
    grounds: int,
    thickest: int,
) -> Float32[np.ndarray, "pulse type ground thickness"]:
    """Return the log-likelihood of each pulse's profile, in nepers, over that of noise alone.

    surface: the reference.
    looks: independent looks in a range cell.
    grounds: of the heights, the lowest so many are tried for the ground.
    thickest: of the layer, in steps of the heights; thickness 0 is bare ground. -inf where the top is beyond all.
    """
    feet, profiles = footprints(sightings, surface), sightings.profiles
    out = np.full((len(sightings), len(types), grounds, thickest + 1), -np.inf, dtype=np.float32)
    table = np.array([[t.extinction_per_m, t.cover, t.backscatter, t.clear_m] for t in types]).reshape(-1, 4)
    background = profiles.noise[np.repeat(np.arange(len(profiles)), np.diff(profiles.start))]
    if profiles.volume is not None:
        background = background + profiles.volume.power * profiles.volume.in_air
    data = profiles.first, profiles.start, profiles.power, background.astype(np.float64), looks, profiles.cell_m
    beam = sightings.beam.power, sightings.beam.lattice, spline_taps(sightings.response)
    grid = heights.low_m, heights.step_m, heights.count

    def some(low: int, high: int) -> None:
        evidence(low, high, data, (feet.range_m, feet.shift_m, feet.range_per_height), beam, grid, table, out)

    over_rows(some, len(sightings))
    return out


@compiled
@no_type_check
def evidence(low, high, data, geometry, antenna, heights, types, out):
    """Write the log-likelihoods of the pulses from `low` to `high`; see `layer_evidence`."""
    first, start, powers, backgrounds, looks, cell_m = data
    range_m, shift, per_height = geometry
    share, lattice, taps = antenna
    samples = len(share)
    cell, near, inverse = np.empty(samples), np.empty(samples), np.empty(range_m.shape[1])
    for pulse in range(low, high):
        cells = start[pulse + 1] - start[pulse]
        power = np.empty(cells)
        background = np.empty(cells)
        peak = 0.0
        for c in range(cells):
            power[c] = powers[start[pulse] + c]
            background[c] = backgrounds[start[pulse] + c]
            peak = max(peak, power[c])
        rate, met = 0.0, 0
        for node in range(range_m.shape[1]):
            if not np.isnan(range_m[pulse, node]):
                rate -= per_height[pulse, node]
                met += 1
        if met == 0:
            out[pulse] = 0.0
            continue
        rate /= met
        beam_samples(range_m[pulse], shift[pulse], lattice, cell_m, 0.0, cell, near, inverse)
        middle = 0.0
        for k in range(samples):
            if not np.isnan(near[k]):
                middle = max(middle, near[k])
        lit = share * (near / middle) ** 2
        slices = _slices(lit, cell, first[pulse], cells, taps, heights, rate, cell_m)
        _fit_layers(power, background, peak, slices, heights[1], rate, types, looks[pulse], out[pulse])


@compiled
@no_type_check
def _slices(lit, cell, first, cells, taps, heights, rate, cell_m):
    """Return the profiles of surfaces at all heights.

    lit, cell: power of the samples of the beam, and their range cells. rate: decrease of the range with the height.
    """
    lowest, step, count = heights
    half = len(taps) // 2
    # Heights move templates by at most this many cells.
    highest = lowest + step * (count - 1)
    margin = int(np.ceil(max(abs(lowest), abs(highest)) * rate / cell_m)) + 2
    wide = cells + 2 * margin
    pad = half + BEYOND
    hit = np.zeros(wide + 2 * pad)
    template = np.zeros((SHIFTS, wide))
    for m in range(SHIFTS):
        spread_power(lit, cell + m / SHIFTS, float(first - margin), wide, pad, hit)
        for c in range(wide):
            total = 0.0
            for tap in range(len(taps)):
                total += taps[tap] * hit[c + pad + half - tap]
            template[m, c] = max(total, 0.0)
    # Raising a surface by u shortens its ranges by rate * u.
    slices = np.empty((count, cells))
    for k in range(count):
        moved = -(lowest + step * k) * rate / cell_m * SHIFTS
        below = int(np.floor(moved))
        part = moved - below
        one_cell, one = below // SHIFTS, below % SHIFTS
        two_cell, two = (below + 1) // SHIFTS, (below + 1) % SHIFTS
        for c in range(cells):
            slices[k, c] = (1 - part) * template[one, c + margin - one_cell] + part * template[
                two, c + margin - two_cell
            ]
    return slices


@compiled
@no_type_check
def _fit_layers(power, background, peak, slices, step, slant, types, looks, out):
    """Write the log-likelihoods of a pulse, by type, ground and thickness; the pedestal is added to the background.

    slices: profiles of surfaces, `step` apart in height; slant: path in a layer over its thickness.
    """
    count, cells = slices.shape
    # Cells that no height reaches say nothing.
    begin, end = cells, 0
    for c in range(cells):
        most = 0.0
        for k in range(count):
            most = max(most, slices[k, c])
        if most > 0.0:
            begin, end = min(begin, c), c + 1
    floor, without, total = PEDESTAL * peak, 0.0, 0.0
    for c in range(begin, end):
        background[c] += floor
        total += max(power[c] - background[c], 0.0)
        without += _loss(power[c], background[c])
    layer, shape = np.empty(cells), np.empty(cells)
    for kind in range(len(types)):
        loss = np.exp(-2 * types[kind, 0] * step * slant)
        cover = 1 - (1 - types[kind, 1]) ** (1 + np.sqrt(max(slant**2 - 1, 0.0)))
        bright, clear = types[kind, 2] * cover, types[kind, 3]
        for ground in range(out.shape[1]):
            layer[:] = 0.0
            passed, level = 1.0, -1.0
            for thickness in range(min(out.shape[2], count - ground)):
                if 0 < thickness <= clear / step:
                    out[kind, ground, thickness] = -1e30
                    continue
                if thickness > 0:
                    # One more slice on the top, which dims all below it.
                    passed *= loss
                    above, under = slices[ground + thickness], slices[ground + thickness - 1]
                    for c in range(begin, end):
                        layer[c] = layer[c] * loss + (0.5 - 0.5 * loss) * (above[c] + under[c])
                elif kind > 0:
                    out[kind, ground, 0] = out[0, ground, 0]
                    continue
                of_ground, unit = 1 - cover + cover * passed if thickness > 0 else 1.0, 0.0
                for c in range(begin, end):
                    shape[c] = of_ground * slices[ground, c] + bright * layer[c]
                    unit += shape[c]
                if level < 0.0 and unit > 0.0:
                    level = total / unit
                value, level = _fit_level(power, background, shape, begin, end, peak, level, unit > 0.0)
                # A level of zero is noise alone.
                out[kind, ground, thickness] = max(without - value, 0.0) * looks


@compiled
@no_type_check
def _fit_level(power, background, shape, begin, end, peak, level, any_power):
    """Return the negative log-likelihood of a profile with its level fitted, and the level, which starts at `level`."""
    for _ in range(LEVEL_STEPS if any_power else 0):
        pull, weight = 0.0, 0.0
        for c in range(begin, end):
            part = 1 / (background[c] + level * shape[c])
            weight += shape[c] * part
            pull += shape[c] * part * min(power[c] * part, MAX_SPECKLE)
        level *= max(pull / weight, 1e-3)
    value, product = 0.0, 1.0
    for c in range(begin, end):
        mean = background[c] + level * shape[c]
        ratio = power[c] / mean
        if ratio > MAX_SPECKLE:
            ratio = MAX_SPECKLE * (1 + np.log(ratio / MAX_SPECKLE))
        value += ratio
        # One logarithm for several cells: their product stays in range.
        product *= mean / peak
        if not 1e-200 < product < 1e200:
            value += np.log(product)
            product = 1.0
    return value + (np.log(product) + (end - begin) * np.log(peak)), level


@compiled
@no_type_check
def _loss(power, mean):
    """Return minus the log-density of a power, in nepers: a glint counts by its logarithm."""
    ratio = power / mean
    if ratio > MAX_SPECKLE:
        ratio = MAX_SPECKLE * (1 + np.log(ratio / MAX_SPECKLE))
    return ratio + np.log(mean)
