"""A planner in another process: it reads one state as a line of JSON and answers with one line, the view to fly.

``gatetune ... --plugin NAME=COMMAND`` makes the gate ``NAME``. COMMAND is started once a mission. It is told, in one line,

    {"iteration": 0, "budget": 36, "seeds": 12, "target_m": [0, 0, 0.8], "vehicle_m": [3.5, 0, 1.4], "heading_rad": 3.1,
     "visited_m": [[...], ...], "model": {"points_m": [[...], ...], "error_px": [...], "track_offsets": [...],
     "track_cameras": [...], "cameras_m": [[...], ...]}, "pool": {"ids": ["cand_000", ...], "positions_m": [[...], ...]},
     "seed": 123456789}

(`nbv.types.SparseModel` says what the parts of the model are) and answers ``{"view": "cand_012"}`` or ``{"scores": [...]}``, one
number for each candidate, larger is better. It ends when its input does. What it writes to standard error is in the
mission's log. One that gives no answer for `ANSWER_S` ends the mission as failed.
"""

from __future__ import annotations

import contextlib
import hashlib
import shlex
import shutil
import subprocess
import threading
from pathlib import Path
from typing import ClassVar

import msgspec
import numpy as np

from nbv.errors import MissionFailure, UserError
from nbv.gates.base import Gate, ranking_of
from nbv.plugins import register
from nbv.types import CandidatePool, GateDecision, PlanningState, Ranking

ANSWER_S = 120.0  # time for one answer


class Answer(msgspec.Struct):
    """The view to fly by its id, or a score for each candidate."""

    view: str = ""
    scores: list[float] | None = None


class ExternalGate(Gate):
    """Asks a program; `register_program` makes the subclass of one."""

    command: ClassVar[tuple[str, ...]]
    identity: ClassVar[str]  # of the command and of the files that it names
    _process: subprocess.Popen[bytes] | None = None

    def decide(self, state: PlanningState, pool: CandidatePool, rankings: dict[str, Ranking]) -> GateDecision:
        """The program's answer."""
        kind = self.config.gate.kind
        seed = int(self.rng(state).integers(2**31))
        answer = self._ask(_state_line(state, pool, self.config.target_m, seed))
        if answer.scores is None and answer.view not in pool.ids:
            raise MissionFailure(
                "plugin_failed", f"{kind} answered {answer}, which names no view of the pool"
            )
        chosen = [view == answer.view for view in pool.ids]
        scores = np.array(chosen if answer.scores is None else answer.scores, dtype=float)
        return GateDecision(ranking_of(kind, scores, rankings), f"answer of {self.command[0]}")

    def _ask(self, line: bytes) -> Answer:
        if self._process is None:
            self._process = subprocess.Popen(self.command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        process = self._process
        assert process.stdin is not None and process.stdout is not None
        overdue = threading.Timer(ANSWER_S, process.kill)  # whether it does not read or does not write
        overdue.start()
        try:
            process.stdin.write(line + b"\n")
            process.stdin.flush()
            return msgspec.json.decode(process.stdout.readline(), type=Answer)
        except (OSError, msgspec.DecodeError) as error:
            late = overdue.finished.is_set()
            overdue.cancel()
            why = f"killed after {ANSWER_S:g} s" if late else str(error)
            with contextlib.suppress(subprocess.TimeoutExpired):
                why = why if late else f"exit status {process.wait(1.0)}"
            said = f"gate {self.config.gate.kind!r} of {' '.join(self.command)} gave no usable answer ({why})"
            raise MissionFailure("plugin_failed", said) from error
        finally:
            overdue.cancel()

    def __del__(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()


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
