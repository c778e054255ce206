"""Which views dense stereo could match with one another, and how many a piece of surface has of them.

Two views of a sample are matchable where the angle between them, as seen from the sample, lies between
``dense.min_pair_angle_deg`` and ``dense.max_pair_angle_deg``. A sample has as many matchable views as its best view
has: itself and its partners. The partners of a view of a sample are the other views that see the sample and are
matchable with it; a view that does not see the sample has -1.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nbv.config import DenseConfig
from nbv.types import Bools

Counts = NDArray[np.signedinteger[Any]]


def usable_angles(angle_deg: Any, dense: DenseConfig) -> Any:
    """Whether two views so far apart can be matched; a mask for an array of angles."""
    return (angle_deg >= dense.min_pair_angle_deg) & (angle_deg <= dense.max_pair_angle_deg)


def usable_cosines(cosine: NDArray[np.floating[Any]], dense: DenseConfig) -> Bools:
    """`usable_angles` from the angles' cosines, in their precision."""
    near = np.cos(np.deg2rad(dense.min_pair_angle_deg)).astype(cosine.dtype)
    far = np.cos(np.deg2rad(dense.max_pair_angle_deg)).astype(cosine.dtype)
    return (cosine <= near) & (cosine >= far)


def matchable_views(partners: Counts) -> Counts:
    """(S,) matchable views of each sample, from partners (S, V)."""
    views: Counts = partners.max(axis=1, initial=-1) + 1
    return views


def matchable_views_with(partners: Counts, pairs: Bools, seen: Bools) -> Counts:
    """(S, C) matchable views of each sample, once one of the candidates has been taken.

    ``partners`` (S, V) are of the views so far; ``pairs`` (S, C, V) whether candidate and view match at a sample that both see;
    ``seen`` (S, C) whether the candidate sees the sample.
    """
    helped = (partners[:, None, :] + pairs).max(axis=2, initial=-1)
    of_candidate = np.where(seen, pairs.sum(axis=2), -1)
    views: Counts = np.maximum(helped, of_candidate) + 1
    return views
