"""Missions on other machines, by Dask (extra ``cluster``); nothing else here needs it.

The coordinator, which has the model and the ledger, is a client of a Dask scheduler. A worker flies every mission in a process
of its own (`tuner.missions.executors.LocalProcessExecutor`) with its own store, and sends the mission's directory back.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from tuner.missions.cluster.connect import dask_executor
    from tuner.missions.cluster.executor import DaskExecutor

__all__ = ["DaskExecutor", "dask_executor"]
__getattr__, __dir__, _ = lazy_loader.attach(
    __name__, submod_attrs={"executor": ["DaskExecutor"], "connect": ["dask_executor"]}
)
