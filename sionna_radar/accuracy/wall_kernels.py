"""Steep faces among the many of a surface, as machine code."""

from typing import no_type_check

import numpy as np

from sionna_radar.foundation.compiled import compiled


@compiled
@no_type_check
def walls_among(vertices, faces, least_m, most_cosine, extent):
    """Return the faces over a map that are at least so high, and so steep: by the cosine of their slope."""
    west, east, south, north = extent
    found, count = np.empty(1024, dtype=np.int64), 0
    corner = np.empty((3, 3))
    for face in range(len(faces)):
        for number in range(3):
            for axis in range(3):
                corner[number, axis] = vertices[faces[face, number], axis]
        z = corner[:, 2]
        if max(z[0], z[1], z[2]) - min(z[0], z[1], z[2]) < least_m:
            continue
        x, y = corner[:, 0], corner[:, 1]
        if max(x[0], x[1], x[2]) < west or min(x[0], x[1], x[2]) > east:
            continue
        if max(y[0], y[1], y[2]) < south or min(y[0], y[1], y[2]) > north:
            continue
        ux, uy, uz = x[1] - x[0], y[1] - y[0], z[1] - z[0]
        vx, vy, vz = x[2] - x[0], y[2] - y[0], z[2] - z[0]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        if abs(nz) >= most_cosine * np.sqrt(nx * nx + ny * ny + nz * nz):
            continue
        if count == len(found):
            grown = np.empty(2 * count, dtype=np.int64)
            grown[:count] = found
            found = grown
        found[count] = face
        count += 1
    return found[:count]
