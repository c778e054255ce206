"""Which rocks a command runs unless told otherwise, and which it may not."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from nbv.cache import Store
from nbv.errors import UserError
from nbv.rocks import list_rocks, load_coarse_rock
from nbv.safe_files import is_file
from tuner.problem.instances import family_of


def rock_arguments(rocks: Sequence[str], *, tuned: bool = False) -> list[str]:
    """Return the rocks as given, mesh files by their absolute path, so that a resume finds them from anywhere.

    Every rock is loaded once, drawn ones as coarse meshes, so that a mistake shows before the first mission.

    Raises `UserError`: an unknown rock or a bad mesh; a held-out rock where they are to be ``tuned`` on: nothing is
    tuned on these, and no default is chosen on them.
    """
    for rock in rocks:
        if family_of(rock):
            continue
        if load_coarse_rock(rock, Store()).split == "held-out" and tuned:
            raise UserError(
                f"rock {rock!r} is held out: it may not be tuned on; `gatetune rocks list` names others"
            )
    return absolute_rocks(rocks)


def absolute_rocks(rocks: Sequence[str]) -> list[str]:
    return [str(Path(rock).resolve()) if is_file(Path(rock)) else rock for rock in rocks]


def procedural_rocks(split: str) -> list[str]:
    """Return the procedural rocks of a split, ``train`` or ``held-out``, in catalogue order."""
    return [info.name for info in list_rocks() if info.split == split and info.source == "procedural"]
