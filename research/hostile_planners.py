"""`make hostile`: unfinished and hostile planners beside two sound strategies, and whether the others' table stands.

Each planner is compared with ``orbit`` and ``covis`` by the command, in a process or as a program. *Stands*: the command ends
well and the others' missions and table are what they are without it. *Refused*: it cannot be imported, and one line says so
before anything runs. Either must name the planner. *Left*: processes that outlive the command. *Kept*: the most bytes that a
mission's directory, the page or the output holds. ``--only NAME`` runs some.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from pathlib import Path
from typing import Any

import psutil

ROOT = Path(__file__).resolve().parents[1]
MARK = "HOSTILE_PLANNER"  # a variable by which what a planner leaves behind is found
LIMIT_S, TIMEOUT_S = 120.0, 8.0
OTHERS = ("orbit", "covis")
COLUMNS = ("planner", "ending", "others_stand", "named", "left", "kept_bytes", "seconds")

GATE = """
import ctypes, os, shutil, signal, subprocess, sys, tempfile, threading, time
import numpy as np
from nbv.errors import MissionFailure, UserError
from nbv.gates import Gate
from nbv.plugins import register
from nbv.types import GateDecision, Ranking

IS_COMMAND = "tuner.missions.server" not in sys.orig_argv
{top}

class Bad(Gate):
    def decide(self, state, pool, rankings):
        covis = rankings["covis"]
        count = len(pool)
        {body}
        return GateDecision(covis, "covis")

register("gates", "{name}", Bad)
"""
DECISIONS = {
    "raises": "1 / 0",
    "raises a string of 50 MB": "raise ValueError('x' * 50_000_000)",
    "raises what cannot be printed": "raise type('E', (Exception,), {'__str__': lambda self: 1 / 0})()",
    "raises UserError": "raise UserError('no such map')",
    **{
        f"raises MissionFailure {reason}": f"raise MissionFailure({reason!r}, 'not me')"
        for reason in (
            "disk_full",
            "machine_error",
            "output_not_writable",
            "server_lost",
            "worker_killed",
            "user_error",
        )
    },
    "raises OSError of a full disk": "raise OSError(28, 'No space left on device')",
    "MemoryError": "raise MemoryError",
    "allocates without end": "keep = [bytearray(2**40)]",
    "RecursionError": "f = lambda: f(); f()",
    "KeyboardInterrupt": "raise KeyboardInterrupt",
    "GeneratorExit": "raise GeneratorExit",
    **{f"sys.exit({code})": f"sys.exit({code})" for code in (0, 3, 74)},
    **{f"os._exit({code})": f"os._exit({code})" for code in (0, 1, 70, 74)},
    **{
        f"{name} to itself": f"os.kill(os.getpid(), signal.{name})"
        for name in ("SIGKILL", "SIGTERM", "SIGSTOP", "SIGSEGV")
    },
    "os.abort": "os.abort()",
    "kills its parent": "os.kill(os.getppid(), signal.SIGKILL); time.sleep(5)",  # else a short mission may end first
    "kills its group": "os.killpg(0, signal.SIGKILL)",
    "reads a null pointer": "ctypes.string_at(0)",
    "hangs": "time.sleep(3600)",
    "hangs and ignores signals": "[signal.signal(n, signal.SIG_IGN) for n in (1, 2, 3, 15)]; time.sleep(3600)",
    "an alarm": "signal.alarm(1); time.sleep(3600)",
    "changes directory": "os.chdir('/')",
    "deletes its directory": "d = tempfile.mkdtemp(); os.chdir(d); os.rmdir(d)",
    "deletes the mission's directory": "shutil.rmtree(os.path.join(os.environ['HOSTILE_OUT'], 'missions', 'bad'))",
    "closes all files": "os.closerange(0, 1000)",
    "closes standard output": "os.close(1); os.close(2); sys.stdout.close()",
    "prints 100 MB in lines": "print(('x' * 99 + '\\n') * 1_000_000)",
    "prints 100 MB in one": "sys.stderr.write('x' * 100_000_000)",
    "leaves a daemon": "subprocess.Popen(['sleep', '3600'], start_new_session=True)",
    "forks and hangs": "os.fork(); os.setsid(); os.fork(); time.sleep(3600)",
    "starts a thread": "threading.Thread(target=time.sleep, args=(3600,)).start()",
    "changes random numbers": "np.random.seed(0); np.random.default_rng = None",
    "changes the environment": "os.environ.clear()",
    "changes handlers": "signal.signal(signal.SIGCHLD, signal.SIG_IGN); signal.signal(signal.SIGTERM, lambda *_: None)",
    "writes to the pool": "pool.positions_m[:] = 0",
    "makes the pool writable": "pool.positions_m.flags.writeable = True; pool.positions_m[:] = 0",
    "writes through base": "a = pool.positions_m; a = a if a.base is None else a.base; a[:] = 0",
    "writes through ctypes": "ctypes.memset(pool.positions_m.ctypes.data, 0, pool.positions_m.nbytes)",
    "replaces the pool's positions": "object.__setattr__(pool, 'positions_m', np.zeros((count, 3)))",
    "writes to the rankings' pool": "rankings._pool.positions_m.setflags(write=True); rankings._pool.positions_m[:] = 0",
    "changes its configuration": "object.__setattr__(self.config.stop, 'adaptive_budget', 10**9)",
    "finds our pool": (
        "f = sys._getframe()\n"
        "        while 'view' not in f.f_code.co_varnames: f = f.f_back\n"
        "        p = f.f_locals['self'].viewpoints; type(p).candidates = lambda *_: pool"
    ),
    "returns nothing": "return None",
    "returns NaN": "return GateDecision(Ranking('bad', np.arange(count), np.full(count, np.nan), {}), '')",
    "returns a candidate out of range": "return GateDecision(Ranking('bad', np.arange(count) + 1, np.zeros(count), {}), '')",
    "returns a short order": "return GateDecision(Ranking('bad', np.arange(1), np.zeros(count), {}), '')",
    "returns terms of texts": "return GateDecision(Ranking('bad', np.arange(count), np.zeros(count), {'main': 'x'}), '')",
    "returns a reason of 50 MB": "return GateDecision(covis, 'x' * 50_000_000)",
    "returns details of 50 MB": "return GateDecision(covis, '', {'a': 'x' * 50_000_000})",
    "returns details that are no JSON": "d = {}; d['d'] = d; return GateDecision(covis, '', d)",
}
TOPS = {  # at import
    "import: raises": "1 / 0",
    "import: sys.exit(3)": "sys.exit(3)",
    "import: KeyboardInterrupt": "raise KeyboardInterrupt",
    "import: os._exit(0)": "os._exit(0)",
    "import: kills itself": "os.kill(os.getpid(), signal.SIGKILL)",
    "import: kills its parent, not the command": "IS_COMMAND or os.kill(os.getppid(), signal.SIGKILL)",
    "import: closes all files": "os.closerange(0, 1000)",
    "import: changes directory": "os.chdir('/')",
    "import: changes environment": "os.environ['GATETUNE_HOME'] = '/nowhere'; os.environ['PYTHONPATH'] = '/nowhere'",
    "import: starts a thread": "threading.Thread(target=time.sleep, args=(3600,), daemon=True).start()",
    "import: ignores signals": "signal.signal(signal.SIGINT, signal.SIG_IGN); signal.signal(signal.SIGCHLD, signal.SIG_IGN)",
    **{
        f"import, not in the command: {name}": f"IS_COMMAND or {code}"
        for name, code in {
            "raises": "int('x')",
            "sys.exit(0)": "sys.exit(0)",
            "os._exit(0)": "os._exit(0)",
            "hangs": "time.sleep(3600)",
            "SIGKILL": "os.kill(os.getpid(), signal.SIGKILL)",
        }.items()
    },
    "import: breaks the others' planner": "import nbv.scorers.covis as c; c.COVIS.rank.__func__.__code__ = (lambda *a: 1 / 0).__code__",
}
PROGRAM = """
import json, os, signal, subprocess, sys, time
for line in sys.stdin:
    state = json.loads(line)
    view = state["pool"]["ids"][0]
    {body}
    print(json.dumps({{"view": view}}), flush=True)
"""
PROGRAMS = {
    "program: raises": "1 / 0",
    "program: exits with 74": "os._exit(74)",
    "program: is killed": "os.kill(os.getpid(), signal.SIGKILL)",
    "program: kills its parent": "os.kill(os.getppid(), signal.SIGKILL)",
    "program: kills its group": "os.killpg(0, signal.SIGKILL)",
    "program: hangs": "time.sleep(3600)",
    "program: does not read": "sys.stdin.close(); time.sleep(3600)",
    "program: is stopped": "os.kill(os.getpid(), signal.SIGSTOP)",
    "program: leaves children": "[subprocess.Popen(['sleep', '3600'], start_new_session=s) for s in (True, False)]",
    "program: leaves children and hangs": "subprocess.Popen(['sleep', '3600'], start_new_session=True); time.sleep(3600)",
    "program: answers 50 MB": "view = 'x' * 50_000_000",
    "program: answers without end": "while True: sys.stdout.write('x' * 2**20)",
    "program: answers lines without end": "while True: print('{}')",
    "program: two lines": "print('{}')",
    "program: no JSON": "view = object",
    "program: another view": "view = 'cand_999999'",
    "program: floods standard error": "sys.stderr.write('x' * 100_000_000)",
    "program: NaN": "print('{\"scores\": [NaN]}', flush=True); continue",
    "program: deep JSON": "print('[' * 100_000, flush=True); continue",
    "program: deletes its directory": "os.chdir('/tmp'); d = f'/tmp/{os.getpid()}'; os.mkdir(d); os.chdir(d); os.rmdir(d)",
}


def gate(body: str = "pass", top: str = "", name: str = "bad") -> str:
    """The text of a module with a gate."""
    return GATE.format(name=name, top=top, body=body)


def planners(folder: Path) -> dict[str, str]:
    """What ``--plugin`` is told, by the planner's name; files are written into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = {name: gate(body) for name, body in DECISIONS.items()}
    texts |= {name: gate(top=top) for name, top in TOPS.items()}
    texts |= {name: PROGRAM.format(body=body) for name, body in PROGRAMS.items()}
    found = {}
    for number, (name, text) in enumerate(texts.items()):
        file = folder / f"bad_{number}.py"
        file.write_text(text)
        found[name] = f"bad={sys.executable} {file}" if name in PROGRAMS else str(file)
    return found


class Comparison:
    """One call of ``gatetune compare`` in a folder, with a relative run directory."""

    def __init__(self, folder: Path, plugin: str = "") -> None:
        self.folder, self.mark = folder, uuid.uuid4().hex
        folder.mkdir()
        options = ["--plugin", plugin] if plugin else []
        options += [
            "compare",
            *(f"--strategy={name}" for name in OTHERS),
            *(["--strategy=bad"] if plugin else []),
        ]
        options += [
            "--against=orbit",
            "--targets=1",
            "--numbers=12,14",
            "--score=80",
            "--share=0.5",
            "--workers=2",
        ]
        command = [
            sys.executable,
            "-P",
            "-m",
            "tuner.cli",
            *options,
            f"--timeout-s={TIMEOUT_S:g}",
            "--out=out",
            "--json",
        ]
        environment = {
            **os.environ,
            "PYTHONPATH": str(ROOT),
            MARK: self.mark,
            "HOSTILE_OUT": str(folder / "out"),
        }
        self.began = time.monotonic()
        with (folder / "output").open("wb") as output, (folder / "errors").open("wb") as errors:
            self.process = subprocess.Popen(
                command, cwd=folder, env=environment, stdout=output, stderr=errors
            )

    def end(self) -> str:
        """Wait for it: ``exit N``, ``signal N``, or ``hang``."""
        try:
            status = self.process.wait(LIMIT_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            return "hang"
        return f"exit {status}" if status >= 0 else f"signal {-status}"

    @property
    def others(self) -> Any:
        """The others' part of the document, and what they measured; None where there is none."""
        try:
            document = json.loads((self.folder / "output").read_text())
        except ValueError:
            return None
        rows = [row for key in ("findings", "standings") for row in document[key]]
        rows = [row for row in rows if row.get("name", row.get("strategy")) in OTHERS]
        files = sorted(self.folder.glob("out/missions/*/*/mission.json"))
        metrics = {f.parts[-3]: json.loads(f.read_text())["metrics"] for f in files if f.parts[-3] != "bad"}
        return rows, metrics

    @property
    def said(self) -> str:
        return (self.folder / "output").read_text() + (self.folder / "errors").read_text()

    def left(self) -> list[psutil.Process]:
        """Processes of it that live."""
        found = []
        for process in psutil.process_iter():
            try:
                if process.environ().get(MARK) == self.mark and process.status() != psutil.STATUS_ZOMBIE:
                    found.append(process)
            except psutil.Error:
                continue
        return found

    @property
    def kept_bytes(self) -> int:
        """Of a mission's directory, of the page and of the output, the most."""
        sizes = [
            sum(f.stat().st_size for f in d.rglob("*") if f.is_file())
            for d in self.folder.glob("out/missions/bad/*")
        ]
        return max([*sizes, *((self.folder / name).stat().st_size for name in ("output", "errors"))])


def try_one(folder: Path, plugin: str, alone: Any) -> dict[str, Any]:
    """A row of the table; ``alone``: what the others come to without the planner."""
    comparison = Comparison(folder, plugin)
    ending = comparison.end()
    seconds = time.monotonic() - comparison.began
    time.sleep(0.2)
    left = comparison.left()
    for process in left:
        process.kill()
    said = comparison.said
    refused = ending == "exit 2" and "cannot be imported" in said and said.count("\n") == 1
    return {
        "ending": "refused" if refused else ending,
        "others_stand": refused or (ending == "exit 0" and comparison.others == alone),
        "named": "Traceback" not in said
        and (Path(plugin.split()[-1]).stem in said or "plugin_failed" not in said),
        "left": len(left),
        "kept_bytes": comparison.kept_bytes,
        "seconds": round(seconds, 1),
    }


def kill_servers(folder: Path, plugins: dict[str, str]) -> tuple[int, int]:
    """Kill the server, then the coordinator, while planners hang: how often, and processes that live on after it."""
    tried = alive = 0
    for name in (
        "program: leaves children and hangs",
        "program: hangs",
        "forks and hangs",
        "hangs and ignores signals",
    ):
        for coordinator in (False, True):
            comparison = Comparison(folder / f"kill_{tried}", plugins[name])
            deadline = time.monotonic() + LIMIT_S
            while time.monotonic() < deadline and not (
                log := [*comparison.folder.glob("out/missions/bad/*/worker.log")]
            ):
                time.sleep(0.05)
            time.sleep(1.5)
            server = next(
                p
                for p in psutil.Process(comparison.process.pid).children()
                if "tuner.missions.server" in p.cmdline()
            )
            below = server.children(recursive=True)
            assert log and len(below) >= 2
            if coordinator:
                comparison.process.kill()
            server.send_signal(signal.SIGKILL)
            _, left = psutil.wait_procs(below, timeout=5)
            tried, alive = tried + 1, alive + len([p for p in left if p.status() != psutil.STATUS_ZOMBIE])
            comparison.process.kill()
            comparison.process.wait()
            time.sleep(1)
            for process in comparison.left():
                process.kill()
    return tried, alive


def main() -> int:
    """Exit status 1 where there is a finding."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", action="append", help="name of a planner, or a part of it; repeatable")
    parser.add_argument("--out", type=Path, default=Path("runs") / "hostile")
    given = parser.parse_args()
    rows, findings = [], 0
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        os.environ["GATETUNE_HOME"] = str(folder / "home")
        alone = Comparison(folder / "alone")
        assert alone.end() == "exit 0" and alone.others is not None, alone.said
        plugins = planners(folder / "planners")
        for number, (name, plugin) in enumerate(plugins.items()):
            if given.only and not any(part in name for part in given.only):
                continue
            row = {"planner": name, **try_one(folder / str(number), plugin, alone.others)}
            rows.append(row)
            print(*row.values(), sep="  ", flush=True)
            findings += (
                not (row["others_stand"] and row["named"]) or row["left"] > 0 or row["kept_bytes"] > 10**6
            )
        killed = (0, 0) if given.only else kill_servers(folder, plugins)
    given.out.mkdir(parents=True, exist_ok=True)
    with (given.out / "planners.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, COLUMNS)
        table.writeheader()
        table.writerows(rows)
    print(
        f"the others' table stands after {sum(r['others_stand'] for r in rows)} of {len(rows)} planners; the planner is named"
    )
    print(f"by {sum(r['named'] for r in rows)}; {sum(r['left'] for r in rows)} processes are left; at most")
    print(
        f"{max((r['kept_bytes'] for r in rows), default=0)} bytes are kept; servers killed: {killed[0]}, processes that live on: {killed[1]}"
    )
    return int(findings > 0 or killed[1] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
