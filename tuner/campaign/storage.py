"""Where a campaign's study lies: a journal file in its run directory, or any storage that Optuna knows."""

from __future__ import annotations

import contextlib
from pathlib import Path

import optuna
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend, JournalRedisBackend

from nbv.errors import UserError

JOURNAL_FILE = "study.journal"


def open_storage(
    storage: str | None, directory: Path, *, must_exist: bool = False, heal: bool = True
) -> optuna.storages.BaseStorage:
    """The Optuna storage named by ``storage`` (see ``Ledger``).

    Raises
    ------
    UserError
        Unknown kind, missing driver, or it cannot be reached.
    """
    if storage is None:
        return _journal(directory / JOURNAL_FILE, must_exist, heal)
    if storage.startswith("journal:"):
        return _journal(Path(storage.removeprefix("journal:").removeprefix("//")), must_exist, heal)
    if "://" not in storage:
        raise UserError(
            f"unknown storage {storage!r}; give an Optuna storage URL such as sqlite:///missions.db or journal:PATH"
        )
    try:
        if storage.startswith("redis"):
            backend = JournalRedisBackend(storage)
            return JournalStorage(backend)
        return optuna.storages.RDBStorage(storage)
    except Exception as error:  # SQLAlchemy, drivers and redis each raise families of their own
        first = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise UserError(
            f"cannot open storage {storage!r}: {first}; check the URL, driver and server"
        ) from error


def _journal(path: Path, must_exist: bool, heal: bool) -> optuna.storages.BaseStorage:
    if must_exist and not path.is_file():
        raise UserError(f"the ledger {path} is missing; restore it, or start a new campaign elsewhere")
    try:
        if heal and path.is_file():
            _drop_torn_line(path)
            # The caller holds the campaign's lock, so a lock file here was left by a killed process.
            path.with_name(path.name + ".lock").unlink(missing_ok=True)
        return JournalStorage(JournalFileBackend(str(path)))
    except OSError as error:
        raise UserError(f"cannot open the ledger {path}: {error.strerror}; make it writable") from error
    except ValueError as error:
        raise UserError(f"the ledger {path} is damaged ({error}); restore it from a copy") from error


def _drop_torn_line(path: Path) -> None:
    """Cut off a last line that a killed process or a full disk left without its end.

    Optuna skips such a line when reading but would glue the next record to it.
    """
    size = path.stat().st_size
    if size == 0:
        return
    with path.open("rb+") as file:
        file.seek(-1, 2)
        if file.read(1) == b"\n":
            return
        file.seek(0)
        content = file.read()
        with contextlib.suppress(OSError):
            path.with_name(path.name + ".torn").write_bytes(content[content.rfind(b"\n") + 1 :])
        file.truncate(content.rfind(b"\n") + 1)
