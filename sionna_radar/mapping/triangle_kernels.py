"""Which triangle each cell of a grid lies in, as machine code: triangle by triangle, over the cells around it.

A search for the triangle of each cell, such as SciPy's or matplotlib's, needs a structure that takes more time and
memory than the triangulation itself; the cells of a grid are found without one.
"""

from typing import no_type_check

from sionna_radar.foundation.compiled import compiled

# Triangles with a smaller ratio of width to length hold no cell: collinear points, and rounding.
FLAT = 1e-9
# A cell on a common side belongs to the first of its triangles. By this share of the area, and of a cell around a
# triangle, rounding loses none of them.
ON_SIDE = 1e-9


@compiled
@no_type_check
def fill_triangles(place, corner, wanted, first, spacing, inside):
    """Write for each cell the first of the wanted triangles that it lies in; others are left as they are.

    place: x and y of each point; corner: the three points of each triangle; wanted: which triangles count.
    first: x and y of the centre of the first cell; spacing: of the cells; inside: numbers of triangles, by row (y) and
        column (x), -1 for none.
    """
    rows, columns = inside.shape
    west, south = first
    for triangle in range(len(corner)):
        if not wanted[triangle]:
            continue
        a, b, c = corner[triangle]
        # In cells, from the first corner.
        bx, by = (place[b, 0] - place[a, 0]) / spacing, (place[b, 1] - place[a, 1]) / spacing
        cx, cy = (place[c, 0] - place[a, 0]) / spacing, (place[c, 1] - place[a, 1]) / spacing
        area = bx * cy - by * cx
        side = (cx - bx) ** 2 + (cy - by) ** 2
        longest = max(bx**2 + by**2, cx**2 + cy**2, side)
        if abs(area) <= FLAT * longest:
            continue
        ax, ay = (place[a, 0] - west) / spacing, (place[a, 1] - south) / spacing
        low_column = max(int(-(-(ax + min(0.0, bx, cx) - ON_SIDE) // 1.0)), 0)
        high_column = min(int((ax + max(0.0, bx, cx) + ON_SIDE) // 1.0), columns - 1)
        low_row = max(int(-(-(ay + min(0.0, by, cy) - ON_SIDE) // 1.0)), 0)
        high_row = min(int((ay + max(0.0, by, cy) + ON_SIDE) // 1.0), rows - 1)
        for row in range(low_row, high_row + 1):
            y = row - ay
            for column in range(low_column, high_column + 1):
                x = column - ax
                of_b = (x * cy - y * cx) / area
                of_c = (bx * y - by * x) / area
                if of_b < -ON_SIDE or of_c < -ON_SIDE or of_b + of_c > 1.0 + ON_SIDE:
                    continue
                if inside[row, column] < 0:
                    inside[row, column] = triangle
