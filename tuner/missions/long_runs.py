"""What every long run needs: one owner per directory, and an orderly stop."""

from __future__ import annotations

import contextlib
import fcntl
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

from nbv.errors import UserError

LOCK_FILE = "run.lock"
T = TypeVar("T")


@contextlib.contextmanager
def exclusive(directory: Path) -> Iterator[None]:
    """Hold the directory's lock; the kernel frees it when the process dies, however it dies.

    Raises `UserError`: another process holds it, or the directory cannot be written.
    """
    try:
        lock = (directory / LOCK_FILE).open("ab")
    except OSError as error:
        raise UserError(f"cannot write to {directory}: {error.strerror}; make it writable") from error
    with lock as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise UserError(f"{directory} is in use by another process; wait for it or stop it") from error
        yield


class Stop(threading.Event):
    """Whether somebody asked for a stop."""

    def __init__(self) -> None:
        super().__init__()
        self.breaks = False  # whether a signal interrupts the running computation at once

    def computed(self, compute: Callable[[], T]) -> T | None:
        """Return what ``compute``, which writes nothing, returns; a stop ends it at once, and None is returned."""
        try:
            self.breaks = True
            return None if self.is_set() else compute()
        except KeyboardInterrupt:
            if not self.is_set():
                raise
            return None
        finally:
            self.breaks = False


@contextlib.contextmanager
def stop_signals() -> Iterator[Stop]:
    """Turn the first SIGINT or SIGTERM into a flag to be looked at between writes; a second one interrupts.

    Outside the main thread, where Python allows no handlers, the flag is never set.
    """
    stop = Stop()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return

    def ask_to_stop(number: int, frame: object) -> None:
        again = stop.is_set()
        stop.set()
        if again or stop.breaks:
            raise KeyboardInterrupt

    before = {number: signal.signal(number, ask_to_stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def long_run(directory: Path) -> Iterator[Stop]:
    """Hold the directory and turn signals into a stop, for what writes there all the time.

    Raises `UserError`: as `exclusive`; or something could not be written.
    """
    try:
        with exclusive(directory), stop_signals() as stop:
            yield stop
    except OSError as error:
        raise UserError(
            f"cannot write to {directory}: {error.strerror or error}; make room, then resume"
        ) from error
