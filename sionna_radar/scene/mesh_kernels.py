"""The triangles of a raster without empty cells, as machine code; see `mesh.mesh_of`."""

from typing import no_type_check

from sionna_radar.foundation.compiled import compiled


@compiled
@no_type_check
def vertices_of_rows(low, high, x, y, height, vertices):
    """Write the vertices of the rows from `low` to `high`."""
    for row in range(low, high):
        for column in range(len(x)):
            n = row * len(x) + column
            vertices[n, 0], vertices[n, 1], vertices[n, 2] = x[column], y[row], height[row, column]


@compiled
@no_type_check
def triangles_of_rows(low, high, columns, faces):
    """Write the triangles between each of the rows from `low` to `high` and the next."""
    for row in range(low, high):
        for column in range(columns - 1):
            a, n = row * columns + column, 2 * (row * (columns - 1) + column)
            b, c, d = a + 1, a + columns, a + columns + 1
            faces[n, 0], faces[n, 1], faces[n, 2] = a, b, d
            faces[n + 1, 0], faces[n + 1, 1], faces[n + 1, 2] = a, d, c
