"""The file of a campaign's ledger: the journal of an Optuna study in its run directory."""

from __future__ import annotations

import json
import os
from pathlib import Path

from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend, JournalFileSymlinkLock

from nbv.errors import UserError

JOURNAL_FILE = "study.journal"


class _JournalLock(JournalFileSymlinkLock):
    """Optuna's, which says of any disk that fails that a lock was lost."""

    def __init__(self, path: str) -> None:
        super().__init__(path)
        self._path = Path(f"{path}.lock")

    def release(self) -> None:
        """Remove the lock; ``OSError`` where the file system does not let go of it. A resume removes it then."""
        self._path.unlink(missing_ok=True)


def open_journal(directory: Path, *, must_exist: bool = False, heal: bool = True) -> JournalStorage:
    """Open the journal of the campaign in ``directory``.

    ``must_exist``: whether the file has to be there already. ``heal``: whether to cut off a last line that is torn.

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
        return JournalStorage(JournalFileBackend(str(path), _JournalLock(str(path))))
    except UserError:
        raise
    except OSError as error:
        raise UserError(f"cannot open the ledger {path}: {error.strerror}; make it writable") from error
    except Exception as error:  # Optuna's own of lines that are torn, lost, doubled or changed
        why = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise UserError(f"the ledger {path} is damaged ({why}); restore it from a copy") from error


def _mend_end(path: Path) -> None:
    """Cut off a last line that a killed process or a full disk left torn; ``ValueError`` where the one before is damaged, too.

    Optuna skips such a line when reading, but would write the next record behind it.
    """
    content = path.read_bytes()
    begin = content.rfind(b"\n", 0, -1) + 1
    last = content[begin:]
    if last and not _is_record(last):
        if begin and not _is_record(content[content.rfind(b"\n", 0, begin - 1) + 1 : begin]):
            raise ValueError("more than its last line")
        os.truncate(path, begin)


def _is_record(line: bytes) -> bool:
    try:
        return line.endswith(b"\n") and isinstance(json.loads(line), dict)
    except ValueError:
        return False
