"""One coordinator per campaign, on whatever machine: a row of the database that holds the ledger, kept alive by a heartbeat.

Times are the database's own. A coordinator that has not been heard of for `TIMEOUT_S` is taken for dead, at once one of this
machine whose process has ended, and another may go on in its place; should it come back, it finds the row another's and writes
nothing more.
"""

from __future__ import annotations

import contextlib
import math
import os
import socket
import threading
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

import sqlalchemy as sa

from nbv.errors import UserError

TIMEOUT_S = 60.0
BEAT_S = 10.0
_NOW = {
    "postgresql": "extract(epoch from clock_timestamp())",
    "mysql": "unix_timestamp(now(3))",
    "mariadb": "unix_timestamp(now(3))",
}
_TABLE = sa.Table(
    "gatetune_coordinators",
    sa.MetaData(),
    sa.Column("study", sa.String(512), primary_key=True),
    sa.Column("owner", sa.String(64), nullable=False),
    sa.Column("host", sa.String(255), nullable=False),
    sa.Column("beat", sa.Double, nullable=False),
)


class CoordinatorLock:
    """Held for one study of a database that several machines reach."""

    def __init__(self, engine: sa.Engine, study: str) -> None:
        self._engine, self._study = engine, study
        self._owner = uuid.uuid4().hex
        self._now = sa.cast(sa.literal_column(_NOW[engine.dialect.name]), sa.Double)
        self._heard = 0.0  # of the row, by `_clock_s`
        self._ended = threading.Event()

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Hold it, with a heartbeat.

        Raises
        ------
        UserError
            Another coordinator was heard of within `TIMEOUT_S`.
        """
        self._take()
        self._ended.clear()
        heart = threading.Thread(target=self._keep_beating, daemon=True)
        heart.start()
        try:
            yield
        finally:
            self._ended.set()
            heart.join(timeout=BEAT_S)
            with contextlib.suppress(sa.exc.SQLAlchemyError), self._engine.begin() as database:
                database.execute(sa.delete(_TABLE).where(*self._mine))

    def require(self) -> None:
        """Raise ``UserError`` where another coordinator may have taken over; called before every write."""
        if _clock_s() - self._heard > TIMEOUT_S / 2 and not self._beat():
            raise UserError(
                "this coordinator was not heard of for too long, and another one has taken over the campaign; leave it to that"
            )

    @property
    def _mine(self) -> tuple[sa.ColumnElement[bool], ...]:
        return (_TABLE.c.study == self._study, _TABLE.c.owner == self._owner)

    def _take(self) -> None:
        _TABLE.create(self._engine, checkfirst=True)
        own = {"owner": self._owner, "host": this_process(), "beat": self._now}
        ours = _TABLE.c.study == self._study
        try:
            with self._engine.begin() as database:
                database.execute(sa.insert(_TABLE).values(study=self._study, **own))
        except sa.exc.IntegrityError:
            with self._engine.begin() as database:
                row = database.execute(
                    sa.select(_TABLE.c.owner, _TABLE.c.host, self._now - _TABLE.c.beat).where(ours)
                ).first()
                owner, host, ago_s = row or ("", "another machine", 0.0)
                dead = _TABLE.c.owner == owner if _has_ended(host) else _TABLE.c.beat < self._now - TIMEOUT_S
                taken = database.execute(sa.update(_TABLE).where(ours, dead).values(**own)).rowcount
            if not taken:
                raise UserError(
                    f"campaign {self._study!r} is being flown on {host.split()[0]} (heard of {ago_s:.0f} s ago); stop it there, or wait "
                    f"until {TIMEOUT_S:.0f} s after it died"
                ) from None
        self._heard = _clock_s()

    def _beat(self) -> bool:
        began = _clock_s()
        with self._engine.begin() as database:
            kept = database.execute(sa.update(_TABLE).where(*self._mine).values(beat=self._now)).rowcount == 1
        self._heard = began if kept else -math.inf
        return kept

    def _keep_beating(self) -> None:
        while not self._ended.wait(BEAT_S):
            with contextlib.suppress(sa.exc.SQLAlchemyError):  # `require` tells, should it last
                self._beat()


def _clock_s() -> float:
    """Return the seconds of a clock that goes on while the machine sleeps, which `time.monotonic` does not on Linux."""
    return time.clock_gettime(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC))


def coordinator_lock(engine: sa.Engine, study: str) -> CoordinatorLock | None:
    """The lock of a database that several machines may reach; None for a file, whose run directory has a lock."""
    return CoordinatorLock(engine, study) if engine.dialect.name in _NOW else None


def this_process() -> str:
    """Return what identifies this process: host and, where the system tells, boot, process namespace, number and start."""
    host = socket.gethostname()
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{host} {boot} {Path('/proc/self/ns/pid').readlink()} {os.getpid()} {_state_and_start(os.getpid())[1]}"
    except OSError:
        return host


def _has_ended(process: str) -> bool:
    """Return whether the process that `this_process` described ran on this machine and has ended."""
    theirs, mine = process.split(), this_process().split()
    if len(theirs) != len(mine) or theirs[1:3] != mine[1:3] or len(mine) == 1:
        return False
    try:
        os.kill(int(theirs[3]), 0)
        state, start = _state_and_start(int(theirs[3]))
    except ProcessLookupError:
        return True
    except OSError:  # somebody else's
        return False
    return start != theirs[4] or state in "ZX"


def _state_and_start(pid: int) -> tuple[str, str]:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return fields[0], fields[19]
