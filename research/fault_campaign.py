"""A campaign that is to meet faults: its sessions, its processes, and the ledger against the record of what finished."""

from __future__ import annotations

import contextlib
import faulthandler
import os
import random
import select
import signal
import socket
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from research.failing_calls import FailingCalls, hold_calls

if TYPE_CHECKING:
    from tuner.missions.job import Trial

BUDGET, LIMIT_S = 24, 60.0
SETTINGS = """
name: faults
space: gate
rocks: [boulder, slab]
conditions: [ideal]
budget: {budget}
sampler: sobol
learn_from: []
objective: observable.f_score_48mm
fidelity: faults
"""


@dataclass
class Session:
    """One call of the command, from its start to its end."""

    pid: int
    output: Path
    calls: FailingCalls | None = None
    began: float = field(default_factory=time.monotonic)
    status: int | None = None  # exit status, or minus a signal

    def ended(self) -> bool:
        if self.status is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.status = os.waitstatus_to_exitcode(status)
        return self.status is not None

    def server(self) -> int | None:
        """The process that missions' processes are forked from."""
        for pid in children(self.pid):
            with contextlib.suppress(OSError):
                if b"forkserver" in Path(f"/proc/{pid}/cmdline").read_bytes():
                    return pid
        return None

    def worker(self) -> int | None:
        """A process that takes missions."""
        return next(iter(children(self.server() or 0)), None)

    def verdict(self) -> str:
        text = self.output.read_text(errors="replace")
        if self.status is None:
            return "hang"
        if "Traceback (most recent" in text or self.status == 70:
            return "traceback"
        if self.status < 0:
            return "ended"
        return "went_on" if self.status == 0 else "clean"


def children(pid: int) -> list[int]:
    """Processes that a process started."""
    try:
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


def send(pid: int | None, number: int) -> bool:
    """A signal; whether there was somebody to get it."""
    with contextlib.suppress(ProcessLookupError):
        if pid is not None:
            os.kill(pid, number)
            return True
    return False


def computing_s(pid: int) -> float:
    """What a process and those below it that live have computed."""
    with contextlib.suppress(OSError):
        used = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
        return sum(map(int, used)) / os.sysconf("SC_CLK_TCK") + sum(map(computing_s, children(pid)))
    return 0.0


class Flight:
    """One campaign in a folder of its own, on whatever file system, and its record outside."""

    def __init__(self, place: Path, run: Path, rng: random.Random, *, small: bool, report: bool) -> None:
        self.place, self.run, self.rng, self.report = place, run, rng, report
        budget = self.budget = 4 if small else BUDGET
        self.record = place / "record"
        self.settings = place / "settings.yaml"
        self.settings.write_text(SETTINGS.format(budget=budget))
        self.faults, self.done = 0, False
        self.verdicts: Counter[str] = Counter()
        self.told: list[str] = []
        self.aborted: set[str] = set()  # missions that were ended by a signal as of their own
        self._sessions = 0

    def start(
        self,
        *,
        before: Callable[[], None] | None = None,
        decide: Callable[[int, str, str], int] | None = None,
        more: Sequence[str] = (),
    ) -> Session:
        """The command, with ``more`` options; ``before`` happens in its process, ``decide`` as in `FailingCalls`."""
        self._sessions += 1
        output = self.place / f"output_{self._sessions}"
        output.touch()
        ours, theirs = socket.socketpair()
        pid = os.fork()
        if not pid:
            self._become(output, theirs, before, more, asks=decide is not None)
        theirs.close()
        session = Session(pid, output)
        if decide is not None:
            session.calls = FailingCalls(ours, self.run, decide)
        ours.close()
        return session

    def _become(
        self,
        output: Path,
        channel: socket.socket,
        before: Callable[[], None] | None,
        more: Sequence[str],
        *,
        asks: bool,
    ) -> None:
        code = 99
        try:
            os.setsid()
            descriptor = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            for number in (1, 2):
                os.dup2(descriptor, number)
            faulthandler.register(signal.SIGUSR1)  # of a hang
            os.environ["FAULTS_RECORD"] = str(self.record)
            import tuner.campaign.campaign as looked_at

            looked_at.recommend = lambda *_, **__: None  # the model takes longer than all the rest
            if not self.report:
                import tuner.report.campaign_page as page

                page.write_campaign_report = lambda campaign, *_: (campaign.directory / "report.html").touch()
            if asks:
                hold_calls(channel)
            if before is not None:
                before()
            from tuner.cli import main

            sys.argv = [
                "gatetune",
                "--plugin",
                "research.faults_mission",
                "campaign",
                "run",
                "--out",
                str(self.run),
            ]
            sys.argv += [
                "--workers",
                "2",
                "--timeout-s",
                "3",
                "--resume-if-present",
                *more,
                str(self.settings),
            ]
            main()
            code = 0
        except SystemExit as error:
            code = error.code if isinstance(error.code, int) else 0 if error.code is None else 1
        except KeyboardInterrupt:  # before the command has begun
            code = 130
        except BaseException:
            import traceback

            traceback.print_exc()
        finally:
            with contextlib.suppress(BaseException):
                sys.stdout.flush()
                sys.stderr.flush()
            os._exit(code)

    def wait(self, session: Session, until: float, *, stop: Callable[[], bool] = lambda: False) -> bool:
        """Whether the session ended within ``until`` seconds; answers the calls that wait."""
        deadline = time.monotonic() + until
        while not session.ended() and time.monotonic() < deadline and not stop():
            if session.calls is None:
                time.sleep(0.002)
            elif select.select([session.calls.listener], [], [], 0.01)[0]:
                session.calls.answer()
        return session.ended()

    def wait_to_the_end(self, session: Session) -> bool:
        """The same, unless it stands still: for `LIMIT_S` hardly any computing. A busy machine is not a hang."""
        computed_s = -1.0
        while (now_s := computing_s(session.pid)) > computed_s + 0.6 and now_s < 3 * LIMIT_S:
            computed_s = now_s
            if self.wait(session, LIMIT_S):
                return True
        return False

    def moment(self, session: Session, most: int = 8) -> None:
        """Any moment of a session: of its first second, or between and in its missions."""
        if self.rng.random() < 0.2:
            self.wait(session, self.rng.uniform(0, 1))
            return
        lines = self.lines() + self.rng.randrange(most)
        self.wait(session, LIMIT_S / 2, stop=lambda: self.lines() >= lines)
        self.wait(session, self.rng.expovariate(1 / 0.05))

    def lines(self) -> int:
        """Of the record."""
        with contextlib.suppress(OSError):
            return self.record.read_bytes().count(b"\n")
        return 0

    def close(self, session: Session, *, fault: bool = True) -> None:
        """After its end, or kill it; count how it ended."""
        if not self.wait_to_the_end(session):
            send(session.pid, signal.SIGUSR1)
            time.sleep(1)
            self.told.append(f"hang: {session.output.read_text(errors='replace')[-2500:]}")
        verdict = session.verdict()
        self.done |= session.status == 0  # no other end says that the budget is used
        if session.status is None:
            kill_all(session.pid)
            os.waitpid(session.pid, 0)
        if session.calls is not None:
            end = time.monotonic() + 5
            while time.monotonic() < end and of_campaign(self.run):
                if select.select([session.calls.listener], [], [], 0.01)[0]:
                    session.calls.answer()
            session.calls.close()
        if fault or verdict in ("hang", "traceback"):
            self.verdicts[verdict] += 1
        if verdict in ("traceback", "hang"):
            log = Path(os.environ["GATETUNE_HOME"]) / "last_error.log"
            text = session.output.read_text(errors="replace") + (log.read_text() if log.is_file() else "")
            self.told.append(f"{verdict}: {text[-2500:]}")
            log.unlink(missing_ok=True)

    def finish(self) -> None:
        """To the end without a fault, and the verdict of the record."""
        for _ in range(3):
            session = self.start()
            self.close(session, fault=False)
            if session.status == 0:
                break
            self.count("lost", f"exit {session.status}: {session.output.read_text(errors='replace')[-1500:]}")
        kill_all(*of_campaign(self.run))
        import research.faults_mission  # noqa: F401  (registers the fidelity of the campaign)
        from tuner.campaign.campaign import Campaign

        trials = Campaign.open(self.run, read_only=True).trials()
        events = [line.split() for line in self.record.read_text().splitlines()]
        known = {t.record.directory.name: t for t in trials if t.state != "running"}
        on_cluster = any(where.startswith("mission-") for _, where, *_ in events)
        ended, evaluated = set(), set()
        for event, where, score, when in events:
            name = self._name(where, trials)
            again = event == "began" and name in ended
            if again and on_cluster:  # its worker may have been lost before the campaign had it
                finished = known[name].finished if name in known else None
                again = finished is not None and float(when) > finished.timestamp()
            if again:
                self.count("repeated", name)
            if event == "untrue":
                self.count("lost", f"{name} had a damaged entry from the store")
            if event == "ended":
                ended.add(name)
            if event == "ending":
                evaluated.add((name, float(score)))
        for name in sorted(ended):
            if name not in known or (name, known[name].raw) not in evaluated:
                self.count("lost", f"{name}: {known.get(name)}")
        for name, trial in sorted(known.items()):
            if (name, trial.raw) not in evaluated:
                self.count("charged", f"{name}: {trial.reason} {trial.record.message}")
        if len(known) != self.budget:
            self.count("lost", f"{len(known)} of {self.budget} missions")

    def _name(self, where: str, trials: Sequence[Trial]) -> str:
        """A mission's directory by that in which it ran: workers of a cluster have folders of their own."""
        kind, _, rest = where.partition("-")
        return Path(trials[int(rest.split("-")[0])].directory).name if kind == "mission" else where

    def count(self, what: str, told: str) -> None:
        self.verdicts[what] += 1
        self.told.append(f"{what}: {told}")


def of_campaign(run: Path) -> list[int]:
    """Processes that have a file of the run directory open or name it."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            links = [str(link.readlink()) for link in (entry / "fd").iterdir()]
            if any(str(run) in link for link in links) and int(entry.name) != os.getpid():
                found.append(int(entry.name))
    return found


def kill_all(*pids: int) -> None:
    """Processes and all that they started."""
    for pid in pids:
        below = children(pid)
        send(pid, signal.SIGKILL)
        kill_all(*below)
