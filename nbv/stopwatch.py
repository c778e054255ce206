"""Wall seconds by stage."""

from __future__ import annotations

import contextlib
import time
from collections import defaultdict
from collections.abc import Iterator


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
