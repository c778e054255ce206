"""What the arrays of an entry must be. A checksum tells that nobody damaged it, not that it is what it is kept as."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from nbv.safe_files import misfit

Arrays = dict[str, np.ndarray]
Check = Callable[[Arrays], bool]


def holds(layout: Mapping[str, str]) -> Check:
    """Whether an entry has the arrays of ``layout``, as `nbv.safe_files.misfit` reads it, and no others."""
    return lambda arrays: set(arrays) == set(layout) and not misfit(arrays, layout)
