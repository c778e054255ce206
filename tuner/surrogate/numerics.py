"""How numbers are computed here: float64, seeded, one thread."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator, Sequence

import numpy as np
import torch
from botorch.exceptions import BotorchWarning, InputDataWarning, OptimizationWarning
from threadpoolctl import threadpool_limits

from nbv.types import Floats

NORMAL_95 = 1.959963984540054


@contextlib.contextmanager
def numerics(seed: int) -> Iterator[None]:
    """Seed torch, use one thread, hide warnings about tiny data sets; at the end restore the random state.

    More threads than one make matrices of this size slower, several times so on a busy machine.
    """
    threads = torch.get_num_threads()
    state = torch.random.get_rng_state()
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    try:
        with threadpool_limits(1), warnings.catch_warnings():
            for category in (InputDataWarning, OptimizationWarning, BotorchWarning, RuntimeWarning):
                warnings.simplefilter("ignore", category)
            yield
    finally:
        torch.set_num_threads(threads)
        torch.random.set_rng_state(state)


def tensor(array: Floats | Sequence[Sequence[float]] | Sequence[Floats]) -> torch.Tensor:
    """float64 tensor, the only precision used here."""
    return torch.as_tensor(np.asarray(array, dtype=np.float64), dtype=torch.float64)
