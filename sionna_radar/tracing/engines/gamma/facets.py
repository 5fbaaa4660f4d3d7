"""The gamma engine: the paper's facet model, one scatterer on every facet in the beam.

Rouveure et al. 2017, section 3: the surface is a set of facets; each facet visible to the radar inside the
antenna's footprint is one scatterer of cross-section sigma0 A, and the echo is their coherent sum. Geometry,
index, amplitudes and phases use NumPy, SciPy and machine code of their own, not Sionna. Only the shadow test is shared:
the scene's `RayCaster` (Mitsuba's ray casting) determines whether a facet's centre is visible.

Footprint: the directions where the outer envelope of the two-way pattern is above `FOOTPRINT_DB` of its peak.
With side lobes of -20 dB the directions outside contribute less than 0.001 dB to the echo of a uniform surface, and
less than 0.05 dB where everything outside is 20 dB brighter than everything inside.

Polarization: a facet scatters by the full matrix of its material, in its own plane of incidence; see
`facet_mesh`.

Facets too coarse for the beam or the range cell are divided until they are fine enough. With
persistent speckle a scatterer's phase depends on the seed and on the facet's position in the scene, so it is the same
from pulse to pulse, and with delays from float64 positions the phase history of the echo is that of a real, stationary
surface; otherwise every pulse draws new phases. Nearer than 7.5
range cells over the beamwidth (64 m for 2 deg and 0.3 m) the division depends on the distance: a facet whose
division changes gets new phases there, like a different surface.
"""

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
from jaxtyping import Complex, Float, Int, UInt64

from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.randomness import FIRST_STEP, split_mix, unit_of
from sionna_radar.foundation.threads import chunks, in_threads
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.model import Scene
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.engines.gamma.facet_index import FOOTPRINT_DB, FacetIndex, Fineness, Footprint
from sionna_radar.tracing.engines.gamma.facet_mesh import Facets, FacetScatterers, FacetScattering, facets_of
from sionna_radar.tracing.paths import Paths, wander_hz

# Longest side of a facet: this share of the half-power footprint, and this many range cells. At nadir,
# where the footprint is smallest, the echo of a plane is then within 0.03 dB of the integral.
BEAM_FRACTION = 1 / 3
RANGE_CELLS = 2.5
# Facets up to this many times too long are divided in one step.
MAX_PARTS = 4
# A facet's centre lies on the mesh it is tested against, to within the float32 precision of the ray caster.
SHADOW_TOLERANCE_M = 0.01
RAYS_AT_ONCE = 1_000_000
# A wavefront is of at most this many times as many pulses as the one before it.
GROWTH = 8
# Of one thread: few enough for its cache.
PULSES_AT_ONCE, ROWS_AT_ONCE = 16, 16384
# Draws a facet's Doppler shift apart from its phases, whose steps are the numbers of pulses.
WANDER_STEP = np.array([2**63], dtype=np.uint64)
# Of one thread: a gigabyte.
MAX_FACETS = 5_000_000


class _TooManyError(Exception):
    """More facets than memory is meant for."""


@dataclass(frozen=True, kw_only=True)
class _Echoes(Columns):
    """The echoes of facets if none were occluded, sorted by pulse.

    row: of the pulse in its block.
    gain: amplitude of each echo, with only the phase of its scattering matrix.
    """

    row: Int[np.ndarray, " facet"]
    gain: Complex[np.ndarray, " facet"]
    place_m: Float[np.ndarray, "facet 3"]
    cos_incidence: Float[np.ndarray, " facet"]
    identity: UInt64[np.ndarray, " facet"]
    surface: Int[np.ndarray, " facet"]


class GammaEngine:
    """Traces pulses over facets; see the module docstring.

    scene, antenna, chirp: the scene, and the radar that sees it.
    seed: determines the phases of the facets, and the signs of their scattering matrices.
    caster: rays against the scene's surfaces, for the shadows.
    footprint_db: two-way level relative to the peak down to which the beam counts.
    beam_fraction, range_cells: longest side of a facet, in local half-power widths of the beam and in range
        resolutions.
    speckle: whether phases and signs of the facets persist ("persistent") or every pulse draws new ones ("per_pulse").
    decorrelation_time_s: after which the field's correlation has fallen to 1 / e; None for a surface that stands still.
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
        beam_fraction: float = BEAM_FRACTION,
        range_cells: float = RANGE_CELLS,
        speckle: Literal["per_pulse", "persistent"] = "persistent",
        decorrelation_time_s: float | None = None,
    ) -> None:
        self._index = FacetIndex(facets_of(scene.surfaces))
        self._scene, self._footprint_db, self._beam_fraction = scene, footprint_db, beam_fraction
        self._two_sided = np.array([surface.two_sided for surface in scene.surfaces])
        self._footprint = Footprint.of(antenna, footprint_db)
        self._antenna, self._wavelength_m, self._caster = antenna, chirp.wavelength_m, caster
        self._fineness = Fineness(
            per_metre=beam_fraction * min(antenna.beamwidths_rad), longest_m=range_cells * chirp.range_resolution_m
        )
        self._scattering = FacetScattering(scene, antenna)
        self._speckle = speckle
        self._wander_hz = 0.0 if decorrelation_time_s is None else wander_hz(decorrelation_time_s)
        self._key = split_mix(np.array([seed], dtype=np.uint64), FIRST_STEP)

    def with_antenna(self, antenna: Antenna) -> "GammaEngine":
        """Return the engine with another antenna, over the same facets."""
        other = copy(self)
        other._antenna = antenna
        other._footprint = Footprint.of(antenna, self._footprint_db)
        other._fineness = replace(self._fineness, per_metre=self._beam_fraction * min(antenna.beamwidths_rad))
        other._scattering = FacetScattering(self._scene, antenna)
        return other

    def trace(self, pulses: Pulses) -> Paths:
        """Return the paths of a block of pulses, one for each facet seen."""
        return Paths.concatenate([self._visible(pulses, echoes) for echoes in self._wavefronts(pulses)])

    def _wavefronts(self, pulses: Pulses) -> Iterator[_Echoes]:
        """Yield the echoes of consecutive pulses, some `RAYS_AT_ONCE` at a time; their number changes no result."""
        low, count = 0, 1
        while low < len(pulses):
            count = min(count, len(pulses) - low)
            bounds = [(low + first, low + last) for first, last in chunks(count, PULSES_AT_ONCE)]
            echoes = _Echoes.concatenate(list(in_threads(partial(self._echoes, pulses), bounds)))
            yield echoes
            low += count
            # As many as before may come of each, or of the first of all, which may see little, some more.
            count = min(GROWTH * count, max(1, RAYS_AT_ONCE * count // max(len(echoes), 1)))

    def _echoes(self, pulses: Pulses, low: int, high: int) -> _Echoes:
        """Return the echoes of the facets that face the radar in the footprints of pulses from low to high."""
        try:
            return self._echoes_at_once(pulses, low, high)
        except _TooManyError:
            if high - low == 1:
                message = (
                    f"'gamma' divides the ground in one beam into more than {MAX_FACETS:,} facets; set 'sionna', or "
                    "give an antenna that sends less beside its beam"
                )
                raise ScenarioError.of("tracing.engine", message) from None
        middle = (low + high) // 2
        return _Echoes.concatenate([self._echoes(pulses, low, middle), self._echoes(pulses, middle, high)])

    def _echoes_at_once(self, pulses: Pulses, low: int, high: int) -> _Echoes:
        """Return the echoes as in `_echoes`; raises _TooManyError if there are too many.

        Their power is G^2 lambda^2 sigma0 A / ((4 pi)^3 r^4) (Rouveure et al. 2017, eq. 4 and 5).
        """
        pose = pulses.true
        row, facets = self._in_footprints(pose, low, high)
        away, normal = facets.place_m - pose.position_m[row], facets.normal_m2
        toward = -np.einsum("fi,fi->f", normal, away)
        behind = (toward < 0) & self._two_sided[facets.surface]
        normal[behind], toward[behind] = -normal[behind], -toward[behind]
        facing = np.flatnonzero(toward > 0)
        row, facets, away, normal, toward = (
            row[facing],
            facets.rows(facing),
            away[facing],
            normal[facing],
            toward[facing],
        )
        range_m, twice_area = (np.sqrt(np.einsum("fi,fi->f", vector, vector)) for vector in (away, normal))
        direction = away / range_m[:, None]
        R_world_antenna = pose.R_world_antenna[row]
        antenna_gain = self._antenna.gain(_seen_along(direction, R_world_antenna))
        drawn = self._drawn(facets.identity, pulses.index[row])
        amplitude = self._scattering.amplitude(
            direction, normal / twice_area[:, None], facets.surface, drawn, R_world_antenna
        )
        spread = antenna_gain * self._wavelength_m * np.sqrt(twice_area / 2) / ((4 * np.pi) ** 1.5 * range_m**2)
        return _Echoes(
            row=row,
            gain=spread * amplitude,
            place_m=facets.place_m,
            cos_incidence=np.minimum(toward / (twice_area * range_m), 1.0),
            identity=facets.identity,
            surface=facets.surface,
        )

    def _in_footprints(self, pose: Pose, low: int, high: int) -> tuple[Int[np.ndarray, " facet"], FacetScatterers]:
        """Return the facets whose centres lie in the footprints of poses, the coarse ones divided until they are fine.

        The row of the pose of each is returned with them; they are sorted by it.
        """
        row, place, coarse = self._index.search(self._footprint, self._fineness, pose, low, high)
        if not coarse.any():
            return row, self._index.scatterers.rows(place)
        groups = [(row[~coarse], self._index.scatterers.rows(place[~coarse]))]
        groups += self._divided(self._index.facets.rows(place[coarse]), row[coarse], pose)
        row = np.concatenate([rows for rows, _ in groups])
        order = np.argsort(row, kind="stable")
        return row[order], FacetScatterers.concatenate([facets for _, facets in groups]).rows(order)

    def _divided(
        self, facets: Facets, row: Int[np.ndarray, " facet"], pose: Pose
    ) -> list[tuple[Int[np.ndarray, " _"], FacetScatterers]]:
        """Return the parts of facets whose centres lie in the footprints of their poses, divided until fine."""
        fine: list[tuple[Int[np.ndarray, " _"], FacetScatterers]] = []
        while len(facets):
            if len(facets) + sum(len(rows) for rows, _ in fine) > MAX_FACETS:
                raise _TooManyError
            away = facets.centre_m - pose.position_m[row]
            side = np.sqrt(facets.squared_side_m2.max(axis=1))
            cuts = self._fineness.subdivisions(side, np.sqrt(np.einsum("fi,fi->f", away, away)))
            # No point of a triangle lies farther from its centroid than two thirds of the longest side.
            radius = np.where(cuts > 1, 2 / 3 * side, 0.0)
            met = self._footprint.meets(_seen_along(away, pose.R_world_antenna[row]), radius)
            whole = met & (cuts == 1)
            fine.append((row[whole], facets.rows(whole).scatterers))
            few = met & (cuts > 1) & (cuts <= MAX_PARTS)
            for count in np.unique(cuts[few]):
                selected = few & (cuts == count)
                pieces = facets.rows(selected).divided(int(count)).scatterers
                rows = np.tile(row[selected], int(count) ** 2)
                away = pieces.place_m - pose.position_m[rows]
                inside = self._footprint.meets(_seen_along(away, pose.R_world_antenna[rows]), 0.0)
                fine.append((rows[inside], pieces.rows(inside)))
            # Parts of very long facets outside the beam are dropped before they are divided in one step.
            many = met & (cuts > MAX_PARTS)
            facets, row = facets.rows(many).halved(), np.tile(row[many], 2)
        return fine

    def _visible(self, pulses: Pulses, echoes: _Echoes) -> Paths:
        """Return the paths of visible scatterers."""
        origin = pulses.true.position_m[echoes.row]
        visible = self._caster.visible(origin, echoes.place_m, SHADOW_TOLERANCE_M)
        seen = np.flatnonzero(visible & (echoes.gain != 0))
        bounds = chunks(len(seen), ROWS_AT_ONCE) or [(0, 0)]
        return Paths.concatenate(
            list(in_threads(lambda low, high: self._paths(pulses, echoes.rows(seen[low:high])), bounds))
        )

    def _paths(self, pulses: Pulses, echoes: _Echoes) -> Paths:
        """Return the paths of scatterers with their phases."""
        turns = unit_of(self._drawn(echoes.identity, pulses.index[echoes.row]))
        if self._wander_hz:
            turns = turns + self._wander_hz * self._wander(echoes.identity) * pulses.time_s[echoes.row]
        phase = 2 * np.pi * np.mod(turns, 1.0)
        turn = np.empty(len(phase), dtype=np.complex128)
        turn.real, turn.imag = np.cos(phase), np.sin(phase)
        return Paths.to_points(
            pulses,
            echoes.row,
            echoes.place_m,
            gain=echoes.gain * turn,
            incidence_rad=np.arccos(echoes.cos_incidence),
            surface=echoes.surface,
        )

    def _drawn(
        self, identity: UInt64[np.ndarray, " path"], pulse: Int[np.ndarray, " path"]
    ) -> UInt64[np.ndarray, " path"]:
        """Return the random state of each facet's phase at each pulse and of its scattering matrix's signs."""
        state = identity ^ self._key
        if self._speckle == "per_pulse":
            state = split_mix(state, pulse.astype(np.uint64) + np.uint64(1))
        return state

    def _wander(self, identity: UInt64[np.ndarray, " path"]) -> Float[np.ndarray, " path"]:
        """Return a number of the two-sided exponential distribution of mean size one for each facet."""
        uniform = 2 * unit_of(split_mix(identity ^ self._key, WANDER_STEP)) - 1
        return np.sign(uniform) * -np.log(np.maximum(1 - np.abs(uniform), 2.0**-60))


def _seen_along(
    vector: Float[np.ndarray, "facet 3"], R_world_antenna: Float[np.ndarray, "facet 3 3"]
) -> Float[np.ndarray, "facet 3"]:
    """Return vectors, each in the frame of an antenna of its own."""
    return np.einsum("fi,fij->fj", vector, R_world_antenna)
