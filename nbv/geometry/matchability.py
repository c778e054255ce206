"""Which views dense stereo could match with one another.

Two views of a sample are matchable where the angle between them, as seen from the sample, lies between
``dense.min_pair_angle_deg`` and ``dense.max_pair_angle_deg``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nbv.config import DenseConfig
from nbv.types import Bools, Floats


def usable_angles(angle_deg: Any, dense: DenseConfig) -> Any:
    """Whether two views so far apart can be matched; a mask for an array of angles."""
    return (angle_deg >= dense.min_pair_angle_deg) & (angle_deg <= dense.max_pair_angle_deg)


def usable_cosines(cosine: NDArray[np.floating[Any]], dense: DenseConfig) -> Bools:
    """`usable_angles` from the angles' cosines, in their precision."""
    near = np.cos(np.deg2rad(dense.min_pair_angle_deg)).astype(cosine.dtype)
    far = np.cos(np.deg2rad(dense.max_pair_angle_deg)).astype(cosine.dtype)
    return (cosine <= near) & (cosine >= far)


def stereo_partners(
    angle_deg: Floats, dense: DenseConfig, allowed: Bools | None = None
) -> tuple[NDArray[np.intp], Bools]:
    """(V, K) each view's partners in stereo, up to ``dense.neighbours``, best first, and which of them may be matched.

    ``angle_deg`` (V, V) is between the views as seen from the target; ``allowed`` (V, V) leaves out further pairs. A factor off
    ``dense.best_pair_angle_deg`` costs the same either way (too narrow: imprecise; too wide: different looks). Ties keep the order.
    """
    off_best = np.abs(np.log(np.maximum(angle_deg, 1e-9) / dense.best_pair_angle_deg))
    usable = usable_angles(angle_deg, dense) & ~np.eye(len(angle_deg), dtype=bool)
    off_best[~usable if allowed is None else ~(usable & allowed)] = np.inf
    partner = np.argsort(off_best, axis=1, kind="stable")[:, : dense.neighbours]
    return partner, np.isfinite(np.take_along_axis(off_best, partner, axis=1))


def nearest_views(angle_deg: Floats, count: int) -> NDArray[np.intp]:
    """(V, K) the ``count`` other views, or all, nearest in direction, nearest first; ``angle_deg`` as in `stereo_partners`."""
    apart = np.where(np.eye(len(angle_deg), dtype=bool), np.inf, angle_deg)
    return np.argsort(apart, axis=1, kind="stable")[:, : min(count, len(apart) - 1)]
