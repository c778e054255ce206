"""``gatetune cache info|prune``: the store of photographs, features, pairs and seed models."""

from __future__ import annotations

from typing import Annotated

import typer

from nbv.cache import Store
from tuner.commands.console import AsJson, answer_json, output, show_table

app = typer.Typer(no_args_is_help=True)

GIB = 2**30


@app.command()
def info(as_json: AsJson = False) -> None:
    """Show where the store is and what it holds.

    Example: gatetune cache info
    """
    store = Store()
    kinds = store.info()
    total = sum(kind.size_bytes for kind in kinds)
    sizes = [(kind.kind, kind.entries, kind.size_bytes) for kind in kinds]
    sizes.append(("all", sum(kind.entries for kind in kinds), total))
    rows = [(name, entries, f"{size / 2**20:.1f}") for name, entries, size in sizes]
    show_table(("kind", "entries", "MiB"), rows, str(store.root), right=2)
    output.print(f"it is pruned to {store.max_bytes / GIB:.0f} GiB as it grows; GATETUNE_HOME sets its place")
    sums = {"size_bytes": total, "max_bytes": store.max_bytes}
    answer_json({"directory": store.root, "kinds": kinds, **sums})


@app.command()
def prune(
    max_gib: Annotated[float, typer.Option(help="Size in GiB to shrink it to; 0 empties it.")],
    as_json: AsJson = False,
) -> None:
    """Remove the least recently used entries.

    Example: gatetune cache prune --max-gib 5
    """
    removed, freed = Store().prune(int(max_gib * GIB))
    output.print(f"removed {removed} entries, {freed / 2**20:.1f} MiB")
    answer_json({"removed": removed, "freed_bytes": freed})
