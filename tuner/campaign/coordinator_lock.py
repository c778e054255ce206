"""One coordinator per campaign, on whatever machine: an advisory lock of the PostgreSQL that holds the ledger.

The database frees it when the coordinator's connection ends, with its process or, some 50 s later, with its machine. A
coordinator whose connection was cut takes the lock again, unless another one has had it meanwhile: that one has left its name
in the study.
"""

from __future__ import annotations

import contextlib
import hashlib
import socket
import uuid
from collections.abc import Iterator

import sqlalchemy as sa
from optuna.storages import RDBStorage

from nbv.errors import UserError

OWNER = "coordinator"  # attribute of the study
# Seconds until the database notices that a machine is gone.
_KEEPALIVES = ("tcp_keepalives_idle = 20", "tcp_keepalives_interval = 10", "tcp_keepalives_count = 3")


class CoordinatorLock:
    """Held for one study of a PostgreSQL database."""

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
                f"campaign {self._name!r} is being flown on {self._last_owner().split()[0]}; stop it there, or wait a minute "
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
