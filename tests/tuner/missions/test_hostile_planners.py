"""Planners that end, hang, flood or forge: each fails alone, is named, and leaves nothing; the others' missions are what they are."""

import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import psutil
import pytest
from test_executors import run_jobs

from nbv import plugins
from nbv.config import preset
from nbv.gates import external
from nbv.mission.run_directory import WORKER_LOG
from nbv.safe_files import remove
from research.hostile_planners import DECISIONS, PROGRAM, PROGRAMS, TOPS, gate
from tuner.missions.executors import Executor, LocalProcessExecutor
from tuner.missions.job import MAX_ATTEMPTS, MissionJob, Trial, load_trial
from tuner.missions.keeper import LOG_BYTES
from tuner.missions.long_runs import Stop
from tuner.missions.run_jobs import JobList
from tuner.missions.run_jobs import run_jobs as fly_all


@pytest.fixture
def bring(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder for modules of planners, in a working directory that holds the missions."""
    monkeypatch.setattr(plugins.registry, "_registered", {})
    monkeypatch.setattr(plugins.registry, "_used", {})
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.chdir(tmp_path)
    known = set(sys.modules)
    yield tmp_path
    for name in sys.modules.keys() - known:
        if name.startswith("planner_"):
            del sys.modules[name]


def bring_all(folder: Path, texts: Sequence[str], programs: Sequence[str] = ()) -> list[MissionJob]:
    """A job of each gate ``{name}`` in ``texts``, and of each program; directories are relative."""
    kinds = []
    for number, text in enumerate(texts):
        file = folder / f"planner_{number}.py"
        file.write_text(text.replace("NAME", f"gate-{number}"))
        plugins.use(str(file))
        kinds.append(f"gate-{number}")
    for number, body in enumerate(programs):
        file = folder / f"program_{number}.py"
        file.write_text(PROGRAM.format(body=body))
        external.bring(f"program-{number}={sys.executable} {file}")
        kinds.append(f"program-{number}")
    return [job(kind) for kind in kinds]


def job(kind: str) -> MissionJob:
    config = preset("campaign").with_values({"gate.kind": kind, "stop.adaptive_budget": 2})
    return MissionJob(kind, config, "slab", 0, Path("missions") / kind, fidelity="geometric")


# By name of the planner: a part of what is said of it, which is ``at planner_N.py, line`` where the line is known.
FAIL = {
    "os._exit(74)": "came to no end in 3 attempts in FILE (output_not_writable",
    "SIGKILL to itself": "came to no end in 3 attempts in FILE (worker_killed: signal 9",
    "kills its parent": "came to no end in 3 attempts in FILE (worker_killed: signal 9",
    "os.abort": "attempts at FILE, line 16 (worker_died: signal 6",
    "sys.exit(3)": "raised SystemExit: 3 (FILE, line 16)",
    "raises MissionFailure disk_full": "raised MissionFailure: not me (FILE, line 16)",
    "raises what cannot be printed": "raised E: (it cannot be printed) (FILE, line 16)",
    "hangs and ignores signals": "the limit of a mission (--timeout-s) at FILE, line 16; see",
    "returns details of 50 MB": "returned details of 50000008 bytes",
    "makes the pool writable": "cannot set WRITEABLE flag to True of this array (FILE, line 16)",
}
GO_ON = ("changes directory", "deletes its directory", "prints 100 MB in one", "writes through ctypes")
GO_ON += ("replaces the pool's positions", "starts a thread")
AWAY = {
    "import, not in the command: hangs": "the limit of a mission (--timeout-s) at FILE, line 10; see",
    "import, not in the command: os._exit(0)": "came to no end in 2 attempts in FILE (worker_died: exit 0",
}


@pytest.mark.slow
def test_each_hostile_planner_fails_alone_and_is_named(bring: Path) -> None:
    """Judged by what the directories hold afterwards, as a table is."""
    others = [job(kind) for kind in ("covis", "b-aware", "hyb-h")]
    with LocalProcessExecutor(2, 300.0, ("geometric",)) as executor:  # what all missions need is made here
        alone = run_jobs(executor, others)
    for each in others:
        remove(each.directory)
    with LocalProcessExecutor(2, 10.0, ("geometric",)) as executor:
        gates = [gate(DECISIONS[name], name="NAME") for name in (*FAIL, *GO_ON)]
        gates += [gate(top=TOPS[name], name="NAME") for name in AWAY]
        jobs = bring_all(bring, gates)
        run_jobs(executor, [*jobs, *others])
        recorded = {each.id: load_trial(each) for each in (*jobs, *others)}
    for each in others:
        assert recorded[each.id].metrics == alone[each.id].metrics
        assert alone[each.id].record.status == "ok"
    said = [*FAIL.values(), *("" for _ in GO_ON), *AWAY.values()]
    for number, (each, expected) in enumerate(zip(jobs, said, strict=True)):
        trial, text = recorded[each.id], expected.replace("FILE", f"planner_{number}.py")
        assert trial is not None and not trial.infrastructure_failure, each.id
        assert trial.record.status == ("failed" if expected else "ok"), trial.record.message
        assert text in trial.record.message
        assert (each.directory / WORKER_LOG).stat().st_size < 3 * LOG_BYTES < 1_000_000


ORPHANS = ("program: leaves children and hangs", "program: hangs")


@pytest.mark.slow
def test_nothing_outlives_a_killed_server(bring: Path) -> None:
    """Nor, when it is not killed, does what a planner's program leaves behind outlive its mission."""
    hanging = bring_all(bring, [], [PROGRAMS[name] for name in ORPHANS])
    with LocalProcessExecutor(2, 60.0, ("geometric",)) as executor:
        for each in hanging:
            executor.submit(each)
        server = psutil.Process(executor._server.pid)
        below: list[psutil.Process] = []
        while not (
            "sleep" in {p.name() for p in below} and any("program_1.py" in str(p.cmdline()) for p in below)
        ):
            executor.wait_any(0.1)
            below = server.children(recursive=True)
        assert len(below) == 7, "a keeper, a mission and a program each, and a child of one"
        server.kill()
        assert not psutil.wait_procs(below, timeout=5.0)[1]


def test_missions_lost_together_are_run_again_alone_and_only_then_charged(bring: Path) -> None:
    """One of them ends the server every time; the other, a good planner of somebody else's, does not pay for it."""
    bad, good = bring_all(bring, [gate(name="NAME"), gate(name="NAME")])

    class Server(Executor):
        """Two missions at a time; whenever the bad one is among them all are lost."""

        capacity = 2
        running: tuple[MissionJob, ...] = ()
        batches: tuple[list[str], ...] = ()

        def submit(self, job: MissionJob) -> None:
            self.running = (*self.running, job)

        def wait_any(self, timeout_s: float) -> list[Trial]:
            ended, self.running = self.running, ()
            self.batches = (*self.batches, [each.id for each in ended])
            lost = bad.id in self.batches[-1]
            return [e.failed("server_lost", "died") if lost else e.trial(status="ok") for e in ended]

        def cancel_all(self) -> None:
            self.running = ()

    ended: dict[str, Trial] = {}
    server = Server(1.0)
    fly_all(
        JobList([good, bad], on_end=lambda trial: ended.update({trial.record.job_id: trial})), server, Stop()
    )
    assert server.batches == ([good.id, bad.id], [good.id], *([bad.id] for _ in range(MAX_ATTEMPTS)))
    assert ended[good.id].record.status == "ok"
    assert ended[bad.id].reason == "plugin_failed" and "gate 'gate-0'" in ended[bad.id].record.message


IMPORTS = """
import sys
import nbv.gates  # which the modules import, too
from nbv import plugins
plugins.importing.IMPORT_S = 3.0
for file in sys.argv[1:]:
    try:
        plugins.use(file)
    except Exception as error:
        print(type(error).__name__, error)
"""
REFUSED = {
    "import: sys.exit(3)": "SystemExit: 3 (FILE, line 10)",
    "import: KeyboardInterrupt": "KeyboardInterrupt (FILE, line 10)",
    "import: os._exit(0)": "it ends the process that imports it, without an error",
    "import: kills itself": "it ends the process that imports it, without an error",
    "import: closes all files": "it",
    "hangs": "it takes longer than 3 s",
    "import: raises": "ZeroDivisionError: division by zero (FILE, line 10)",
}


def test_a_module_that_ends_or_hangs_the_process_is_refused_in_one_line(tmp_path: Path) -> None:
    good = "os.chdir('/'); sys.stdout = None; os.environ['A'] = 'b'"
    tops = {**TOPS, "hangs": DECISIONS["hangs"], "": good}
    files = []
    for number, name in enumerate([*REFUSED, ""]):
        files.append(tmp_path / f"planner_{number}.py")
        files[-1].write_text(gate(top=tops[name]))
    after = "print(os.getcwd(), 'A' in plugins.environment())"
    command = [sys.executable, "-c", f"{IMPORTS}\nimport os; {after}", *map(str, files)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    *lines, last = done.stdout.splitlines()
    assert last == f"{tmp_path} False", done.stderr
    assert len(lines) == len(REFUSED)
    for number, (line, why) in enumerate(zip(lines, REFUSED.values(), strict=True)):
        start = f"UserError plug-in planner_{number} cannot be imported: "
        assert line.startswith(start + why.replace("FILE", f"planner_{number}.py"))
