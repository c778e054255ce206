"""The loop of a peer server: JSON lines in, JSON lines out. Standard library only, so that any peer can use it.

Every request is one line and gets one line in return, ``{"ok": true, ...}`` or ``{"ok": false, "error": ...}``:

``{"do": "start", "parameters", "default", "design", "rocks", "replicates", "initial", "seed"}``
    Begin afresh. ``parameters``: ``[{"name", "kind": float | int | categorical, "low", "high", "log", "choices"}]``.
    ``design``: the initial design, the default configuration first; ``initial`` its size.
    The reply has the peer's name and version.
``{"do": "tell", "number", "values", "rock", "replicate", "outcome", "noise_sd"}``
    How mission ``number`` ended: larger ``outcome`` is better, null is a failure. ``noise_sd`` is the standard
    deviation of that number where it is known, else null. A configuration that ran on several rocks is several tells.
``{"do": "ask", "number", "seed", "pending": [{"number", "values", "rock", "replicate"}], "scales": {rock: [centre, scale]}}``
    The next mission. ``scales`` standardise the outcomes per rock. The reply has ``values`` and, where the peer
    chooses them itself, ``rock`` and ``replicate``; ``cpu_s`` is the processor time the ask took.
``{"do": "stop"}``

What libraries print to standard output goes to standard error, so that the replies stay alone.
"""

from __future__ import annotations

import json
import os
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol


@dataclass
class Trial:
    """One finished mission."""

    number: int
    values: dict[str, Any]
    rock: str
    replicate: int
    outcome: float | None  # larger is better; None: failed
    noise_sd: float | None = None


@dataclass
class Ask:
    """One request for a mission."""

    number: int
    seed: int
    pending: list[dict[str, Any]] = field(default_factory=list)
    scales: dict[str, list[float]] = field(default_factory=dict)

    def standardise(self, trial: Trial) -> float | None:
        """The outcome in standard deviations of its rock, None where it failed."""
        if trial.outcome is None:
            return None
        centre, scale = self.scales.get(trial.rock, (0.0, 1.0))
        return (trial.outcome - centre) / scale

    def standardised_sd(self, trial: Trial) -> float | None:
        """The known noise in standard deviations of the rock."""
        return None if trial.noise_sd is None else trial.noise_sd / self.scales.get(trial.rock, (0.0, 1.0))[1]


class Peer(Protocol):
    """One optimiser at work on one problem."""

    def tell(self, trial: Trial) -> None:
        """A mission has ended."""
        ...

    def ask(self, request: Ask) -> dict[str, Any]:
        """``{"values": ...}``, with ``rock`` and ``replicate`` where the peer chooses them."""
        ...


def serve(name: str, version: str, make: Callable[[Mapping[str, Any]], Peer]) -> None:
    """Answer requests until ``stop`` or the end of the input. ``make`` gets the ``start`` request."""
    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    peer: Peer | None = None
    for line in sys.stdin:
        request = json.loads(line)
        do = request.pop("do")
        began = time.process_time()
        reply: dict[str, Any] = {"ok": True}
        try:
            if do == "stop":
                return
            if do == "start":
                peer = make(request)
                reply |= {"peer": name, "version": version}
            elif peer is None:
                raise RuntimeError(f"{do} before start")
            elif do == "tell":
                peer.tell(Trial(**request))
            elif do == "ask":
                reply |= peer.ask(Ask(**request))
            else:
                raise RuntimeError(f"unknown request {do!r}")
        except Exception as error:  # a library's mistake must reach the client, whatever its kind
            traceback.print_exc()
            reply = {"ok": False, "error": f"{type(error).__name__}: {error}"}
        reply["cpu_s"] = round(time.process_time() - began, 4)
        print(json.dumps(reply), file=replies, flush=True)
