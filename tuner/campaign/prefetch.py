"""Proposals are prefetched in a thread while missions fly: with many workers one of them is always free.

A prefetched proposal is not in the ledger yet: a campaign that ends forgets it, and its resume asks for another one.
"""

from __future__ import annotations

import collections
import concurrent.futures
import ctypes
from collections.abc import Sequence

from tuner.campaign.campaign import Campaign
from tuner.missions.job import Trial
from tuner.problem.observations import Proposal

FROM_WORKERS = 8  # with fewer a proposal is made when its worker is free, knowing all that has ended
SHARE = 4  # of the workers' number: proposals of one batch, and as many are kept
MAX_BATCH = 256


class ProposalPrefetch:
    """A queue of proposals that refills itself."""

    def __init__(self, campaign: Campaign) -> None:
        self._campaign = campaign
        self._ready: collections.deque[Proposal] = collections.deque()
        self._thread = concurrent.futures.ThreadPoolExecutor(1)
        self._asked: concurrent.futures.Future[list[Proposal]] | None = None

    def next(self, trials: Sequence[Trial], workers: int) -> Proposal | None:
        """Return the next proposal after ``trials``.

        None means that the budget is used or, while `thinking`, that no proposal is ready yet.
        """
        self._collect()
        batch = max(2, min(workers // SHARE, MAX_BATCH))
        left = self._campaign.settings.budget - len(trials) - len(self._ready)
        if self._asked is None and left > 0 and len(self._ready) < batch:
            self._asked = self._thread.submit(
                self._campaign.propose_many, list(trials), list(self._ready), min(batch, left)
            )
        return self._ready.popleft() if self._ready else None

    @property
    def thinking(self) -> bool:
        """Whether a batch of proposals is being computed."""
        return self._asked is not None

    def close(self) -> None:
        """Drop the prefetched proposals and stop computing more."""
        if self._asked is not None and not self._asked.cancel():
            for thread in self._thread._threads:  # its next instruction raises this
                raise_in = ctypes.pythonapi.PyThreadState_SetAsyncExc
                raise_in(ctypes.c_ulong(thread.ident or 0), ctypes.py_object(SystemExit))
        self._thread.shutdown(wait=True, cancel_futures=True)

    def _collect(self) -> None:
        if self._asked is not None and self._asked.done():
            asked, self._asked = self._asked, None
            self._ready.extend(asked.result())
