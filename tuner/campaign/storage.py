"""The file of a campaign's ledger: the journal of an Optuna study in its run directory."""

from __future__ import annotations

import contextlib
import gc
import json
import sys
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend, JournalFileSymlinkLock

from nbv.errors import UserError
from nbv.safe_files import open_to_write, read_bytes, write_atomic

JOURNAL_FILE = "study.journal"


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

    def __init__(self, path: str) -> None:
        super().__init__(path)
        self._path = Path(f"{path}.lock")

    def release(self) -> None:
        """Remove the lock; ``OSError`` where the file system does not let go of it. A resume removes it then."""
        self._path.unlink(missing_ok=True)


def open_journal(directory: Path, *, must_exist: bool = False, heal: bool = True) -> Journal:
    """Open the journal of the campaign in ``directory``.

    ``must_exist``: whether the file has to be there already. ``heal``: whether to cut off a last line that is torn or
    damaged.

    Raises `UserError`: the file is missing, damaged, or cannot be read.
    """
    path = directory / JOURNAL_FILE
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
        why = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise UserError(f"the ledger {path} is damaged ({why}); restore it from a copy") from error


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
