"""Fewer points than a figure could show."""

from __future__ import annotations

import numpy as np


def thin_indices(total: int, count: int) -> np.ndarray:
    """At most ``count`` indices of ``range(total)``: a fixed random choice, in order."""
    if total <= count:
        return np.arange(total)
    return np.sort(np.random.default_rng(0).permutation(total)[:count])
