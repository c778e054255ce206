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

BLOCK_BYTES = 4 << 20  # of products, which are int32: still in the cache when their rows are searched
_LARGEST_INT8 = 127
_HIGH_BITS = np.uint64(0x8080808080808080)  # of eight bytes at once
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
    a, b = (np.require(x, requirements=["C", "W"]) for x in (a, b))  # what PyTorch shares; rarely a copy
    # Products are of unsigned bytes with signed ones. Rows of b with a larger byte than int8 holds, about one in a
    # thousand, have products of 0 in the blocks, which wins over nothing, and are looked at apart.
    large = np.flatnonzero((b.view(np.uint64) & _HIGH_BITS).any(axis=1))
    narrow = b.view(np.int8)
    if len(large):
        narrow = narrow.copy()
        narrow[large] = 0
    left, right = torch.from_numpy(a), torch.from_numpy(narrow).T
    nearest = np.empty(len(a), np.int64)
    best = np.empty(len(a), np.int32)
    second = np.empty(len(a), np.int32)
    step = min(len(a), max(32, BLOCK_BYTES // (4 * len(b)) // 32 * 32))
    # One for all: fresh memory for each would cost a tenth of the product.
    block = torch.empty((step, len(b)), dtype=torch.int32)
    for start in range(0, len(a), step):
        stop = min(start + step, len(a))
        products = block[: stop - start]
        torch._int_mm(left[start:stop], right, out=products)
        nearest[start:stop], best[start:stop], second[start:stop] = _largest_two(products.numpy())
    if len(large):
        index, value, next_value = _largest_two(_products_with_large_bytes(a, b[large]))
        index = large[index]
        second = np.maximum(np.maximum(second, next_value), np.minimum(best, value))
        # Of equal products the first counts.
        nearest = np.where((value > best) | ((value == best) & (index < nearest)), index, nearest)
        best = np.maximum(best, value)
    return nearest, best.astype(np.float32), second.astype(np.float32)


def _largest_two(
    products: NDArray[np.int32],
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]:
    """Per row (R, N): index and value of the first largest entry, and the next value; writes over ``products``."""
    rows = np.arange(len(products))
    index = products.argmax(axis=1)
    best = products[rows, index]
    if products.shape[1] == 1:  # with a single candidate the second best is at a right angle
        return index, best, np.zeros_like(best)
    products[rows, index] = -1
    return index, best, products.max(axis=1)


def _products_with_large_bytes(a: Descriptors, b: Descriptors) -> NDArray[np.int32]:
    """(Ka, Kb) sums of products of any bytes, through their low seven bits and the high one."""
    torch = _torch()
    low, high = (torch.from_numpy(part.view(np.int8)).T for part in (b & _LARGEST_INT8, b >> 7))
    left = torch.from_numpy(a)
    products: NDArray[np.int32] = (torch._int_mm(left, low) + 128 * torch._int_mm(left, high)).numpy()
    return products


@functools.cache
def eight_bit_products_are_exact() -> bool:
    """Whether this processor multiplies matrices of bytes fast and without saturation (loads PyTorch).

    Without 8-bit dot products oneDNN adds pairs of products in 16 bits, which may overflow: tried here with the
    largest bytes that there are.
    """
    torch = _torch()
    try:
        if not torch.cpu._is_vnni_supported():
            return False
        rng = np.random.default_rng(0)
        a = rng.choice(np.array([0, 1, 127, 128, 254, 255], np.uint8), (64, 128))
        b = rng.choice(np.array([0, 1, 126, 127], np.int8), (64, 128))
        a[0], b[0] = 255, _LARGEST_INT8
        got = torch._int_mm(torch.from_numpy(a), torch.from_numpy(b).T).numpy()
    except (AttributeError, RuntimeError):  # another PyTorch, or one built without these products
        return False
    return np.array_equal(got, a.astype(np.int64) @ b.T.astype(np.int64))


@functools.cache
def _torch() -> Any:
    """PyTorch; on one thread if nobody else had loaded it."""
    alone = "torch" not in sys.modules
    import torch  # noqa: PLC0415  where it pays

    if alone:
        torch.set_num_threads(1)
    return torch
