"""The sparse model of all photographs: another program's, or ours."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from nbv.cache import Store
from nbv.errors import UserError
from nbv.photographs.folder import Progress, SourcePhotograph, kept_upright, read_pixels
from nbv.photographs.mapping import mapped, triangulated
from nbv.photographs.model_files import read_model, working_sizes
from nbv.photographs.solved import SolvedModel

FEWEST_REGISTERED = 6
WORST_MEDIAN_PX = 4.0
LEAST_LIKENESS = (
    0.5  # correlation of the grey of one point in two photographs; of other photographs it is about 0
)
_BLUR_PX = 2.0


def solve(
    photographs: Sequence[SourcePhotograph],
    max_size_px: int,
    model_path: Path | None,
    progress: Progress,
    store: Store | None,
) -> tuple[SolvedModel, bool, list[str]]:
    """A sparse model in a frame of its own, whether its photographs are worked on upright, and notes.

    Parameters
    ----------
    photographs
        Of the folder.
    max_size_px
        Long side at which they are worked on.
    model_path
        Another program's model, or None.
    progress, store
        As in `nbv.photographs.importer.import_photographs`.

    Raises
    ------
    UserError
        The model is damaged or of other photographs; or the photographs do not overlap, or are of two objects.
    """
    if model_path is None:
        upright = kept_upright(photographs)
        sizes = working_sizes(photographs, max_size_px, upright=upright)
        model, notes = mapped(photographs, sizes, progress, store, upright=upright)
    else:
        model, upright = read_model(model_path, photographs, max_size_px)
        notes = [f"sparse model: {model_path.name}"]
        if not len(model.xyz):
            model = triangulated(photographs, model, progress, store, upright=upright)
            notes.append("points triangulated with its poses")
        _check_likeness(model, photographs, max_size_px, model_path, progress, upright=upright)
    if len(model.names) < FEWEST_REGISTERED:
        raise UserError(
            f"only {len(model.names)} of {len(photographs)} photographs have a pose; a set needs {FEWEST_REGISTERED}"
        )
    median_px = float(np.median(model.reprojection_errors_px()))
    if not median_px <= WORST_MEDIAN_PX:
        raise UserError(
            f"the model does not fit the photographs: {median_px:.1f} px median reprojection error"
        )
    notes.append(
        f"{len(model.names)} of {len(photographs)} photographs registered, {len(model.xyz)} points, "
        f"{median_px:.2f} px median reprojection error"
    )
    return model, upright, notes


def _check_likeness(
    model: SolvedModel,
    photographs: Sequence[SourcePhotograph],
    max_size_px: int,
    path: Path,
    progress: Progress,
    *,
    upright: bool,
) -> None:
    """`UserError` where the photographs do not show the same grey where the model says they show the same point."""
    paths = {p.name: p.path for p in photographs}
    grey = np.zeros(len(model.views))
    for view, name in enumerate(model.names):
        progress("comparing the model with the photographs", view, len(model.names))
        picture = cv2.cvtColor(read_pixels(paths[name], max_size_px, upright=upright), cv2.COLOR_RGB2GRAY)
        picture = cv2.GaussianBlur(picture, (0, 0), _BLUR_PX)
        of_view = model.views == view
        columns, rows = model.xy_px[of_view].astype(int).T
        grey[of_view] = picture[np.clip(rows, 0, len(picture) - 1), np.clip(columns, 0, picture.shape[1] - 1)]
    count = np.bincount(model.points)
    mean = np.bincount(model.points, weights=grey) / np.maximum(count, 1)
    # Share of the variance that is between points and not within them: the intraclass correlation.
    within = float(((grey - mean[model.points]) ** 2).sum() / max(len(grey) - len(count), 1))
    likeness = 1 - within / max(float(grey.var()), 1e-9)
    if likeness < LEAST_LIKENESS:
        raise UserError(
            f"{path} is a model of other photographs: what it takes for one point is not alike in them "
            f"(correlation {likeness:.2f})"
        )
