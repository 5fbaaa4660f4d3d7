"""Walls before ground, and corners of two plates."""

import numpy as np
from scipy.constants import speed_of_light
from scipy.spatial.transform import Rotation

from sionna_radar.scene.model import Scene, Surface
from sionna_radar.surfaces.backscatter import Backscatter, ConstantGammaBackscatter
from sionna_radar.surfaces.permittivity import building_permittivity
from sionna_radar.surfaces.radar_material import Mirror, RadarMaterial
from worlds import GAMMA, make_scene

CARRIER_HZ = 77e9
WAVELENGTH_M = speed_of_light / CARRIER_HZ
METAL = building_permittivity("metal", CARRIER_HZ)
DARK = ConstantGammaBackscatter(1e-12)


def mirror_of(permittivity: complex = METAL, rms_height_m: float = 0.0) -> RadarMaterial:
    """Return a mirror that scatters nothing else."""
    mirror = Mirror(permittivity=permittivity, rms_height_m=rms_height_m, frequency_hz=CARRIER_HZ)
    return RadarMaterial(vertical=DARK, horizontal=DARK, mirror=mirror)


def plate(name: str, corners_m: np.ndarray, material: str) -> Surface:
    """Return a rectangle, counter-clockwise seen from its front."""
    return Surface(
        name=name, vertices_m=np.asarray(corners_m, float), faces=np.array([[0, 1, 2], [0, 2, 3]]), material=material
    )


def wall_on_ground(north_m: float = 52.0, ground: Backscatter | None = None, wall: Backscatter | None = None) -> Scene:
    """Return level ground, and on it a wall 40 m high that looks south."""
    half, n = 100.0, north_m
    level = plate("ground", [[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]], "ground")
    upright = plate("wall", [[-60, n, 0], [60, n, 0], [60, n, 40], [-60, n, 40]], "wall")
    return make_scene(level, upright, materials={"ground": ground or rough_ground(), "wall": wall or mirror_of()})


def rough_ground(gamma: float = GAMMA, **changes: object) -> RadarMaterial:
    model = ConstantGammaBackscatter(gamma)
    return RadarMaterial(vertical=model, horizontal=model, **changes)


def corner(depth_m: float, length_m: float, *, turn_rad: float = 0.0, roll_deg: float = 0.0) -> Scene:
    """Return two metal plates that meet along the x axis, symmetric about the direction half way from -y to z.

    turn_rad: by which the angle between them is less than a right one; roll_deg: of both about that direction.
    """
    half = length_m / 2
    level = np.array([[-half, 0, 0], [-half, -depth_m, 0], [half, -depth_m, 0], [half, 0, 0]])
    upright = np.array([[-half, 0, 0], [half, 0, 0], [half, 0, depth_m], [-half, 0, depth_m]])
    roll = Rotation.from_rotvec(np.deg2rad(roll_deg) * np.array([0.0, -1.0, 1.0]) / np.sqrt(2))
    faces = [
        roll.apply(Rotation.from_rotvec([side * turn_rad / 2, 0.0, 0.0]).apply(face))
        for side, face in ((-1, level), (1, upright))
    ]
    plates = (plate(name, face, "metal") for name, face in zip("ab", faces, strict=True))
    return make_scene(*plates, materials={"metal": mirror_of()})
