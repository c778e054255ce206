"""Wall seconds by stage."""

from __future__ import annotations

import contextlib
import time
from collections import defaultdict
from collections.abc import Iterator


class Stopwatch:
    """Adds up the seconds of every stage, and remembers its last ones."""

    def __init__(self) -> None:
        self.total_s: dict[str, float] = defaultdict(float)
        self.last_s: dict[str, float] = {}

    @contextlib.contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Count the seconds inside the ``with``, also where it ends in an exception."""
        started = time.perf_counter()
        try:
            yield
        finally:
            self.last_s[stage] = time.perf_counter() - started
            self.total_s[stage] += self.last_s[stage]
