"""The gamma engine: the paper's own facet model, one scatterer on every facet that the beam meets.

Rouveure et al. 2017, section 3: the surface is a set of facets; each that is seen from the radar inside the
antenna's footprint is one scatterer of cross-section sigma0 A, and the echo is their coherent sum. Geometry,
index, amplitudes and phases are NumPy and SciPy, nothing comes from Sionna. The shadow test alone is shared:
it asks the scene's `RayCaster`, that is Mitsuba's ray casting, whether a facet's centre is seen.

Footprint: the directions where the outer envelope of the two-way pattern is above `FOOTPRINT_DB` of its peak.
With side lobes of -20 dB what lies outside holds less than 0.001 dB of the echo of a uniform surface, and
less than 0.05 dB of it where everything outside is 20 dB brighter than all inside.

Polarisation: a facet scatters by the whole matrix of its material, in its own plane of incidence; see
`facet_scattering`.

Facets coarse against the beam or the range cell are divided until they are fine enough. With
persistent speckle a scatterer's phase depends on the seed and on the facet's place in the scene, so it is the same
from pulse to pulse, and with delays from float64 positions the phase history of the echo is that of a real, still
surface; otherwise every pulse draws its own. Nearer than 7.5
range cells over the beamwidth (64 m for 2 deg and 0.3 m) the division depends on the distance: a facet whose
division changes takes new phases there, as another surface would.
"""

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from jaxtyping import Bool, Complex, Float, Int, UInt64
from scipy.constants import speed_of_light
from scipy.spatial import KDTree

from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.radar.antenna import Antenna, Cut
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.model import Scene, Surface
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.engines.facet_scattering import FacetScattering
from sionna_radar.tracing.paths import Paths

FOOTPRINT_DB = -50.0
# Longest side of a facet: this share of the half-power footprint, and so many range cells. Straight down,
# where the footprint is smallest, the echo of a plane is then within 0.03 dB of the integral.
BEAM_SHARE = 1 / 3
RANGE_CELLS = 2.5
FINEST_M = 1e-3
# Facets up to so many times too long are divided in one step.
MOST_PARTS = 4
FIRST_STEP = np.ones(1, dtype=np.uint64)
# A facet's centre lies on the mesh that it is tested against, to within the float32 of the ray caster.
SHADOW_TOLERANCE_M = 0.01
GROUP = 64
RAYS_AT_ONCE = 1_000_000


@dataclass(frozen=True, kw_only=True)
class Facets:
    """Triangles with the identity that their phases depend on, and the surface that each belongs to."""

    corner_m: Float[np.ndarray, "facet 3 3"]
    identity: UInt64[np.ndarray, " facet"]
    surface: Int[np.ndarray, " facet"]

    def __len__(self) -> int:
        return len(self.identity)

    @property
    def centre_m(self) -> Float[np.ndarray, "facet 3"]:
        """Centroids."""
        return (self.corner_m[:, 0] + self.corner_m[:, 1] + self.corner_m[:, 2]) / 3

    @property
    def squared_side_m2(self) -> Float[np.ndarray, "facet 3"]:
        """Squared lengths of the sides from each corner to the next."""
        side = self.corner_m[:, [1, 2, 0]] - self.corner_m
        return np.einsum("fsi,fsi->fs", side, side)

    def take(self, chosen: Int[np.ndarray, " n"] | Bool[np.ndarray, " facet"]) -> "Facets":
        """Return some of the facets."""
        return Facets(corner_m=self.corner_m[chosen], identity=self.identity[chosen], surface=self.surface[chosen])

    def halved(self) -> "Facets":
        """Return both halves of every facet, cut from the middle of its longest side to its third corner."""
        first = np.argmax(self.squared_side_m2, axis=1)
        turned = (first[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(self.corner_m[np.arange(len(self))[:, None], turned], 1, 0)
        middle = (a + b) / 2
        left, right = np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)
        return Facets(
            corner_m=np.concatenate([left, right]),
            identity=_split_mix(self.identity, np.array([[1], [2]], dtype=np.uint64)).ravel(),
            surface=np.tile(self.surface, 2),
        )

    def divided(self, parts: int) -> "Facets":
        """Return every facet as parts^2 equal facets of its own shape, each side cut into that many parts."""
        a, b, c = np.moveaxis(self.corner_m, 1, 0)
        weight = _lattice(parts)
        corner = np.multiply.outer(weight[:, :, 0], a) + np.multiply.outer(weight[:, :, 1], b)
        corner += np.multiply.outer(weight[:, :, 2], c)
        # The first two steps are those of the halves.
        step = np.arange(3, 3 + len(weight), dtype=np.uint64)
        return Facets(
            corner_m=corner.transpose(0, 2, 1, 3).reshape(-1, 3, 3),
            identity=_split_mix(self.identity, step[:, None]).ravel(),
            surface=np.tile(self.surface, len(weight)),
        )

    @staticmethod
    def concatenate(tables: Sequence["Facets"]) -> "Facets":
        """Return all facets of some tables, in order."""
        return Facets(
            corner_m=np.concatenate([t.corner_m for t in tables]),
            identity=np.concatenate([t.identity for t in tables]),
            surface=np.concatenate([t.surface for t in tables]),
        )


@functools.cache
def _lattice(parts: int) -> Float[np.ndarray, "piece corner 3"]:
    """Return the barycentric coordinates of the pieces of a triangle, wound as the whole is."""
    pieces = []
    for i in range(parts):
        for j in range(parts - i):
            pieces.append([(i, j), (i + 1, j), (i, j + 1)])
            if i + j < parts - 1:
                pieces.append([(i + 1, j + 1), (i, j + 1), (i + 1, j)])
    share = np.array(pieces) / parts
    return np.concatenate([1 - share.sum(axis=2, keepdims=True), share], axis=2)


def facets_of(surfaces: Sequence[Surface]) -> Facets:
    """Return the triangles of some surfaces, numbered through."""
    count = sum(len(s.faces) for s in surfaces)
    return Facets(
        corner_m=np.concatenate([s.vertices_m[s.faces].astype(np.float64) for s in surfaces]),
        identity=np.arange(count, dtype=np.uint64),
        surface=np.repeat(np.arange(len(surfaces)), [len(s.faces) for s in surfaces]),
    )


@dataclass(frozen=True)
class Footprint:
    """The directions that count, as outer envelopes of the two cuts over the size of the direction cosine.

    An envelope is the largest voltage that far or farther from the middle, over the cut's peak, so it never
    rises outward: no side lobe beyond it is missed, and a nearest direction stands for a whole ball.
    """

    azimuth: Float[np.ndarray, " m"]
    elevation: Float[np.ndarray, " n"]
    least_voltage: float

    @staticmethod
    def of(antenna: Antenna, level_db: float = FOOTPRINT_DB) -> "Footprint":
        """Return the footprint of an antenna down to a two-way level over the peak."""
        cuts = _envelope(antenna.azimuth), _envelope(antenna.elevation)
        return Footprint(*cuts, least_voltage=10 ** (level_db / 40))

    def meets(
        self, ahead_m: Float[np.ndarray, "n 3"], radius_m: Float[np.ndarray, " n"] | float
    ) -> Bool[np.ndarray, " n"]:
        """Tell which balls reach into the footprint, by their centres in the antenna's frame."""
        x, left, up = ahead_m.T
        distance = np.maximum(np.sqrt(x * x + left * left + up * up), 1e-9)
        sine = np.minimum(radius_m / distance, 1.0)
        # Farthest that a direction into the ball lies from the direction to its centre (a chord).
        reach = np.sqrt(2 - 2 * np.sqrt(1 - sine * sine))
        voltage = _outside(self.azimuth, np.abs(left) / distance - reach)
        voltage *= _outside(self.elevation, np.abs(up) / distance - reach)
        inside = (voltage >= self.least_voltage) & (x / distance > -reach)
        return inside | (radius_m >= distance)


def _envelope(cut: Cut) -> Float[np.ndarray, " n"]:
    size = np.abs(cut.voltage)
    middle = len(size) // 2
    folded = np.maximum(size[middle:], size[: len(size) - middle][::-1])
    return np.maximum.accumulate(folded[::-1])[::-1] / folded.max()


def _outside(envelope: Float[np.ndarray, " m"], cosine: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    cell = (np.clip(cosine, 0.0, 1.0) * (len(envelope) - 1)).astype(np.int64)
    return envelope[cell]


class FacetIndex:
    """Balls around facets, around groups of them, around groups of groups, up to a handful at the top.

    The facets stand in the order of a KD-tree's leaves, so neighbours in the table are neighbours in space.
    """

    def __init__(self, facets: Facets) -> None:
        tree = KDTree(facets.centre_m, leafsize=GROUP)
        self.facets = facets.take(tree.indices)
        centre = self.facets.centre_m
        radius = np.sqrt(((self.facets.corner_m - centre[:, None]) ** 2).sum(axis=2).max(axis=1))
        self._centre, self._radius = [centre], [radius]
        low, high = self.facets.corner_m.min(axis=1), self.facets.corner_m.max(axis=1)
        while len(low) > GROUP:
            start = np.arange(0, len(low), GROUP)
            low, high = np.minimum.reduceat(low, start), np.maximum.reduceat(high, start)
            self._centre.append((low + high) / 2)
            self._radius.append(np.sqrt(((high - low) ** 2).sum(axis=1)) / 2)

    def search(
        self,
        footprint: Footprint,
        position_m: Float[np.ndarray, " 3"],
        R_world_antenna: Float[np.ndarray, "3 3"],
    ) -> Facets:
        """Return the facets whose balls reach into the footprint of a pose."""
        place = np.arange(len(self._centre[-1]))
        for level in range(len(self._centre) - 1, -1, -1):
            ahead = (self._centre[level][place] - position_m) @ R_world_antenna
            place = place[footprint.meets(ahead, self._radius[level][place])]
            if level > 0:
                place = (place[:, None] * GROUP + np.arange(GROUP)).ravel()
                place = place[place < len(self._centre[level - 1])]
        return self.facets.take(place)


@dataclass(frozen=True, kw_only=True)
class _Scatterers:
    """The facets of one pulse that would echo if nothing stood before them.

    gain: amplitude of each echo, with the phase of its scattering matrix alone.
    """

    gain: Complex[np.ndarray, " facet"]
    range_m: Float[np.ndarray, " facet"]
    away_m: Float[np.ndarray, "facet 3"]
    cos_incidence: Float[np.ndarray, " facet"]
    identity: UInt64[np.ndarray, " facet"]
    surface: Int[np.ndarray, " facet"]


class GammaEngine:
    """Traces pulses over facets; see the module's text.

    Parameters
    ----------
    scene, antenna, chirp:
        What is seen, with what.
    seed:
        Rules the phases of the facets.
    caster:
        Rays against the scene's surfaces, for the shadows.
    footprint_db:
        Two-way level over the peak down to which the beam counts.
    beam_share, range_cells:
        Longest side of a facet, in half-power widths of the beam on the spot and in range resolutions.
    speckle:
        Whether the phases of the facets stay ("persistent") or every pulse draws its own ("per_pulse").

    """

    def __init__(
        self,
        scene: Scene,
        antenna: Antenna,
        chirp: Chirp,
        seed: int,
        caster: RayCaster,
        *,
        footprint_db: float = FOOTPRINT_DB,
        beam_share: float = BEAM_SHARE,
        range_cells: float = RANGE_CELLS,
        speckle: Literal["per_pulse", "persistent"] = "persistent",
    ) -> None:
        self._index = FacetIndex(facets_of(scene.surfaces))
        self._footprint = Footprint.of(antenna, footprint_db)
        self._antenna, self._wavelength_m, self._caster = antenna, chirp.wavelength_m, caster
        self._side_per_metre = beam_share * min(antenna.beamwidths_rad)
        self._longest_side_m = range_cells * chirp.range_resolution_m
        self._scattering = FacetScattering(scene, antenna)
        self._speckle = speckle
        self._key = _split_mix(np.array([seed], dtype=np.uint64), FIRST_STEP)

    def trace(self, pulses: Pulses) -> Paths:
        """Return the paths of a block of pulses, one for each facet seen."""
        return Paths.concatenate([self._visible(pulses, *batch) for batch in self._batches(pulses)])

    def _batches(self, pulses: Pulses) -> Iterator[tuple[list[int], list[_Scatterers]]]:
        """Yield rows of the block with their scatterers, few enough of them for one wave of rays."""
        rows: list[int] = []
        found: list[_Scatterers] = []
        for row in range(len(pulses)):
            rows.append(row)
            found.append(self._scatterers(pulses.true, row))
            if sum(len(f.gain) for f in found) > RAYS_AT_ONCE:
                yield rows, found
                rows, found = [], []
        if rows:
            yield rows, found

    def _scatterers(self, pose: Pose, row: int) -> _Scatterers:
        """Return the facets in the footprint of one pulse that face the radar.

        Their power is G^2 lambda^2 sigma0 A / ((4 pi)^3 r^4) (Rouveure et al. 2017, eq. 4 and 5).
        """
        position, R_world_antenna = pose.position_m[row], pose.R_world_antenna[row]
        facets = self._subdivided(position, R_world_antenna)
        away = facets.centre_m - position
        range_m = np.sqrt(np.einsum("fi,fi->f", away, away))
        corner = facets.corner_m
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        twice_area = np.sqrt(np.einsum("fi,fi->f", normal, normal))
        toward = -np.einsum("fi,fi->f", normal, away)
        facing = np.flatnonzero(toward > 0)
        away, range_m, twice_area = away[facing], range_m[facing], twice_area[facing]
        direction = away / range_m[:, None]
        antenna_gain = self._antenna.gain(direction @ R_world_antenna)
        amplitude = self._scattering.amplitude(
            direction,
            normal[facing] / twice_area[:, None],
            facets.surface[facing],
            facets.identity[facing],
            R_world_antenna,
        )
        spread = antenna_gain * self._wavelength_m * np.sqrt(twice_area / 2) / ((4 * np.pi) ** 1.5 * range_m**2)
        return _Scatterers(
            gain=spread * amplitude,
            range_m=range_m,
            away_m=away,
            cos_incidence=np.minimum(toward[facing] / (twice_area * range_m), 1.0),
            identity=facets.identity[facing],
            surface=facets.surface[facing],
        )

    def _subdivided(self, position_m: Float[np.ndarray, " 3"], R_world_antenna: Float[np.ndarray, "3 3"]) -> Facets:
        """Return the facets whose centres lie in the footprint, the coarse ones divided until they are fine."""
        facets = self._index.search(self._footprint, position_m, R_world_antenna)
        fine = []
        while len(facets):
            away = facets.centre_m - position_m
            side = np.sqrt(facets.squared_side_m2.max(axis=1))
            longest = np.minimum(self._side_per_metre * np.sqrt((away**2).sum(axis=1)), self._longest_side_m)
            parts = np.ceil(side / np.maximum(longest, FINEST_M)).astype(np.int64)
            # No point of a triangle lies farther from its centroid than two thirds of the longest side.
            radius = np.where(parts > 1, 2 / 3 * side, 0.0)
            met = self._footprint.meets(away @ R_world_antenna, radius)
            fine.append(facets.take(met & (parts == 1)))
            few = met & (parts > 1) & (parts <= MOST_PARTS)
            for count in np.unique(parts[few]):
                pieces = facets.take(few & (parts == count)).divided(int(count))
                fine.append(self._centred(pieces, position_m, R_world_antenna))
            # What the beam misses of far too long ones is dropped before they are divided at once.
            facets = facets.take(met & (parts > MOST_PARTS)).halved()
        return Facets.concatenate(fine) if fine else facets

    def _centred(
        self, facets: Facets, position_m: Float[np.ndarray, " 3"], R_world_antenna: Float[np.ndarray, "3 3"]
    ) -> Facets:
        """Return the facets whose centres lie in the footprint."""
        return facets.take(self._footprint.meets((facets.centre_m - position_m) @ R_world_antenna, 0.0))

    def _visible(self, pulses: Pulses, rows: list[int], found: list[_Scatterers]) -> Paths:
        """Return the paths of scatterers that nothing hides."""
        row = np.repeat(np.array(rows, dtype=np.int64), [len(f.gain) for f in found])
        column = {field.name: np.concatenate([getattr(f, field.name) for f in found]) for field in fields(_Scatterers)}
        origin, velocity = pulses.true.position_m[row], pulses.true.velocity_mps[row]
        point = origin + column["away_m"]
        seen = column["gain"] != 0
        if seen.any():
            seen[seen] = self._caster.visible(origin[seen], point[seen], SHADOW_TOLERANCE_M)
        phase = 2 * np.pi * self._turn(column["identity"][seen], pulses.index[row[seen]])
        turn = np.empty(len(phase), dtype=np.complex128)
        turn.real, turn.imag = np.cos(phase), np.sin(phase)
        range_m = column["range_m"][seen]
        return Paths(
            pulse=pulses.index[row[seen]],
            delay_s=2 * range_m / speed_of_light,
            gain=column["gain"][seen] * turn,
            range_rate_mps=-np.einsum("fi,fi->f", velocity[seen], column["away_m"][seen]) / range_m,
            incidence_rad=np.arccos(column["cos_incidence"][seen]),
            hit_m=point[seen],
            surface=column["surface"][seen],
        )

    def _turn(
        self, identity: UInt64[np.ndarray, " path"], pulse: Int[np.ndarray, " path"]
    ) -> Float[np.ndarray, " path"]:
        """Return the phase of each facet at each pulse, in turns."""
        state = identity ^ self._key
        if self._speckle == "per_pulse":
            state = _split_mix(state, pulse.astype(np.uint64) + np.uint64(1))
        return _unit(state)


def _split_mix(state: UInt64[np.ndarray, "..."], step: UInt64[np.ndarray, "..."]) -> UInt64[np.ndarray, "..."]:
    """Return the numbers that SplitMix64 yields at some steps from some states.

    Source: Steele, Lea and Flood 2014, "Fast splittable pseudorandom number generators"; the constants are
    those of Vigna's public-domain splitmix64.c.
    """
    z = state + step * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def _unit(identity: UInt64[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return a number in [0, 1) for each identity."""
    return (_split_mix(identity, FIRST_STEP) >> np.uint64(11)).astype(np.float64) * 2.0**-53
