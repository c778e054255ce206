"""Optimisers that live in environments of their own, as samplers: Ax, SMAC3 and HEBO.

Each runs as a subprocess that speaks JSON lines (``research/peers/serving.py`` has the protocol). The process
is kept between asks and told every mission once; when the history is not the one it was told (a resume, another
campaign), it begins afresh and is told everything again.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

import numpy as np

from nbv.errors import UserError
from tuner.problem.observations import Observation, Proposal
from tuner.problem.search_space import Parameter, Values
from tuner.problem.standardise import RockStandardiser
from tuner.samplers.base import SamplerSettings, derived_seed, initial_proposal

PEER_NAMES = ("ax", "smac", "hebo")
OWN_DESIGN = ("smac",)  # these run the initial design themselves
_DISTRIBUTIONS = {"ax": "ax-platform", "smac": "smac"}  # of the extra `peers`
PEERS_DIRECTORY_VARIABLE = "GATETUNE_PEERS"  # where the environments are; default: .peers of the clone
MIN_FEASIBLE = 2
REPLY_TIMEOUT_S = 900.0
_CLONE = Path(__file__).resolve().parents[2]


def peer_command(name: str) -> list[str]:
    """Command line of the server of a peer, in its own environment or, with the extra ``peers``, in this one.

    Raises
    ------
    UserError
        It has not been set up.
    """
    environments = Path(os.environ.get(PEERS_DIRECTORY_VARIABLE) or _CLONE / ".peers")
    python = environments / name / "bin" / "python"
    server = Path(__file__).with_name(f"{name}_server.py")
    if not (environments / name / ".ready").is_file() or not python.exists():
        if name in _DISTRIBUTIONS and any(distributions(name=_DISTRIBUTIONS[name])):
            return [sys.executable, str(server)]
        raise UserError(
            f"sampler {name} needs an environment of its own, which is not there; set it up with "
            f"`python -m research.peers.setup {name}`"
        )
    return [str(python), str(server)]


def available_peers() -> tuple[str, ...]:
    """The peers that have been set up here."""

    def is_there(name: str) -> bool:
        try:
            peer_command(name)
        except UserError:
            return False
        return True

    return tuple(name for name in PEER_NAMES if is_there(name))


class PeerProcess:
    """A peer's server and the pipe to it.

    Raises
    ------
    UserError
        It cannot be started, dies, does not answer, or reports an error.
    """

    def __init__(self, name: str, command: Sequence[str]) -> None:
        self.name = name
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the process
        # One thread as everywhere; a session of its own, so that Ctrl-C stops the campaign and not the peer first.
        environment = dict(os.environ, OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", PYTHONUNBUFFERED="1")
        environment.pop("PYTHONPATH", None)
        try:
            self._process = subprocess.Popen(
                list(command),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._log,
                text=True,
                env=environment,
                start_new_session=True,
            )
        except OSError as error:
            raise UserError(f"cannot start the peer {name}: {error}; set it up again") from error
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        threading.Thread(target=self._read, daemon=True).start()
        self.close = weakref.finalize(self, _stop, self._process, self._log)

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.put(line)
        self._lines.put("")

    def request(self, do: str, **fields: Any) -> dict[str, Any]:
        """Send one request and wait for its reply."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps({"do": do, **fields}) + "\n")
            self._process.stdin.flush()
            line = self._lines.get(timeout=REPLY_TIMEOUT_S)
        except (OSError, ValueError):  # the pipe is broken or closed
            line = ""
        except queue.Empty:
            self.close()
            raise UserError(
                f"the peer {self.name} gave no answer to {do!r} within {REPLY_TIMEOUT_S:g} s; "
                "resume the campaign, or choose another sampler"
            ) from None
        if not line:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(timeout=5.0)
            last = self._last_words()
            self.close()
            raise UserError(
                f"the peer {self.name} ended at {do!r} ({last}); set it up again with "
                f"`python -m research.peers.setup {self.name}`, then resume"
            )
        reply: dict[str, Any] = json.loads(line)
        if not reply["ok"]:
            raise UserError(
                f"the peer {self.name} cannot {do}: {reply['error']}; resume the campaign, or choose another sampler"
            )
        return reply

    @property
    def alive(self) -> bool:
        """Whether it still runs."""
        return self.close.alive and self._process.poll() is None

    def _last_words(self) -> str:
        self._log.seek(0)
        lines = self._log.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else f"exit status {self._process.poll()}"


def _stop(process: subprocess.Popen[str], log: Any) -> None:
    with contextlib.suppress(OSError):
        if process.stdin is not None:
            process.stdin.close()
    try:
        process.wait(timeout=1.0)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    log.close()


@dataclass
class _Shared:
    """The one process of a peer in this interpreter, and the sampler it works for now."""

    process: PeerProcess
    owner: weakref.ref[PeerSampler]


_processes: dict[str, _Shared] = {}  # starting a peer takes seconds, so samplers of one kind share it in turn


@dataclass(eq=False)
class PeerSampler:
    """A peer behind the campaign's ask; outcomes are standardised per world as for every other sampler."""

    settings: SamplerSettings
    name: str
    command: Callable[
        [], Sequence[str]
    ]  # of the server; looked up when the campaign runs, not when it is read
    own_design: bool = False
    _told: dict[int, str] = field(default_factory=dict, repr=False)

    def ask(self, history: Sequence[Observation], pending: Sequence[Observation]) -> Proposal:
        """The peer's proposal, or the next point of the common initial design.

        Raises
        ------
        UserError
            The peer cannot be reached, fails, or proposes something outside the space.
        """
        command = self.command()  # first, so that a missing peer is noticed before any mission
        number = len(history) + len(pending)
        feasible = [o for o in history if o.outcome is not None]
        if not self.own_design and (number < self.settings.initial or len(feasible) < MIN_FEASIBLE):
            return initial_proposal(self.settings, number, self.name)
        process = self._process(history, command)
        outcomes = np.array([o.outcome for o in feasible], dtype=float)
        standard = RockStandardiser.fit([o.instance for o in feasible], outcomes)
        # To a peer a rock under another condition is another rock.
        known = {
            instance.label: instance
            for instance in (*self.settings.problem.instances, *(o.instance for o in history))
        }
        reply = process.request(
            "ask",
            number=number,
            seed=derived_seed(self.settings.seed, number),
            pending=[
                {
                    "number": p.number,
                    "values": dict(p.values),
                    "rock": p.instance.label,
                    "replicate": p.replicate,
                }
                for p in pending
            ],
            scales={
                label: [standard.centre(known[label]), standard.scale(known[label])]
                for label in sorted(known)
            },
        )
        why = {"sampler": self.name, "phase": "model", "peer_cpu_s": reply["cpu_s"]}
        instance = None if reply.get("rock") is None else known[reply["rock"]]
        return Proposal(self._values(reply["values"]), why, instance, reply.get("replicate"))

    def _process(self, history: Sequence[Observation], command: Sequence[str]) -> PeerProcess:
        """The process, told the whole of ``history``."""
        wanted = {o.number: _fingerprint(o) for o in history}
        shared = _processes.get(self.name)
        same = shared is not None and shared.process.alive and shared.owner() is self
        if shared is None or not same or any(wanted.get(n) != f for n, f in self._told.items()):
            shared = self._begin(command)
        for o in history:
            if o.number not in self._told:
                shared.process.request(
                    "tell",
                    number=o.number,
                    values=dict(o.values),
                    rock=o.instance.label,
                    replicate=o.replicate,
                    outcome=o.outcome,
                    noise_sd=None,
                )
                self._told[o.number] = wanted[o.number]
        return shared.process

    def _begin(self, command: Sequence[str]) -> _Shared:

        shared = _processes.get(self.name)
        if shared is None or not shared.process.alive:
            shared = _Shared(PeerProcess(self.name, command), weakref.ref(self))
            _processes[self.name] = shared
        s = self.settings
        shared.owner = weakref.ref(self)
        self._told.clear()
        shared.process.request(
            "start",
            parameters=[_parameter(p) for p in s.problem.space.parameters],
            default=dict(s.problem.default),
            design=[initial_proposal(s, i, self.name).values for i in range(s.initial)],
            rocks=[instance.label for instance in s.problem.instances],
            replicates=s.problem.replicates,
            initial=s.initial,
            seed=s.seed,
        )
        return shared

    def _values(self, proposed: dict[str, Any]) -> Values:
        values: Values = {}
        for p in self.settings.problem.space.parameters:
            value = proposed[p.path]
            if p.kind == "float" and isinstance(value, float):
                value = _within_rounding(value, p)
            if not p.contains(value):
                raise UserError(
                    f"the peer {self.name} proposed {p.path} = {value!r}, which is outside the search space; "
                    "choose another sampler"
                )
            values[p.path] = value
        return values


def _within_rounding(value: float, p: Parameter) -> float:
    """``value`` put back on a bound that a logarithm and back has left by a rounding error."""
    slack = 1e-9 * (p.high - p.low)
    nearest = min(p.high, max(p.low, value))
    return nearest if abs(nearest - value) <= slack else value


def _fingerprint(o: Observation) -> str:
    return json.dumps([dict(o.values), o.instance.label, o.replicate, o.outcome], sort_keys=True)


def _parameter(p: Parameter) -> dict[str, Any]:
    return {
        "name": p.path,
        "kind": p.kind,
        "low": p.low,
        "high": p.high,
        "log": p.scale == "log",
        "choices": list(p.choices),
    }


def make_peer_sampler(name: str, settings: SamplerSettings) -> PeerSampler:
    """The peer called ``name``, one of ``PEER_NAMES``; its environment is looked for at the first ask."""
    return PeerSampler(settings, name, functools.partial(peer_command, name), own_design=name in OWN_DESIGN)
