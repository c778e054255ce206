"""On which (world, replicate) block a configuration flies."""

from __future__ import annotations

import collections
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from tuner.problem.observations import Proposal
from tuner.problem.worlds import Place, World, worlds_of

MAX_MISSIONS = 100_000  # of a campaign
MAX_REPLICATES = 10_000  # of a rock


class Mission(Protocol):
    """What a block is chosen by: a ledger's trial, an observation or a pending mission."""

    @property
    def values(self) -> Mapping[str, Any]:
        """Tuned parameters."""
        ...

    @property
    def world(self) -> World:
        """Rock and condition."""
        ...

    @property
    def replicate(self) -> int:
        """Number of the draw."""
        ...


def next_block(
    worlds: Sequence[Place], replicates: int, missions: Sequence[Mission], proposal: Proposal
) -> tuple[World, int]:
    """Return the world and the replicate of the next mission where the sampler left them open.

    The world visited least (ties: list order), so worlds are taken in turn; in it the replicate used least among
    those this configuration has not flown there. A configuration that has flown them all gets a fresh number.

    Parameters
    ----------
    worlds
        The training worlds.
    replicates
        Replicates per world.
    missions
        All missions so far, those in flight included.
    proposal
        The mission to place.
    """
    if proposal.world is not None and proposal.replicate is not None:
        return proposal.world, proposal.replicate
    visits = collections.Counter(t.world for t in missions)
    world = proposal.world or min(worlds_of(worlds), key=lambda place: visits[place])
    if proposal.replicate is not None:
        return world, proposal.replicate
    here = [t for t in missions if t.world == world]
    used = collections.Counter(t.replicate for t in here)
    own = {t.replicate for t in here if t.values == proposal.values}
    fresh = [k for k in range(replicates) if k not in own]
    if fresh:
        return world, min(fresh, key=lambda k: (used[k], k))
    return world, next(k for k in range(replicates, replicates + len(own) + 1) if k not in own)
