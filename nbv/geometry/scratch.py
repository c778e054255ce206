"""Memory for the arrays that a block of points takes, kept between calls.

Large arrays that are made and dropped in every call go back to the system in between, and come back page by page:
that took a sixth of the time of a ranking.
"""

from __future__ import annotations

import math
import threading

import numpy as np

from nbv.types import Floats32

_kept = threading.local()


def scratch(*shape: int) -> Floats32:
    """An uninitialised array of this shape, valid until the same thread asks again."""
    size = math.prod(shape)
    memory: Floats32 | None = getattr(_kept, "memory", None)
    if memory is None or len(memory) < size:
        memory = _kept.memory = np.empty(size, dtype=np.float32)
    return memory[:size].reshape(shape)
