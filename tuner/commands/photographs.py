"""``gatetune photographs import|list|show``."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from tuner.commands.console import AsJson, Throttle, answer_json, load, output, progress_bar

if TYPE_CHECKING:
    from nbv.photographs import PhotographSet
    from nbv.photographs.folder import Progress

app = typer.Typer(no_args_is_help=True)
_MIDDLE = 2  # of the thresholds


@app.command("import")
def import_(
    folder: Annotated[Path, typer.Argument(help="Photographs of one object: JPEG, PNG, TIFF or HEIC.")],
    name: Annotated[str, typer.Option(help="Name of the set, which then stands where a rock may stand.")],
    model: Annotated[
        Path | None,
        typer.Option(
            help="Poses that you have: COLMAP's folder, transforms.json, Metashape's cameras (XML) or OpenSfM's "
            "reconstruction.json."
        ),
    ] = None,
    masks: Annotated[
        Path | None, typer.Option(help="Folder of masks, white on the object, called as the photographs.")
    ] = None,
    height_m: Annotated[float | None, typer.Option(help="The object's true height.")] = None,
    control_points: Annotated[
        Path | None, typer.Option(help="Control points as OpenDroneMap's gcp_list.txt.")
    ] = None,
    max_size: Annotated[int, typer.Option(help="Long side, in pixels, to work on.")] = 1280,
    force: Annotated[bool, typer.Option(help="Replace a set of the same name.")] = False,
) -> None:
    """Photographs that you have: reconstruct them, find the object, judge the reference, write a page.

    Stopped, it goes on where it was when the same command runs again.

    Example: gatetune photographs import photos --name mine --height-m 0.6
    """
    output.print(f"importing {folder}")  # before what takes seconds to load
    load("nbv.photographs.importer")
    from nbv.cache import Store
    from nbv.photographs.importer import ImportOptions, import_photographs

    options = ImportOptions(model, masks, height_m, control_points, max_size)
    with _told() as progress:
        made = import_photographs(folder, name, options, progress, Store(), force=force)
        progress("writing the page", 0, 1)
        from tuner.report.photographs import write_import_report

        page = write_import_report(made)
    _describe(made)
    output.print(f"report: {page}")


@app.command("list")
def list_(as_json: AsJson = False) -> None:
    """The sets that you imported.

    Example: gatetune photographs list
    """
    from nbv.photographs import PhotographSet, list_sets

    table = Table()
    for column in ("set", "photographs", "registered", "height, m", "F-score, half against half, %"):
        table.add_column(column)
    found = [_facts(PhotographSet.read(name)) for name in list_sets()]
    for facts in found:
        height = facts["height_m"]
        table.add_row(
            facts["name"],
            str(facts["photographs"]),
            str(facts["registered"]),
            "–" if height is None else f"{height:.3g}",
            f"{facts['f_score_halves_percent']:.1f}",
        )
    output.print(table)
    answer_json(found)


@app.command()
def show(name: Annotated[str, typer.Argument(help="A set's name.")], as_json: AsJson = False) -> None:
    """What the import found, and where its page is.

    Example: gatetune photographs show mine
    """
    from nbv.photographs import PhotographSet

    found = PhotographSet.read(name)
    _describe(found)
    output.print(f"report: {found.folder / 'report.html'}")
    answer_json({**_facts(found), "weak": found.weak, "notes": found.notes})


def _facts(found: PhotographSet) -> dict[str, Any]:
    return {
        "name": found.name,
        "photographs": len(found.photographs),
        "registered": len(found.registered),
        "height_m": found.true_height_m,
        "f_score_halves_percent": found.halves.f_score[_MIDDLE],
        "folder": str(found.folder),
    }


def _describe(found: PhotographSet) -> None:
    height = found.true_height_m
    output.print(
        f"{found.name}: {len(found.registered)} of {len(found.photographs)} photographs, "
        + (f"an object of {height:.3g} m" if height is not None else "no scale")
        + f", {found.halves.f_score[_MIDDLE]:.1f} % F-score of one half against the other at 3 % of the height"
    )
    for line in found.notes:
        output.print(f"  - {line}")
    for line in found.weak:
        output.print(f"  - weak: {line}")


@contextlib.contextmanager
def _told() -> Iterator[Progress]:
    """Say what is done: a bar in a terminal, else a line when something new begins and now and then."""
    throttle = Throttle()
    last = ""
    with progress_bar() as bar:
        task = bar.add_task("", total=None)

        def progress(what: str, done: int, total: int) -> None:
            nonlocal last
            bar.update(task, description=what, completed=done, total=total if total > 1 else None)
            if not bar.console.is_terminal and (what != last or throttle.due):
                count = f", {done} of {total}" if total > 1 and done else ""
                bar.console.print(f"{what}{count}", soft_wrap=True, highlight=False)
                throttle.said()
            last = what

        yield progress
