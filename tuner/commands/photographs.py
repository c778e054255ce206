"""``gatetune photographs import|list|enough``."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as RichProgress

from nbv.cache import Store
from nbv.errors import UserError
from nbv.photographs import PhotographSet, list_sets
from nbv.photographs.folder import Progress
from nbv.safe_files import write_atomic
from tuner.campaign.campaign import Campaign
from tuner.commands.console import (
    AsJson,
    answer_json,
    load,
    output,
    parse_overrides,
    run_plans,
    show_table,
)
from tuner.commands.options import Overrides, Timeout, Workers
from tuner.problem.goal import DEFAULT_METRIC
from tuner.report.labels import duration

app = typer.Typer(no_args_is_help=True)
_MIDDLE = 2  # of the thresholds


@app.command("import")
def import_(
    folder: Annotated[Path, typer.Argument(help="Photographs of one object: JPEG or PNG.")],
    name: Annotated[str, typer.Option(help="Name of the set, which commands take in place of a rock.")],
    model: Annotated[
        Path | None,
        typer.Option(help="The folder of a COLMAP model with points, made of these photographs."),
    ] = None,
    masks: Annotated[
        Path | None, typer.Option(help="Folder of masks, white on the object, named as the photographs.")
    ] = None,
    height_m: Annotated[float | None, typer.Option(help="The object's true height.")] = None,
    metres_per_unit: Annotated[
        float | None, typer.Option(help="Metres of one unit of the model that --model names.")
    ] = None,
    max_size: Annotated[
        int, typer.Option(help="Long side, in pixels, to which photographs are reduced.")
    ] = 1280,
    force: Annotated[bool, typer.Option(help="Replace a set of the same name.")] = False,
) -> None:
    """Import photographs: reconstruct them, find the object, assess the reference.

    The same command continues an import that was stopped.

    Example: gatetune photographs import photos --name mine --height-m 0.6
    """
    output.print(f"importing {folder}")  # before what takes seconds to load
    load("nbv.photographs.importer")
    from nbv.photographs.importer import ImportOptions, import_photographs

    options = ImportOptions(model, masks, height_m, metres_per_unit, max_size)
    with _progress_bar() as progress:
        made = import_photographs(folder, name, options, progress, Store(), force=force)
    height = made.true_height_m
    output.print(
        f"{made.name}: {len(made.registered)} of {len(made.photographs)} photographs, "
        + (f"an object of {height:.3g} m" if height is not None else "no scale")
        + f", {made.halves.f_score[_MIDDLE]:.1f} % F-score of one half against the other at 3 % of the height"
    )
    for line in (*made.notes, *(f"weak: {line}" for line in made.weak)):
        output.print(f"  - {line}")


@app.command("list")
def list_(as_json: AsJson = False) -> None:
    """List the imported sets.

    Example: gatetune photographs list
    """
    sets = [PhotographSet.read(name) for name in list_sets()]
    rows = [
        (
            s.name,
            len(s.photographs),
            len(s.registered),
            "–" if s.true_height_m is None else f"{s.true_height_m:.3g}",
            f"{s.halves.f_score[_MIDDLE]:.1f}",
        )
        for s in sets
    ]
    show_table(("set", "photographs", "registered", "height, m", "F-score, half against half, %"), rows)
    answer_json(
        [
            {
                "name": s.name,
                "photographs": len(s.photographs),
                "registered": len(s.registered),
                "height_m": s.true_height_m,
                "f_score_halves_percent": s.halves.f_score[_MIDDLE],
                "folder": str(s.folder),
                "weak": s.weak,
            }
            for s in sets
        ]
    )


@app.command()
def enough(
    name: Annotated[str, typer.Argument(help="A set's name.")],
    keep: Annotated[
        float, typer.Option(help="Share of the F-score with all photographs that must be kept, in percent.")
    ] = 95.0,
    numbers: Annotated[
        list[int] | None,
        typer.Option(
            "--number", help="Number of photographs to try, repeatable (default: 16, 20, 24, 32, 48)."
        ),
    ] = None,
    campaign: Annotated[
        Path | None,
        typer.Option(
            help="Campaign whose recommended gate and scorers run as the tuned planner (default: scorer predicted, alone)."
        ),
    ] = None,
    set_: Overrides = None,
    replicates: Annotated[
        int,
        typer.Option(help="Replicates of each strategy at each number, with other seed photographs each."),
    ] = 3,
    workers: Workers = None,
    timeout_s: Timeout = 3600.0,
    out: Annotated[Path | None, typer.Option(help="Directory (default: runs/enough-NAME).")] = None,
    as_json: AsJson = False,
) -> None:
    """Find how few photographs would have been enough: F-score over their number for a ring, random choice and planners.

    The same command continues after an interruption.

    Example: gatetune photographs enough mine --keep 95
    """
    if not 0 < keep <= 100:
        raise UserError(f"--keep {keep:g} must be above 0 and at most 100 percent")
    # Before what takes seconds to load.
    output.print(f"how many photographs of {name} would have been enough")
    load("tuner.report.enough")
    from tuner.report.enough import (
        NUMBERS,
        draw_enough,
        enough_plans,
        enough_table,
        enough_text,
        read_enough,
        seconds,
    )

    photographs = PhotographSet.read(name)
    tuned = None
    if campaign is not None:
        tuned = Campaign.open(campaign, read_only=True).recommended_config()
    plans = enough_plans(photographs, numbers or NUMBERS, replicates, tuned, parse_overrides(set_ or []))
    where = out or Path("runs") / f"enough-{name}"
    missions = sum(plan.missions for plan in plans.values())
    output.print(
        f"{missions} missions, about {duration(seconds(plans.values(), photographs))} of one processor; the first mission uses "
        "all photographs and takes longest",
        soft_wrap=True,
    )
    everything, few = run_plans(plans, where, workers, timeout_s, DEFAULT_METRIC)
    answer = read_enough(everything, few, keep)
    output.print(*enough_table(answer).for_terminal())
    picture, listed = draw_enough(answer, photographs, keep, where / "enough.png"), where / "enough.txt"
    if answer.smallest is not None:
        source = {p.name: p.source for p in photographs.photographs}
        write_atomic(listed, "".join(f"{source[taken]}\n" for taken in answer.smallest.taken))
    output.print(f"{enough_text(answer, keep, listed)} Picture: {picture}", soft_wrap=True)
    answer_json(answer)


@contextlib.contextmanager
def _progress_bar() -> Iterator[Progress]:
    """A progress bar in a terminal; elsewhere a line when a new step begins."""
    last = ""
    text = TextColumn("{task.description}", markup=False)  # a photograph's file may have any name
    with RichProgress(text, BarColumn(), TimeElapsedColumn(), console=output) as bar:
        task = bar.add_task("", total=None)

        def progress(what: str, done: int, total: int) -> None:
            nonlocal last
            bar.update(task, description=what, completed=done, total=total if total > 1 else None)
            if not output.is_terminal and what != last:
                output.print(what, soft_wrap=True, highlight=False)
            last = what

        yield progress
