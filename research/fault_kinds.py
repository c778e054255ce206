"""The faults of `make faults`: each function is one session of a campaign that meets faults of its kind."""

from __future__ import annotations

import contextlib
import datetime
import importlib.util
import os
import random
import resource
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from research import failing_calls
from research.fault_campaign import Flight, Session, kill_all, send

DISK_BYTES = 3_000_000
_DEADLY = (signal.SIGKILL, signal.SIGABRT, signal.SIGSEGV, signal.SIGTERM)


def coordinator(flight: Flight) -> None:
    """Killed, aborted, asked to end or stopped for a while, at any moment from its first."""
    rng, session, number = flight.rng, flight.start(), signal.SIGSTOP
    while number == signal.SIGSTOP and not session.ended():
        flight.moment(session)
        number = rng.choice([*_DEADLY, signal.SIGINT, signal.SIGSTOP, signal.SIGKILL, signal.SIGKILL])
        flight.faults += send(None if session.ended() else session.pid, number)
        if number == signal.SIGSTOP:
            flight.verdicts["went_on"] += 1
            flight.wait(session, rng.uniform(0.1, 1.5))
            send(session.pid, signal.SIGCONT)
    flight.close(session)


def _met(flight: Flight, session: Session, find: Callable[[], int | None]) -> None:
    """Deadly signals to what ``find`` finds, now and then until the session ends."""
    while not session.ended() and time.monotonic() - session.began < 60:
        flight.moment(session, 6)
        pid = find()
        if pid != session.server() and _ended_before(flight, pid):
            continue  # twice the same end is the configuration's by design
        if send(pid, flight.rng.choice(_DEADLY)):
            flight.faults += 1
            flight.verdicts["went_on"] += 1
    flight.close(session, fault=False)


def _ended_before(flight: Flight, pid: int | None) -> bool:
    """Or nobody knows which mission it is: it has just been started."""
    with contextlib.suppress(OSError):
        log = str(Path(f"/proc/{pid}/fd/1").readlink())
        if log.endswith("worker.log") and log not in flight.aborted:
            flight.aborted.add(log)
            return False
    return True


def server(flight: Flight) -> None:
    """The process that missions' processes are forked from is killed or aborted."""
    session = flight.start()
    _met(flight, session, session.server)


def worker(flight: Flight) -> None:
    """A mission's process is killed or aborted."""
    session = flight.start()
    _met(flight, session, session.worker)


def _failing(flight: Flight, *, lasting: bool, everywhere: bool) -> None:
    rng, error, session = flight.rng, 0, None
    left = rng.randrange(1, 100)  # calls to the next that fails

    def decide(pid: int, name: str, path: str) -> int:
        nonlocal left, error
        if session is None or (not everywhere and pid != session.pid):
            return 0
        left -= 1
        if left > 0 or (lasting and left < 0):
            return error if lasting else 0
        error = rng.choice(failing_calls.ERRORS)
        flight.faults += 1
        flight.verdicts["went_on"] += 1
        if not lasting:
            left = rng.randrange(1, 100)
        return error

    before = flight.faults
    session = flight.start(decide=decide)
    flight.close(session, fault=False)
    if flight.faults > before:  # the last is the one that ended it
        flight.verdicts["went_on"] -= 1
        flight.verdicts[session.verdict()] += session.verdict() not in ("hang", "traceback")


def coordinator_cannot_write_once(flight: Flight) -> None:
    """The Nth writing call fails: disk full, input/output error, read-only, quota, no permission."""
    _failing(flight, lasting=False, everywhere=False)


def coordinator_cannot_write(flight: Flight) -> None:
    """All writing calls fail from the Nth on."""
    _failing(flight, lasting=True, everywhere=False)


def anybody_cannot_write(flight: Flight) -> None:
    """The Nth writing call of coordinator, server and missions fails, or all from it on."""
    _failing(flight, lasting=flight.rng.random() < 0.5, everywhere=True)


def full_disk(flight: Flight) -> None:
    """A small file system of its own is filled to the last byte while missions run, and emptied after a while."""
    session, filler = flight.start(), flight.run.parent / "filler"
    while not session.ended():
        flight.moment(session)
        with contextlib.suppress(OSError), filler.open("wb", buffering=0) as file:
            while not session.ended():
                file.write(bytes(4096))
        flight.faults += 1
        flight.verdicts["went_on"] += 1
        flight.wait(session, flight.rng.uniform(0.2, 4))
        filler.unlink(missing_ok=True)
    flight.verdicts["went_on"] -= 1
    flight.close(session)


def read_only_disk(flight: Flight) -> None:
    """The file system is read-only when the session begins; then another session runs a little."""
    disk = flight.run.parent
    remount = ["mount", "-o", "remount,ro", str(disk)]
    while subprocess.run(remount, capture_output=True).returncode:  # somebody still writes
        time.sleep(0.1)
    flight.faults += 1
    flight.close(flight.start())
    subprocess.run(["mount", "-o", "remount,rw", str(disk)], check=True)
    _fly_a_little(flight)


def _fly_a_little(flight: Flight) -> None:
    session = flight.start()
    flight.moment(session)
    send(session.pid, signal.SIGKILL)
    flight.close(session, fault=False)


def memory(flight: Flight) -> None:
    """Coordinator or mission may not grow any more."""
    rng, session, limited = flight.rng, flight.start(), set[int]()
    while not session.ended():
        flight.moment(session)
        pid = session.pid if rng.random() < 0.3 else session.worker()
        if pid != session.pid and _ended_before(flight, pid):
            continue
        with contextlib.suppress(OSError):
            if pid is not None and pid not in limited:
                used = int(Path(f"/proc/{pid}/statm").read_text().split()[0]) * resource.getpagesize()
                limit = used + rng.choice([0, 2**20, 2**24])
                resource.prlimit(pid, resource.RLIMIT_AS, (limit, limit))
                limited.add(pid)
                flight.faults += 1
                flight.verdicts["went_on"] += 1
    flight.verdicts["went_on"] -= bool(limited)
    flight.close(session, fault=bool(limited))


def clock(flight: Flight) -> None:
    """The clock of the coordinator jumps by an hour, days or years, forwards and back, again and again."""
    rng = random.Random(flight.rng.random())

    def before() -> None:
        real, jump = time.time, [0.0]

        def jumping() -> float:
            if rng.random() < 0.1:
                jump[0] = rng.choice([-3e8, -1e5, -3600, 0, 3600, 1e5, 3e8])
            return real() + jump[0]

        class Jumping(datetime.datetime):
            @classmethod
            def now(cls, tz: datetime.tzinfo | None = None) -> datetime.datetime:
                return datetime.datetime.fromtimestamp(jumping(), tz)

        time.time = jumping
        for module in list(sys.modules.values()):
            ours = (module.__name__ or "").startswith(("optuna", "tuner"))
            if ours and getattr(module, "datetime", None) is datetime.datetime:
                module.datetime = Jumping  # type: ignore[attr-defined]

    session = flight.start(before=before)
    flight.moment(session)
    flight.moment(session)
    flight.faults += 1
    flight.verdicts["went_on"] += 1
    send(session.pid, signal.SIGKILL)
    flight.close(session, fault=False)


def two_coordinators(flight: Flight) -> None:
    """A second one is started at once or in mid-flight, then the first or the second is killed."""
    rng, first = flight.rng, flight.start()
    if rng.random() < 0.5:
        flight.wait(first, rng.uniform(0, 1.5))
    second = flight.start()
    flight.faults += 1
    flight.moment(first)
    send(rng.choice([first.pid, second.pid]), signal.SIGKILL)
    flight.moment(first)
    for session in (first, second):
        send(None if session.ended() else session.pid, signal.SIGTERM)
    flight.close(first)
    flight.close(second, fault=False)


def torn_ledger(flight: Flight) -> None:
    """Between two sessions a part of a record stands at the ledger's end, as a killed process leaves it."""
    _fly_a_little(flight)
    path = flight.run / "study.journal"
    if not path.is_file():
        return
    data = path.read_bytes()
    last = data.splitlines()[-1]
    path.write_bytes(data + last[: flight.rng.randrange(1, len(last))])
    flight.faults += 1
    session, lines = flight.start(), flight.lines()
    flight.wait(session, 60, stop=lambda: flight.lines() > lines)
    flight.moment(session, 4)
    send(None if session.ended() else session.pid, signal.SIGKILL)
    flight.close(session)


def store_entry(flight: Flight) -> None:
    """While missions run, entries of the store they share are torn, flipped, emptied or put under another's name."""
    rng, session, store = flight.rng, flight.start(), Path(os.environ["GATETUNE_HOME"]) / "store" / "faults"
    while not session.ended():
        flight.moment(session, 3)
        with contextlib.suppress(OSError, IndexError, ValueError):  # nothing there yet, or just removed
            path, other = rng.choices(sorted(p for p in store.glob("*/*") if p.name[0] != "."), k=2)
            data = bytearray(path.read_bytes())
            way = rng.choice(["flip", "flip", "tear", "empty", "swap"])
            if way == "flip":
                data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
            elif way == "swap":
                data = bytearray(other.read_bytes())
            else:
                del data[0 if way == "empty" else rng.randrange(len(data)) :]
            path.write_bytes(data)
            flight.faults += 1
            flight.verdicts["went_on"] += 1
    flight.close(session, fault=False)


@contextlib.contextmanager
def _cluster(flight: Flight) -> Iterator[tuple[str, Callable[[str, int], None], Callable[[], None]]]:
    """A scheduler and two workers with a way each, and the coordinator's: its address, what holds, opens or cuts a
    way, and what begins workers where there is none."""
    here = Path(__file__).parent
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    environment = {
        **os.environ,
        "PYTHONPATH": f"{here.parent}:{here}",
        "FAULTS_RECORD": str(flight.record),
        "DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL": "5s",
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0",
    }
    python = [sys.executable, "-P"]

    def dask(what: str, *options: str) -> subprocess.Popen[bytes]:
        command = [*python, "-m", f"distributed.cli.dask_{what}", "--no-dashboard", *options]
        return subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL)

    scheduler = dask("scheduler", "--host", "127.0.0.1", "--port", str(port))
    network = subprocess.Popen(
        [*python, str(here / "fault_network.py"), str(port), "3"],
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert network.stdin is not None and network.stdout is not None
    ports = network.stdout.readline().split()
    workers: dict[str, subprocess.Popen[bytes]] = {}

    def do(what: str, way: int) -> None:
        print(what, way, file=network.stdin, flush=True)

    def begin_workers() -> None:
        for way in ports[1:]:  # one that was cut off ends itself
            if way not in workers or workers[way].poll() is not None:
                folder = str(flight.place / f"worker_{way}")
                own = ("--nthreads", "1", "--no-nanny", "--local-directory", folder)
                workers[way] = dask("worker", f"tcp://127.0.0.1:{way}", *own)

    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and socket.socket().connect_ex(("127.0.0.1", port)):
        time.sleep(0.1)
    try:
        yield f"tcp://127.0.0.1:{ports[0]}", do, begin_workers
    finally:
        for process in (network, scheduler, *workers.values()):
            kill_all(process.pid)
            process.wait()


def cluster_cut_off(flight: Flight) -> None:
    """The way of a worker, or of the coordinator, to a Dask scheduler is cut, or held for a moment or until it is given up."""
    rng = flight.rng
    with _cluster(flight) as (address, do, begin_workers):
        begin_workers()
        session = flight.start(more=("--scheduler", address))
        while not session.ended() and time.monotonic() - session.began < 120:
            flight.moment(session, 6)
            way, what = rng.choice([0, 1, 2, 1, 2]), rng.choice(["cut", "hold", "hold"])
            if session.ended():
                break
            do(what, way)
            flight.faults += 1
            flight.verdicts["went_on"] += 1
            if what == "hold":
                flight.wait(session, rng.choice([rng.uniform(0.1, 2), rng.uniform(6, 9)]))
                do("open", way)
            begin_workers()
        while not session.ended() and time.monotonic() - session.began < 240:
            flight.wait(session, 2)
            begin_workers()
        flight.close(session, fault=False)


KINDS: dict[str, Callable[[Flight], None]] = {
    "coordinator": coordinator,
    "server": server,
    "worker": worker,
    "coordinator's Nth write": coordinator_cannot_write_once,
    "coordinator's writes from the Nth on": coordinator_cannot_write,
    "anybody's Nth write": anybody_cannot_write,
    "full disk": full_disk,
    "read-only disk": read_only_disk,
    "memory limit": memory,
    "clock": clock,
    "two coordinators": two_coordinators,
    "torn ledger": torn_ledger,
    "store entry": store_entry,
    "cluster cut off": cluster_cut_off,
}
_OWN_DISK = ("full disk", "read-only disk")


def possible(kind: str) -> bool:
    """Whether this system and this user can do it."""
    if "write" in kind:
        return failing_calls.possible()
    if "cluster" in kind:
        return importlib.util.find_spec("distributed") is not None
    return kind not in _OWN_DISK or os.geteuid() == 0


@contextlib.contextmanager
def own_disk(place: Path, kind: str) -> Iterator[Path]:
    """A folder for the run directory: a small file system of its own for the kinds that need one."""
    place.mkdir()
    if kind not in _OWN_DISK:
        yield place
        return
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "faults", str(place)], check=True)
    try:
        yield place
    finally:
        subprocess.run(["umount", "-l", str(place)], check=False)
