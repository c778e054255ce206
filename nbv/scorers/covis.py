"""Co-visibility (Covis): how much of the existing sparse model a candidate would see again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nbv.types import Floats


def co_visibility(visible: NDArray[np.bool_]) -> Floats:
    """Eq. 5: (C,) fraction of the P > 0 tracked points in the box that each candidate sees.

    ``visible`` is (P, C).
    """
    return np.count_nonzero(visible, axis=0) / visible.shape[0]
