"""Which rocks a command flies unless told otherwise, and which it may not."""

from __future__ import annotations

from collections.abc import Sequence

from nbv.errors import UserError

QUICK_ROCKS = ["slab", "vesicular", "cavern"]  # training rocks on which configurations differ most


def training_rocks() -> list[str]:
    """The procedural rocks of the train split, in catalogue order."""
    from nbv.rocks import list_rocks

    return [info.name for info in list_rocks() if info.split == "train" and info.source == "procedural"]


def held_out_rocks() -> list[str]:
    """The procedural rocks of the held-out split, in catalogue order."""
    from nbv.rocks import list_rocks

    return [info.name for info in list_rocks() if info.split == "held-out" and info.source == "procedural"]


def refuse_held_out(rocks: Sequence[str]) -> None:
    """Held-out rocks are never tuned on, and no default is chosen on them.

    Raises
    ------
    UserError
        A rock of the held-out split.
    """
    from nbv.cache import Store
    from nbv.rocks import load_rock

    for rock in rocks:
        if load_rock(rock, Store()).split == "held-out":
            raise UserError(
                f"rock {rock!r} is held out: it may not be tuned on; `gatetune rocks list` names others"
            )
