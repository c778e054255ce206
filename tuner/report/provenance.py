"""Where the numbers of a page come from: what missions recorded of themselves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from nbv.errors import UserError
from nbv.provenance import git_revision, versions
from nbv.safe_files import RESULT_BYTES, RESULT_NODES, read_json
from tuner.missions.job import RESULT_FILE

MOST_READ = 200  # missions whose documents are read


def recorded(missions: Sequence[Path]) -> list[dict[str, Any]]:
    """What the missions in these directories recorded, those that ended; of many every few."""
    trees = []
    for mission in missions[:: -(-len(missions) // MOST_READ) or 1]:
        try:
            tree = read_json(mission / RESULT_FILE, RESULT_BYTES, RESULT_NODES).get("provenance")
        except (UserError, AttributeError):
            continue
        trees += [tree] if tree else []
    return trees


def recorded_rows(trees: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Revisions, versions, machines and renderers, for a page."""
    software = trees[-1].get("versions", {}) if trees else versions()
    return [
        ("revision of the missions", _each(trees, "revision")),
        ("revision of this page", git_revision()),
        ("versions", ", ".join(f"{name} {number}" for name, number in software.items())),
        ("machine", _each(trees, "machine")),
        ("renderer", _each(trees, "backend")),
    ]


def _each(trees: Sequence[Mapping[str, Any]], key: str) -> str:
    return ", ".join(sorted({str(tree[key]) for tree in trees if key in tree})) or "not recorded"
