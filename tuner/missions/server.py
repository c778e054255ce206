"""Runs every mission in a process and session of its own, under a keeper (`tuner.missions.keeper`).

``python -P -m tuner.missions.server MODULE...`` imports the mission's modules once, then forks one child per job
it reads from standard input (a mission starts in milliseconds instead of the seconds its imports take, and finds
the rocks that were run before in memory). Other people's planners are imported in their own missions only.
Where one of its modules starts threads, with which forking is not safe, it begins again without any, and each mission imports
its own. Lines of JSON: in ``{"op": "run", "job": {...}}`` and ``{"op": "kill", "id": ...}``; out
``{"event": "ready" | "started" | "exited" | "beat", ...}``. When standard input closes, i.e. the campaign ended or was
killed, all missions are killed: none outlives its campaign.

Libraries do less: under `concurrent.futures` one aborted mission breaks the pool and a hung one goes on, under pebble
what a hung mission has started outlives the time-out, and under both a mission outlives its killed campaign.
"""

from __future__ import annotations

import contextlib
import faulthandler
import importlib
import json
import os
import selectors
import signal
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

from nbv import plugins
from nbv.cache import Store, code_digest
from nbv.errors import UserError
from nbv.mission.run_directory import WORKER_LOG
from nbv.provenance import provenance
from nbv.safe_files import expanded
from nbv.threads import single_thread_environment
from tuner.missions.job import DUMP_SIGNAL
from tuner.missions.keeper import adopt_orphans, end_children, keep
from tuner.missions.registry import BUILT_IN, uses_store
from tuner.missions.run_job import EXIT_FAILED, run_job

BEAT_S = 1.0  # a server that has nothing to say says so as often, so that one that stands still is noticed
TRUSTED = {"nbv", "tuner"}.union(*(kind.loads for kind in BUILT_IN.values()))  # packages
MAX_HELD_BYTES = 256 * 2**20  # of rocks: eight to ten of the catalogue
# Importing a larger mesh takes more memory than there may be beside the missions.
MAX_FILE_BYTES = 100 * 2**20


class MissionServer:
    def __init__(self, preload: list[str]) -> None:
        # Standard output belongs to the protocol; whatever libraries print goes to standard error.
        self._out = os.fdopen(os.dup(1), "wb", buffering=0)
        os.dup2(2, 1)
        self._in: BinaryIO = os.fdopen(os.dup(0), "rb", buffering=0)
        self._children: dict[int, dict[str, Any]] = {}  # process (= group) id to job
        self._known_rocks: set[str] = set()
        self._held_bytes = 0
        for name in preload:
            try:
                if name.partition(".")[0] in TRUSTED:
                    importlib.import_module(name)
                else:
                    plugins.use(name)  # guarded
            except Exception:  # each mission will meet the same error and record it
                traceback.print_exc()
        _fill_caches_before_forking(preload)
        if preload and len([*Path("/proc/self/task").iterdir()]) > 1:
            os.dup2(self._out.fileno(), 1)
            os.execv(sys.executable, [sys.executable, "-P", "-m", "tuner.missions.server"])
        adopt_orphans()
        self._wake_read, self._wake_write = os.pipe()
        os.set_blocking(self._wake_read, False)
        os.set_blocking(self._wake_write, False)
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(self._wake_write)
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the campaign's business

    def serve(self) -> None:
        self._say({"event": "ready"})
        selector = selectors.DefaultSelector()
        selector.register(self._in, selectors.EVENT_READ)
        selector.register(self._wake_read, selectors.EVENT_READ)
        buffer = b""
        try:
            while True:
                ready = selector.select(BEAT_S)
                if not ready:
                    self._say({"event": "beat"})
                for key, _ in ready:
                    if key.fileobj == self._wake_read:
                        with contextlib.suppress(BlockingIOError):
                            os.read(self._wake_read, 4096)
                        continue
                    chunk = self._in.read(65536)
                    if not chunk:
                        return
                    *lines, buffer = (buffer + chunk).split(b"\n")
                    for line in lines:
                        self._obey(json.loads(line))
                self._reap()
        finally:
            end_children()

    def _obey(self, order: dict[str, Any]) -> None:
        if order["op"] == "kill":
            for pid, job in self._children.items():
                if job["id"] == order["id"]:
                    os.kill(pid, signal.SIGKILL)  # what its keeper leaves behind becomes ours
            return
        job = order["job"]
        try:
            pid = self._start(job)
        except (OSError, UserError) as error:
            self._say({"event": "exited", "id": job["id"], "status": None, "error": str(error)})
            return
        self._children[pid] = job
        self._say({"event": "started", "id": job["id"], "pid": pid})

    def _start(self, job: dict[str, Any]) -> int:
        Path(job["directory"]).mkdir(parents=True, exist_ok=True)
        with (Path(job["directory"]) / WORKER_LOG).open("ab") as log:
            server, pid = os.getpid(), os.fork()
            if not pid:
                self._become_keeper(job, log.fileno(), server)
            return pid

    def _become_keeper(self, job: dict[str, Any], log: int, server: int) -> NoReturn:
        try:
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            for descriptor in (self._out.fileno(), self._in.fileno(), self._wake_read, self._wake_write):
                os.close(descriptor)
            keep(lambda: _run_alone(job), log, server)
        finally:
            os._exit(EXIT_FAILED)

    def _reap(self) -> None:
        for pid in list(self._children):
            ended, status = os.waitpid(pid, os.WNOHANG)
            if not ended:
                continue
            job = self._children.pop(pid)
            end_children(but=frozenset(self._children))
            self._say({"event": "exited", "id": job["id"], "status": os.waitstatus_to_exitcode(status)})
            if status == 0:
                self._hold_rock(job)

    def _hold_rock(self, job: dict[str, Any]) -> None:
        """Load the rock of ``job``, whose mission has ended well, so that the missions forked from now on need not.

        Reading it takes 0.1 s from the store and 0.5 to 1.5 s from a mesh file: more than a geometric mission itself.
        Never before a mission has run it: a mesh that ends the process that reads it ends a mission, not the server.
        """
        rock, fidelity = job["rock"], job["fidelity"]
        held = rock in self._known_rocks or self._held_bytes >= MAX_HELD_BYTES
        if held or not uses_store(fidelity):
            return
        self._known_rocks.add(rock)
        try:
            path = expanded(rock)
            if path.is_file() and path.stat().st_size > MAX_FILE_BYTES:
                return
            mesh = BUILT_IN[fidelity].load_rock(rock, Store())
        except Exception as error:  # the next mission on it meets the same error and records it
            print(f"rock {rock!r} is not shared: {error}", file=sys.stderr)
            return
        self._held_bytes += mesh.vertices_m.nbytes + mesh.faces.nbytes + mesh.albedo.nbytes

    def _say(self, message: dict[str, Any]) -> None:
        try:
            self._out.write(json.dumps(message).encode() + b"\n")
        except BrokenPipeError:
            raise SystemExit(0) from None


def _fill_caches_before_forking(modules: Sequence[str]) -> None:
    """Compute once what all forked missions need: the revision, the installed plug-ins, the digests of the code."""
    provenance()
    for group in plugins.GROUPS:
        plugins.installed(group)
    for module in modules:
        with contextlib.suppress(ValueError):  # of another package
            code_digest(module)


def _run_alone(job: dict[str, Any]) -> int:
    plugins.own_process()
    faulthandler.enable()  # into the log: the line at which compiled code ended the mission
    faulthandler.register(DUMP_SIGNAL, all_threads=False)
    return run_job(job)


if __name__ == "__main__":
    single_thread_environment()
    MissionServer(sys.argv[1:]).serve()
    os._exit(0)  # at once: to take down what it has loaded costs a second, and somebody waits for the prompt
