"""The contact sheet of a rock."""

import numpy as np
from scene_helpers import SMALL_GROUND

from nbv.scene import preview


def test_a_sheet_shows_each_view_once(ball, monkeypatch):
    monkeypatch.setattr("nbv.scene.bake.GroundSpec", lambda: SMALL_GROUND)
    sheet = preview(ball)
    assert (sheet.shape, sheet.dtype) == ((2 * 240 + 4, 3 * 320 + 8, 3), np.uint8)
    cells = [sheet[r : r + 240, c : c + 320] for r in (0, 244) for c in (0, 324, 648)]
    for i, cell in enumerate(cells):
        assert cell.std() > 10
        assert not any(np.array_equal(cell, other) for other in cells[:i])
