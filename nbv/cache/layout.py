"""What the arrays of an entry must be. A checksum tells that nobody damaged it, not that it is what it is kept as."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

Arrays = dict[str, np.ndarray]
Check = Callable[[Arrays], bool]


def holds(layout: Mapping[str, str]) -> Check:
    """Whether an entry has the arrays of ``layout`` and no others.

    ``"f n 3"`` are floats (NumPy's letters of kinds) of shape (n, 3), n being the same wherever it is named; ``_`` is any
    length. ``"iu m 3 <n"`` are whole numbers from 0 to n - 1.
    """

    def check(arrays: Arrays) -> bool:
        lengths: dict[str, int] = {}
        return (
            set(arrays) == set(layout)
            and all(_has_shape(arrays[name], text, lengths) for name, text in layout.items())
            and all(_is_below(arrays[name], text, lengths) for name, text in layout.items())
        )

    return check


def _has_shape(array: np.ndarray, text: str, lengths: dict[str, int]) -> bool:
    kinds, *dimensions = text.partition("<")[0].split()
    if array.dtype.kind not in kinds or array.ndim != len(dimensions):
        return False
    for dimension, length in zip(dimensions, array.shape, strict=True):
        expected = int(dimension) if dimension.isdigit() else lengths.setdefault(dimension, length)
        if dimension != "_" and length != expected:
            return False
    return True


def _is_below(array: np.ndarray, text: str, lengths: dict[str, int]) -> bool:
    bound = text.partition("<")[2]
    return not bound or array.size == 0 or (array.min() >= 0 and int(array.max()) < lengths[bound])
