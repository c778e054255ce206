"""Where a campaign's study lies, a journal file in its run directory or a PostgreSQL database, and its one coordinator."""

from __future__ import annotations

import contextlib
import gc
import hashlib
import json
import logging
import os
import socket
import sys
import time
import urllib.parse
import uuid
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any, TypeVar

import optuna
import sqlalchemy
import sqlalchemy as sa
from optuna.storages import JournalStorage, RDBStorage
from optuna.storages.journal import JournalFileBackend, JournalFileSymlinkLock
from sqlalchemy.exc import SQLAlchemyError

from nbv.errors import UserError
from nbv.safe_files import open_to_write, read_bytes, write_atomic
from tuner.campaign.settings import PASSWORD_VARIABLE, require_no_password

JOURNAL_FILE = "study.journal"
_AWAY = (optuna.exceptions.StorageInternalError, SQLAlchemyError)  # raised where a database goes away
PATIENCE_S = 600.0  # with a database that is away while missions run
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.5, 30.0
log = logging.getLogger(__name__)
T = TypeVar("T")
OWNER = "coordinator"  # attribute of the study
# Seconds until the database notices that a machine is gone.
_KEEPALIVES = ("tcp_keepalives_idle = 20", "tcp_keepalives_interval = 10", "tcp_keepalives_count = 3")


class DatabaseAwayError(UserError):
    """The ledger's database does not answer."""


class Journal(JournalStorage):
    """Optuna's journal, of which several records may be appended at once."""

    def __init__(self, path: Path) -> None:
        self._records = _Records(str(path), _JournalLock(str(path)))
        super().__init__(self._records)

    def batch(self) -> contextlib.AbstractContextManager[None]:
        """Collect what is written inside: this process sees it at once, the disk has it in one write at the end."""
        return self._records.batch()


class _Records(JournalFileBackend):
    _held: list[dict[str, Any]] | None = None
    _first = _seen = 0  # number of the first record held; how many of them have been read

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        if self._held is None:
            super().append_logs(logs)
        else:
            self._held += json.loads(json.dumps(logs))

    def read_logs(self, log_number_from: int) -> Generator[dict[str, Any], None, None]:
        if self._held is None or not self._seen:
            self._first = log_number_from
            for record in super().read_logs(log_number_from):
                self._first += 1
                yield record
        if self._held is not None:
            new, self._seen = self._held[self._seen :], len(self._held)
            yield from new

    @contextlib.contextmanager
    def batch(self) -> Iterator[None]:
        """Collect records for one write; inside another ``batch`` they join that one's write."""
        if self._held is not None:
            yield
            return
        self._held, self._seen = [], 0
        try:
            yield
        finally:
            held, self._held = self._held, None
            if held:
                self.append_logs(held)
                # Read back: nobody else may have written.
                if list(super().read_logs(self._first)) != held:
                    raise UserError(
                        "another process writes to this campaign's study; let only one run at a time"
                    )


class _JournalLock(JournalFileSymlinkLock):
    """Optuna's, which says of any disk that fails that a lock was lost."""

    def release(self) -> None:
        """``OSError`` where the file system does not let go of it; a resume removes it."""
        Path(self._lock_file).unlink(missing_ok=True)


def open_storage(
    storage: str | None, directory: Path, *, must_exist: bool = False, heal: bool = True
) -> optuna.storages.BaseStorage:
    """Open a campaign's Optuna storage.

    Parameters
    ----------
    storage
        None for a journal in ``directory``, or the URL of a PostgreSQL database.
    directory
        The campaign's run directory.
    must_exist
        Whether a journal has to be there already.
    heal
        Whether to cut off a last line that is torn or damaged.

    Raises
    ------
    UserError
        Unknown kind, missing driver, or it cannot be reached.
    """
    if storage is None:
        return _journal(directory / JOURNAL_FILE, must_exist, heal)
    if storage.partition("://")[0].partition("+")[0] != "postgresql":
        raise UserError(
            f"storage {storage!r} is no PostgreSQL database; give postgresql+psycopg://USER@HOST/DB, or leave it out for a file"
        )
    require_no_password(storage)
    try:
        url = sqlalchemy.engine.make_url(storage)
        if password := os.environ.get(PASSWORD_VARIABLE):
            url = url.set(password=password)
        return optuna.storages.RDBStorage(url.render_as_string(hide_password=False))
    except Exception as error:  # SQLAlchemy and drivers each raise families of their own
        raise UserError(
            f"cannot open storage {storage!r}: {_first_line(error)}; check the URL, driver and server, and a password in "
            f"the environment's {PASSWORD_VARIABLE}"
        ) from None  # what it comes from may show the password


def retry_while_unavailable(
    shown: str, step: Callable[[bool], T], pause: Callable[[float], bool] | None = None
) -> T:
    """Return what ``step`` returns; retry it for `PATIENCE_S`, with pauses that double, while the database is away.

    What was in flight stays open in the ledger, and a resume runs it again or enters it. ``shown`` is the ledger as messages
    name it. ``step`` is told whether it was tried before: then what it wrote may be there or not. ``pause`` waits for so many
    seconds, and says whether somebody wants no more of it; None: one try.

    Raises
    ------
    DatabaseAwayError
        The database is still away.
    """
    began, pause_s = time.monotonic(), _FIRST_PAUSE_S
    again = False
    while True:
        try:
            return step(again)
        except _AWAY as error:
            cause = _first_line(error.__cause__ or error)
        away = DatabaseAwayError(
            f"the ledger's database {shown} does not answer ({cause}); mend it, then resume: finished missions are kept"
        )
        if pause is None or time.monotonic() + pause_s - began > PATIENCE_S:
            raise away
        if not again:
            log.warning("%s; trying again for %.0f s", str(away).partition(";")[0], PATIENCE_S)
        again = True
        if pause(pause_s):
            raise away
        pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)


def _first_line(error: BaseException) -> str:
    line = (str(error).strip().splitlines() or [type(error).__name__])[0]
    password = os.environ.get(PASSWORD_VARIABLE, "")
    for secret in (password, urllib.parse.quote(password, safe="")):
        line = line.replace(secret, "***") if secret else line
    return line


def _journal(path: Path, must_exist: bool, heal: bool) -> Journal:
    if must_exist and not path.is_file():
        raise UserError(f"the ledger {path} is missing; restore it, or start a new campaign elsewhere")
    try:
        if heal and path.exists():
            _mend_end(path)
            # Nobody writes now: a lock file here was left by a killed process.
            path.with_name(path.name + ".lock").unlink(missing_ok=True)
        with _without_collector():
            return Journal(path)
    except UserError:
        raise
    except OSError as error:
        raise UserError(f"cannot open the ledger {path}: {error.strerror}; make it writable") from error
    except Exception as error:  # Optuna's own of lines that are torn, lost, doubled or changed
        raise UserError(
            f"the ledger {path} is damaged ({_first_line(error)}); restore it from a copy"
        ) from error


@contextlib.contextmanager
def _without_collector() -> Iterator[None]:
    """Switch off Python's cycle collector: while many lasting objects are made it would take a third of the time for nothing."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        if was_enabled:
            gc.enable()


def _mend_end(path: Path) -> None:
    """Cut off a last line that a killed process, a full disk or a flipped bit left damaged; ``ValueError`` where there are more.

    Optuna skips such a line when reading, but would write the next record behind it. A journal with a second name, as a
    copy made of hard links has it, becomes a file of its own.
    """
    content = read_bytes(path, sys.maxsize, follow=False)
    if path.stat().st_nlink > 1:
        write_atomic(path, content)
    begin = content.rfind(b"\n", 0, -1) + 1
    last = content[begin:]
    if last and not _is_record(last):
        if begin and not _is_record(content[content.rfind(b"\n", 0, begin - 1) + 1 : begin]):
            raise ValueError("more than its last line")
        with contextlib.suppress(OSError):
            write_atomic(path.with_name(path.name + ".torn"), last)
        with open_to_write(path, 0) as file:
            file.truncate(begin)


def _is_record(line: bytes) -> bool:
    try:
        return line.endswith(b"\n") and isinstance(json.loads(line), dict)
    except ValueError:
        return False


class CoordinatorLock:
    """One coordinator per campaign, on whatever machine: an advisory lock of the PostgreSQL database that holds the ledger.

    The database frees it when the coordinator's connection ends, with its process or, some 50 s later, with its machine. A
    coordinator whose connection was cut takes the lock again, unless another one has had it meanwhile: that one has left its
    name in the study.
    """

    def __init__(self, storage: RDBStorage, study_id: int, name: str) -> None:
        self._storage, self._study_id, self._name = storage, study_id, name
        self._key = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "big", signed=True)
        self._owner = f"{socket.gethostname()} {uuid.uuid4().hex}"
        self._connection: sa.Connection | None = None

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Hold it; ``UserError`` where another coordinator does."""
        self._take()
        self._storage.set_study_user_attr(self._study_id, OWNER, self._owner)
        try:
            yield
        finally:
            self._let_go()

    def require(self) -> None:
        """Raise ``UserError`` where another coordinator has taken over; called before every write."""
        if self._connection is None:
            return
        try:
            self._connection.execute(sa.text("select 1"))
        except sa.exc.SQLAlchemyError:
            self._let_go()
            self._take()
        if self._last_owner() != self._owner:
            raise UserError(
                "this coordinator was cut off, and another one has taken over the campaign; leave it to that"
            )

    def _take(self) -> None:
        connection = self._storage.engine.connect().execution_options(isolation_level="AUTOCOMMIT")
        for setting in _KEEPALIVES:
            connection.execute(sa.text(f"set {setting}"))
        if not connection.scalar(sa.text("select pg_try_advisory_lock(:key)"), {"key": self._key}):
            connection.close()
            raise UserError(
                f"campaign {self._name!r} is being run on {self._last_owner().split()[0]}; stop it there, or wait a minute "
                "where its machine is gone"
            )
        self._connection = connection

    def _last_owner(self) -> str:
        return str(self._storage.get_study_user_attrs(self._study_id).get(OWNER, "another machine"))

    def _let_go(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            with contextlib.suppress(sa.exc.SQLAlchemyError):
                connection.invalidate()  # its end, not its return to the pool, frees the lock
                connection.close()
