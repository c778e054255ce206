"""Which rocks a command flies unless told otherwise, and which it may not."""

from __future__ import annotations

from collections.abc import Sequence

from nbv.cache import Store
from nbv.errors import UserError
from nbv.rocks import list_rocks, load_rock
from tuner.commands.campaign_settings import QUICK

QUICK_ROCKS = QUICK["rocks"]  # training rocks on which configurations differ most


def training_rocks() -> list[str]:
    """The procedural rocks of the train split, in catalogue order."""
    return [info.name for info in list_rocks() if info.split == "train" and info.source == "procedural"]


def held_out_rocks() -> list[str]:
    """The procedural rocks of the held-out split, in catalogue order."""
    return [info.name for info in list_rocks() if info.split == "held-out" and info.source == "procedural"]


def refuse_held_out(rocks: Sequence[str]) -> None:
    """Held-out rocks are never tuned on, and no default is chosen on them.

    Raises
    ------
    UserError
        A rock of the held-out split.
    """
    for rock in rocks:
        if load_rock(rock, Store()).split == "held-out":
            raise UserError(
                f"rock {rock!r} is held out: it may not be tuned on; `gatetune rocks list` names others"
            )
