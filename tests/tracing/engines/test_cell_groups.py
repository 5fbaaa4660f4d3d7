"""Pieces of surface grouped by their cells, against plain sorting."""

import numpy as np

from sionna_radar.tracing.engines.persistent.cell_tree import curve, grouped, numbered, regrouped


def test_pieces_of_one_cell_and_surface_come_together_in_their_order():
    rng = np.random.default_rng(1)
    place, surface = rng.integers(-3, 4, (500, 3)).astype(np.int32), rng.integers(0, 2, 500)
    cell, count = numbered(place, surface)
    assert 0 <= cell.min() <= cell.max() < count
    _, expected = np.unique(np.column_stack([surface, place]), axis=0, return_inverse=True)
    np.testing.assert_array_equal(np.unique(cell, return_inverse=True)[1], expected.ravel())
    order, edges = grouped(cell, count)
    np.testing.assert_array_equal(order, np.argsort(cell, kind="stable"))
    np.testing.assert_array_equal(np.diff(edges), np.unique(cell, return_counts=True)[1])
    along = np.argsort(curve(place[order[edges[:-1]]].astype(np.int64)), kind="stable")
    again, its_edges = regrouped(order, edges, along)
    groups = [order[edges[k] : edges[k + 1]] for k in along]
    np.testing.assert_array_equal(again, np.concatenate(groups))
    np.testing.assert_array_equal(np.diff(its_edges), [len(group) for group in groups])
