"""Which views dense stereo could match with one another.

Two views of a sample are matchable where the angle between them, as seen from the sample, lies between
``dense.min_pair_angle_deg`` and ``dense.max_pair_angle_deg``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from nbv.config import DenseConfig
from nbv.types import Bools


def usable_angles(angle_deg: Any, dense: DenseConfig) -> Any:
    """Whether two views so far apart can be matched; a mask for an array of angles."""
    return (angle_deg >= dense.min_pair_angle_deg) & (angle_deg <= dense.max_pair_angle_deg)


def usable_cosines(cosine: NDArray[np.floating[Any]], dense: DenseConfig) -> Bools:
    """`usable_angles` from the angles' cosines, in their precision."""
    near = np.cos(np.deg2rad(dense.min_pair_angle_deg)).astype(cosine.dtype)
    far = np.cos(np.deg2rad(dense.max_pair_angle_deg)).astype(cosine.dtype)
    return (cosine <= near) & (cosine >= far)
