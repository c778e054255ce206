"""Numerical conventions: float64, one thread, one computation at a time, and random generators of its own."""

from __future__ import annotations

import contextlib
import threading
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import torch
from botorch.acquisition.utils import prune_inferior_points
from botorch.exceptions import BotorchWarning, InputDataWarning, OptimizationWarning
from botorch.models.model import Model
from botorch.sampling import SobolQMCNormalSampler
from threadpoolctl import threadpool_limits

from nbv.types import Floats

PRUNING_SAMPLES = 2048
NORMAL_95 = 1.959963984540054


_turn = threading.RLock()


@contextlib.contextmanager
def numerics() -> Iterator[None]:
    """Take turns with other threads, use one thread, hide warnings about tiny data sets.

    BoTorch's fits change the process's warning filters, and threads and filters are the process's here too; torch's global random
    state is neither used nor changed. More threads than one make matrices of this size slower, several times so on a busy machine.
    """
    with _turn, threadpool_limits(1), warnings.catch_warnings():
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        for category in (InputDataWarning, OptimizationWarning, BotorchWarning, RuntimeWarning):
            warnings.simplefilter("ignore", category)
        try:
            yield
        finally:
            torch.set_num_threads(threads)


def pruned(model: Model, inputs: torch.Tensor, seed: int, **options: Any) -> torch.Tensor:
    """Return those of (n, inputs) that may be the best; as BoTorch's, whose sampler takes its seed from the global state."""
    sampler = SobolQMCNormalSampler(torch.Size([PRUNING_SAMPLES]), seed=seed)
    return prune_inferior_points(model, inputs, sampler=sampler, **options)


def tensor(array: Floats | Sequence[Sequence[float]] | Sequence[Floats]) -> torch.Tensor:
    """float64 tensor, the only precision used here."""
    return torch.as_tensor(np.asarray(array, dtype=np.float64), dtype=torch.float64)
