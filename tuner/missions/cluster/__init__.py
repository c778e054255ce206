"""Missions on other machines, by Dask (extra ``cluster``); nothing else here needs it.

The coordinator, which has the model and the ledger, is a client of a Dask scheduler. A worker flies every mission in a process
of its own (`tuner.missions.executors.LocalProcessExecutor`) with its own store, and sends the mission's directory back.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tuner.missions.cluster.connect import dask_executor
    from tuner.missions.cluster.executor import DaskExecutor

__all__ = ["DaskExecutor", "dask_executor"]
_FILES = {"DaskExecutor": "executor", "dask_executor": "connect"}


def __getattr__(name: str) -> Any:
    if name not in _FILES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_FILES[name]}"), name)
