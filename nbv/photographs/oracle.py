"""What an oracle gate may ask of a set: the tracks of the model that was made of all photographs.

GROUND TRUTH. A point of the reference model is covered once three chosen photographs are in its track: what they really
have in common, matched and verified, where a surface only says what they could.
"""

from __future__ import annotations

import numpy as np
import pycolmap
from numpy.typing import NDArray

from nbv.config import MissionConfig
from nbv.gates.base import Coverage
from nbv.photographs.photograph_set import PhotographSet
from nbv.photographs.viewpoints import PhotographViewpoints
from nbv.types import Floats, PlanningState

VIEWS_NEEDED = 3
NEAR = 0.05  # of the object's height: points farther from its box are not of it


class TrackOracle:
    """Implements `nbv.gates.Oracle` over the photographs of a set that may be taken, which ``viewpoints`` are of."""

    def __init__(
        self, photographs: PhotographSet, viewpoints: PhotographViewpoints, config: MissionConfig
    ) -> None:
        self.config = config
        self._viewpoints = viewpoints
        self._seen = _tracks(photographs)  # (N, P)

    def coverage(self, state: PlanningState) -> Coverage:
        """Points that `VIEWS_NEEDED` of the photographs taken see."""
        views = self._seen[self._indices(state.visited_m)].sum(axis=0)
        return Coverage(views >= VIEWS_NEEDED, state.visited_m)

    def gain(self, position_m: Floats, coverage: Coverage) -> float:
        """Points that still lack views and that the photograph from ``position_m`` sees, each by the share that it adds."""
        seen = self._seen[self._indices(position_m)[0]]
        return float(np.count_nonzero(seen & ~coverage.covered)) / VIEWS_NEEDED

    def _indices(self, positions_m: Floats) -> NDArray[np.int64]:
        return self._viewpoints.nearest(np.asarray(positions_m, dtype=float).reshape(-1, 3))


def _tracks(photographs: PhotographSet) -> NDArray[np.bool_]:
    """(N, P) which of the registered photographs are in the tracks of the reference model's points on the object."""
    model = pycolmap.Reconstruction(photographs.sparse_folder)
    points = list(model.points3D.values())
    margin = NEAR * photographs.height_m
    offset = np.abs(np.array([point.xyz for point in points]).reshape(-1, 3) - photographs.target_m)
    near = (offset < np.asarray(photographs.extents_m) / 2 + margin).all(axis=1)
    row = {f"{photograph.name}.jpg": n for n, photograph in enumerate(photographs.registered)}
    row_of_image = {image_id: row.get(image.name) for image_id, image in model.images.items()}
    seen = np.zeros((len(row), len(points)), dtype=bool)
    for column in np.flatnonzero(near):
        rows = {row_of_image[element.image_id] for element in points[column].track.elements} - {None}
        seen[[r for r in rows if r is not None], column] = True
    return seen[:, seen.sum(axis=0) >= 2]
