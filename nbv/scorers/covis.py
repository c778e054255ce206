"""Co-visibility (Covis): how much of the existing sparse model a candidate would see again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nbv.types import Floats


def co_visibility(visible: NDArray[np.bool_]) -> Floats:
    """Eq. 5: (C,) fraction of the P > 0 tracked points in the box that each candidate sees.

    ``visible`` is (P, C).
    """
    total = np.zeros(visible.shape[1], dtype=np.int64)
    as_bytes = np.ascontiguousarray(visible).view(np.uint8)
    for start in range(0, len(as_bytes), 255):  # 255 ones fit into a byte, and bytes add up fastest
        total += np.add.reduce(as_bytes[start : start + 255], axis=0, dtype=np.uint8)
    return total / visible.shape[0]
