"""Functions that run whole missions: the signature that all fidelities share, photogrammetric, geometric and others."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal, Protocol

from nbv.config import MissionConfig
from nbv.mission.result import MissionResult

Keep = Literal["all", "summary"]
Log = Callable[[str], None]  # is given a line of text for what a mission has found or chosen


def no_log(line: str) -> None:
    """Ignore the line."""


class MissionFunction(Protocol):
    """A function that runs one mission and measures it; it may take further options.

    The result is a function of (config, rock, replicate): whatever is drawn at random is keyed by these. ``rock`` is a catalogue
    name or the path of a mesh, ``replicate`` the index of the draws. Into ``directory`` the run directory is written, nothing for
    None; of it ``keep`` ``"summary"`` leaves the configuration and ``mission.json``. The result of a mission that failed says so.
    `UserError` for an unknown rock, a bad mesh, an unwritable directory, a missing backend.
    """

    def __call__(
        self, config: MissionConfig, rock: str, replicate: int, directory: Path | None, /, *, keep: Keep
    ) -> MissionResult: ...
