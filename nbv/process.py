"""Wall seconds by stage."""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import sys
import time
from collections import defaultdict
from collections.abc import Iterator

import numpy as np

# Return freed memory to the operating system.


def give_back_freed_memory() -> None:
    """Ask the C library to return what the process no longer uses; does nothing where it cannot.

    Glibc keeps freed blocks between others that are still in use. What one stage of a mission has left there, the
    next, with larger arrays, cannot use.
    """
    if not sys.platform.startswith("linux"):
        return
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # absent in other C libraries, such as musl
    if trim is not None:
        trim(ctypes.c_size_t(0))


# One mission, one thread: many missions run side by side in processes of their own.


ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS"), "1"
)


def single_thread_environment() -> None:
    """Ask for one thread in every numerical library; call before they are imported."""
    for name, one in ONE_THREAD.items():
        os.environ.setdefault(name, one)


def limit_threads() -> None:
    """Hold libraries that are already loaded to one thread."""
    # cv2 before pycolmap: the other order lets libpng abort the process.
    import cv2  # noqa: PLC0415  after the environment is set
    from threadpoolctl import threadpool_limits  # noqa: PLC0415

    cv2.setNumThreads(1)
    threadpool_limits(1)


# Random numbers keyed by content, never by call order.
#
# Two missions that photograph the same rock from the same viewpoint in the same replicate must draw the
# same arrival error and the same sensor noise, whatever else they drew before. So every draw has a
# generator of its own, seeded by *what is drawn*.


def keyed_rng(*parts: str | int) -> np.random.Generator:
    """A generator (PCG64) that depends on ``parts`` alone, e.g. ``keyed_rng("noise", sha, 3, "seed_07")``.

    The seed is the SHA-256 of the parts, each with its type and length, so that neither ``("ab", "c")``
    and ``("a", "bc")`` nor ``1`` and ``"1"`` collide. The order of the parts matters.

    `TypeError` where a part is neither a string nor an integer (floats have no canonical text).
    """
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, bool) or not isinstance(part, (str, int, np.integer)):
            raise TypeError(f"keyed_rng takes strings and integers, not {part!r}")
        kind = b"s" if isinstance(part, str) else b"i"
        text = (part if isinstance(part, str) else str(int(part))).encode()
        digest.update(kind + len(text).to_bytes(8, "big") + text)
    return np.random.default_rng(int.from_bytes(digest.digest(), "big"))


class Stopwatch:
    """Adds up the seconds of every stage; a stage inside another is taken off the outer one's sum."""

    def __init__(self) -> None:
        self.total_s: dict[str, float] = defaultdict(float)
        self._inner_s = [0.0]  # of the stages inside each stage that runs now, the outermost first

    @contextlib.contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Count the seconds inside the ``with``, also where it ends in an exception."""
        started = time.perf_counter()
        self._inner_s.append(0.0)
        try:
            yield
        finally:
            took_s = time.perf_counter() - started
            self.total_s[stage] += took_s - self._inner_s.pop()
            self._inner_s[-1] += took_s
