"""Which rocks a command runs unless told otherwise, and which it may not."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path

from nbv.cache import Store
from nbv.errors import UserError
from nbv.rocks import list_rocks, load_coarse_rock
from nbv.safe_files import is_file
from tuner.problem.instances import family_of
from tuner.problem.problem import Making

QUICK_ROCKS = ["slab", "vesicular", "cavern"]  # training rocks on which configurations differ most
QUICK_HELD_OUT = ["arch", "fin"]


def rock_arguments(rocks: Sequence[str], making: Making = nullcontext) -> list[str]:
    """Return the rocks as given, mesh files by their absolute path, so that a resume finds them from anywhere.

    Every rock is loaded once, drawn ones as coarse meshes, so that a mistake shows before the first mission.

    Raises `UserError`: an unknown rock or a bad mesh.
    """
    for number, rock in enumerate(rocks, 1):
        if family_of(rock):
            continue
        with making(f"making rock {rock} ({number} of {len(rocks)}); it is kept for later"):
            load_coarse_rock(rock, Store())
    return absolute_rocks(rocks)


def absolute_rocks(rocks: Sequence[str]) -> list[str]:
    """Return the rocks as given, mesh files by their absolute path."""
    return [
        str(Path(rock).resolve()) if isinstance(rock, str) and is_file(Path(rock)) else rock for rock in rocks
    ]


def training_rocks() -> list[str]:
    """Return the procedural rocks of the train split, in catalogue order."""
    return [info.name for info in list_rocks() if info.split == "train" and info.source == "procedural"]


def held_out_rocks() -> list[str]:
    """Return the procedural rocks of the held-out split, in catalogue order."""
    return [info.name for info in list_rocks() if info.split == "held-out" and info.source == "procedural"]


def refuse_held_out(rocks: Sequence[str]) -> None:
    """Refuse held-out rocks: nothing is tuned on them, and no default is chosen on them.

    Raises `UserError`: a rock of the held-out split.
    """
    for rock in rocks:
        if not family_of(rock) and load_coarse_rock(rock, Store()).split == "held-out":
            raise UserError(
                f"rock {rock!r} is held out: it may not be tuned on; `gatetune rocks list` names others"
            )
