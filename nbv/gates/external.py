"""A planner in another process: it reads one state as a line of JSON and answers with one line, the view to fly.

``gatetune ... --plugin NAME=COMMAND`` makes the gate ``NAME``. COMMAND is started once a mission. It is told, in one line,

    {"iteration": 0, "budget": 36, "seeds": 12, "target_m": [0, 0, 0.8], "vehicle_m": [3.5, 0, 1.4], "heading_rad": 3.1,
     "visited_m": [[...], ...], "model": {"points_m": [[...], ...], "error_px": [...], "track_offsets": [...],
     "track_cameras": [...], "cameras_m": [[...], ...]}, "pool": {"ids": ["cand_000", ...], "positions_m": [[...], ...]},
     "seed": 123456789}

(`nbv.types.SparseModel` says what the parts of the model are) and answers ``{"view": "cand_012"}`` or ``{"scores": [...]}``, one
number for each candidate, larger is better. It ends when its input does. What it writes to standard error is in the
mission's log, of which the beginning and the end are kept. One that gives no answer for `ANSWER_S`, answers more than
`ANSWER_BYTES`, or more than one line for a state, ends the mission as failed.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import select
import shlex
import shutil
import signal
import subprocess
import threading
import time
import weakref
from pathlib import Path
from typing import ClassVar

import msgspec
import numpy as np

from nbv.errors import MissionFailure, UserError
from nbv.gates.base import Gate, ranking_of
from nbv.plugins import register, shortened, use
from nbv.types import CandidatePool, GateDecision, PlanningState, Ranking

ANSWER_S = 120.0  # time for one answer
ANSWER_BYTES = 1_000_000
_LIBC = ctypes.CDLL(None)  # before a fork, after which little is safe


class Answer(msgspec.Struct):
    """The view to fly by its id, or a score for each candidate."""

    view: str = ""
    scores: list[float] | None = None


class ExternalGate(Gate):
    command: ClassVar[tuple[str, ...]]
    identity: ClassVar[str]  # of the command and of the files that it names
    _program: _Program | None = None

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        gate = f"gate {self.config.gate.kind!r} of {' '.join(self.command)}"
        seed = int(self.rng(state).integers(2**31))
        try:
            self._program = self._program or _Program(self.command)
            answer = self._program.ask(_state_line(state, pool, self.config.target_m, seed))
        except (OSError, ValueError) as error:
            message = f"{gate} gave no usable answer ({shortened(str(error))})"
            raise MissionFailure("plugin_failed", message) from error
        if answer.scores is None and answer.view not in pool.ids:
            message = f"{gate} answered {shortened(str(answer))}, which names no view of the pool"
            raise MissionFailure("plugin_failed", message)
        chosen = [view == answer.view for view in pool.ids]
        scores = np.array(chosen if answer.scores is None else answer.scores, dtype=float)
        return GateDecision(
            ranking_of(self.config.gate.kind, scores, rankings), f"answer of {self.command[0]}"
        )


class _Program:
    """The running program of one mission; it ends, with its process group, when nothing refers to it any more."""

    def __init__(self, command: tuple[str, ...]) -> None:
        self._process = subprocess.Popen(
            command,
            bufsize=0,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
            preexec_fn=_end_with_parent,
        )
        weakref.finalize(self, _end, self._process)

    def ask(self, line: bytes) -> Answer:
        """The answer to one line; ``OSError`` or ``ValueError`` says why there is none."""
        process = self._process
        assert process.stdin is not None and process.stdout is not None
        output = process.stdout.fileno()
        if select.select([output], [], [], 0.0)[0] and os.read(output, 1):
            raise ValueError("it wrote a line that was not asked for")
        began, overdue = time.monotonic(), threading.Timer(ANSWER_S, _end, [process])
        overdue.start()  # whether it does not read or does not write
        try:
            rest = memoryview(line + b"\n")
            while rest:
                rest = rest[process.stdin.write(rest) :]
            answer, chunk = b"", b"."
            while chunk and not chunk.endswith(b"\n") and len(answer) <= ANSWER_BYTES:
                chunk = os.read(output, 65536)
                answer += chunk
            if len(answer) > ANSWER_BYTES:
                raise ValueError(f"more than {ANSWER_BYTES} bytes")
            if answer.count(b"\n") > 1:
                raise ValueError("more than one line")
            return msgspec.json.decode(answer, type=Answer)
        except (OSError, msgspec.DecodeError) as error:
            if time.monotonic() - began >= ANSWER_S:
                raise ValueError(f"killed after {ANSWER_S:g} s") from error
            with contextlib.suppress(subprocess.TimeoutExpired):
                raise ValueError(f"exit status {process.wait(1.0)}") from error
            raise
        finally:
            overdue.cancel()


def _end_with_parent() -> None:
    _LIBC.prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


def _end(process: subprocess.Popen[bytes]) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.wait()


def _state_line(state: PlanningState, pool: CandidatePool, target_m: tuple[float, ...], seed: int) -> bytes:
    model = state.model
    return msgspec.json.encode(
        {
            "iteration": state.iteration,
            "budget": state.adaptive_budget,
            "seeds": state.n_seeds,
            "target_m": target_m,
            "vehicle_m": state.vehicle_position_m.tolist(),
            "heading_rad": float(state.vehicle_heading_rad),
            "visited_m": state.visited_m.tolist(),
            "model": {
                "points_m": model.points_m.tolist(),
                "error_px": model.reprojection_error_px.tolist(),
                "track_offsets": model.track_offsets.tolist(),
                "track_cameras": model.track_cameras.tolist(),
                "cameras_m": model.camera_centers_m.tolist(),
            },
            "pool": {"ids": pool.ids, "positions_m": pool.positions_m.tolist()},
            "seed": seed,
        }
    )


def bring(spec: str) -> None:
    """Bring what ``--plugin`` names: a module or file that registers parts, or ``NAME=COMMAND``, a planner in another process.

    `UserError` where it cannot be brought.
    """
    name, equals, command = spec.partition("=")
    if equals:
        register_program(name, command)
    else:
        use(spec)


def register_program(name: str, command: str) -> None:
    """Make the gate ``name`` of a program.

    `UserError` where the program does not exist.
    """
    words = shlex.split(command)
    if not words or shutil.which(words[0]) is None:
        raise UserError(f"--plugin {name}={command}: there is no program {words[0] if words else ''!r}")
    files = [Path(word) for word in words if Path(word).is_file()]
    content = b"".join(file.read_bytes() for file in files)
    identity = hashlib.sha256(command.encode() + content).hexdigest()
    gate = type("ProgramGate", (ExternalGate,), {"command": tuple(words), "identity": identity})
    register("gates", name, gate, f"{name}={command}")
