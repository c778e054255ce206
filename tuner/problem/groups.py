"""Tuned parameters by what they change of a mission: the groups by which a gain is split."""

from __future__ import annotations

from collections.abc import Iterable

THRESHOLDS, COVIS, B_AWARE, POOL = "gate thresholds", "Covis' weights", "B-aware's weights", "candidate pool"
SEEDS, STOP, OTHER = "seeds", "stop", "other"
_GROUPS = {
    THRESHOLDS: ("gate.",),
    COVIS: ("covis.",),
    B_AWARE: ("b_aware.", "matchable."),
    POOL: ("pool.",),
    SEEDS: ("seed.", "sparse."),
    STOP: ("stop.",),
}
CHOICE = (
    THRESHOLDS,
    COVIS,
    B_AWARE,
)  # how a view is chosen; the others decide where views may be, and how many


def group_of(path: str) -> str:
    """Return the group of a parameter's path."""
    return next((name for name, begins in _GROUPS.items() if path.startswith(begins)), OTHER)


def grouped(paths: Iterable[str]) -> dict[str, tuple[str, ...]]:
    """Return the paths by group, in the order of the groups."""
    found: dict[str, list[str]] = {name: [] for name in (*_GROUPS, OTHER)}
    for path in paths:
        found[group_of(path)].append(path)
    return {name: tuple(own) for name, own in found.items() if own}
