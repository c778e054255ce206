"""Wall seconds by stage."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Mapping


class Stopwatch:
    """Adds up the seconds of every stage, and remembers its last ones."""

    def __init__(self) -> None:
        self.total_s: dict[str, float] = {}
        self.last_s: dict[str, float] = {}

    @contextlib.contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Count the seconds inside the ``with``, also where it ends in an exception."""
        started = time.perf_counter()
        try:
            yield
        finally:
            self.last_s[stage] = time.perf_counter() - started
            self.add({stage: self.last_s[stage]})

    def add(self, seconds: Mapping[str, float], prefix: str = "") -> None:
        """Add seconds that were measured elsewhere."""
        for stage, value in seconds.items():
            name = prefix + stage
            self.total_s[name] = self.total_s.get(name, 0.0) + value

    def take(self) -> dict[str, float]:
        """The sums so far; counting begins anew."""
        seconds, self.total_s = self.total_s, {}
        return seconds
