"""Descriptor matching with 8-bit matrix products: `nbv.sparse.matching.match_pair` to the bit, four times faster.

Nearly all the time of matching is the product of two descriptor sets, and single precision already runs at the
speed of the core. Descriptors are bytes, so a processor with 8-bit dot products (AVX512-VNNI) forms the same sums
in a quarter of the instructions, exactly: they stay below 2**24. The product comes from PyTorch's int8
multiplication, in blocks that stay in the cache until their rows are searched.
"""

from __future__ import annotations

import functools
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nbv.sparse.matching import (
    MAX_DISTANCE_RAD,
    Descriptors,
    NearestTwo,
    match_pair,
    nearest_in_single_precision,
)

_BLOCK_BYTES = 2 << 20  # of products, which are int32: still in the cache when their rows are searched
_LARGEST_INT8 = 127
# Loading PyTorch costs about 1 s and 0.2 GB. A process pays that only after it has formed so many products in
# single precision, about 1 s of them: at worst it loses another second, and with a warm store it loses nothing.
_PRODUCTS_BEFORE_LOADING = 300_000_000


_products_formed = 0


def match_pair_fast(
    a: Descriptors, b: Descriptors, max_ratio: float = 0.8, max_distance_rad: float = MAX_DISTANCE_RAD
) -> NDArray[np.uint32]:
    """`nbv.sparse.matching.match_pair`, in 8 bits where the processor multiplies them and it pays."""
    global _products_formed
    nearest = nearest_in_8_bits
    if "torch" not in sys.modules and _products_formed < _PRODUCTS_BEFORE_LOADING:
        _products_formed += len(a) * len(b)
        nearest = nearest_in_single_precision
    elif not eight_bit_products_are_exact():
        nearest = nearest_in_single_precision
    return match_pair(a, b, max_ratio, max_distance_rad, nearest)


def nearest_in_8_bits(a: Descriptors, b: Descriptors) -> NearestTwo:
    """`nbv.sparse.matching.nearest_in_single_precision`, whatever the processor."""
    torch = _torch()
    step = max(32, _BLOCK_BYTES // (4 * len(b)) // 32 * 32)
    left, right = (torch.from_numpy(np.minimum(x, _LARGEST_INT8).view(np.int8)) for x in (a, b))
    # Descriptors with a larger byte than int8 holds, about one in a thousand, are multiplied in single precision.
    large_rows, large_columns = (np.flatnonzero(x.max(axis=1) > _LARGEST_INT8) for x in (a, b))
    of_large_columns = _single_precision_products(a, b[large_columns])
    of_large_rows = _single_precision_products(a[large_rows], b)
    nearest = np.empty(len(a), np.int64)
    best = np.empty(len(a), np.int32)
    second = np.zeros(len(a), np.int32)  # with a single candidate the second best is at a right angle
    for start in range(0, len(a), step):
        stop = min(start + step, len(a))
        products = torch._int_mm(left[start:stop], right.T).numpy()
        products[:, large_columns] = of_large_columns[start:stop]
        first, last = np.searchsorted(large_rows, (start, stop))
        products[large_rows[first:last] - start] = of_large_rows[first:last]
        index = products.argmax(axis=1)
        within = np.arange(stop - start)
        nearest[start:stop] = index
        best[start:stop] = products[within, index]
        if len(b) > 1:
            products[within, index] = -1
            second[start:stop] = products.max(axis=1)
    return nearest, best.astype(np.float32), second.astype(np.float32)


def _single_precision_products(a: Descriptors, b: Descriptors) -> NDArray[np.float32]:
    """(Ka, Kb) sums of products of bytes, below 2**24 and therefore exact."""
    return a.astype(np.float32) @ b.T.astype(np.float32)


@functools.cache
def eight_bit_products_are_exact() -> bool:
    """Whether this processor multiplies int8 matrices fast and without saturation (loads PyTorch).

    Without 8-bit dot products oneDNN adds pairs of products in 16 bits, which may overflow: tried here with the
    largest bytes that there are.
    """
    torch = _torch()
    try:
        if not torch.cpu._is_vnni_supported():
            return False
        extremes = np.array([0, 1, 126, 127], np.int8)
        a = np.random.default_rng(0).choice(extremes, (64, 128))
        a[0] = _LARGEST_INT8
        got = torch._int_mm(torch.from_numpy(a), torch.from_numpy(a).T).numpy()
    except (AttributeError, RuntimeError):  # another PyTorch, or one built without these products
        return False
    wide = a.astype(np.int64)
    return np.array_equal(got, wide @ wide.T)


@functools.cache
def _torch() -> Any:
    """PyTorch; on one thread if nobody else had loaded it."""
    alone = "torch" not in sys.modules
    import torch

    if alone:
        torch.set_num_threads(1)
    return torch
