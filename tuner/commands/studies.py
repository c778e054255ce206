"""``gatetune study noise|sensitivity``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tuner.campaign.rock_choice import refuse_held_out, training_rocks
from tuner.commands.console import (
    AsJson,
    ComparisonProgress,
    answer_json,
    local_executor,
    output,
    parse_overrides,
    rock_arguments,
)
from tuner.commands.evaluate import end
from tuner.commands.options import Fidelity, Overrides, Timeout, TrainingRocks, Workers

app = typer.Typer(no_args_is_help=True)


@app.command()
def noise(
    space: Annotated[
        str, typer.Option(help="Search space whose configurations are compared.")
    ] = "gate_and_weights",
    rocks: TrainingRocks = None,
    configurations: Annotated[int, typer.Option(help="Sobol points of the space.")] = 8,
    replicates: Annotated[int, typer.Option(help="Of every configuration on every rock.")] = 3,
    metrics: Annotated[
        list[str] | None, typer.Option("--metric", help="Repeatable, e.g. observable.f_score_48mm.")
    ] = None,
    set_: Overrides = None,
    fidelity: Fidelity = "photogrammetric",
    workers: Workers = None,
    timeout_s: Timeout = 3600.0,
    out: Annotated[Path, typer.Option(help="Directory; the same command goes on where it stopped.")] = Path(
        "runs/noise"
    ),
) -> None:
    """How noisy is a mission, and do configurations differ by more than that?

    Example: gatetune study noise --rock slab
    """
    from tuner.evaluation.run import run_evaluation
    from tuner.problem.space_files import load_search_space
    from tuner.studies.noise import METRICS, analyse, noise_plan, noise_tables, write_noise

    chosen = rock_arguments(rocks or training_rocks())
    refuse_held_out(chosen)
    plan = noise_plan(
        load_search_space(space),
        chosen,
        configurations,
        replicates,
        overrides=parse_overrides(set_ or []),
        fidelity=fidelity,
    )
    asked = metrics or METRICS
    executor = local_executor(plan.fidelity, workers, timeout_s, None)
    output.print(f"{plan.missions} missions, {executor.capacity} workers")
    with executor, ComparisonProgress(asked[0]) as show:
        run = run_evaluation(plan, out, executor, show)
    found = [noise for metric in asked if (noise := analyse(plan, run.records, metric)) is not None]
    none = ("too few configurations are complete, or none has the metrics",)
    output.print(*(noise_tables(found, output.width) if found else none))
    output.print(f"in numbers: {write_noise(found, out)}")
    end(run)


@app.command()
def sensitivity(
    campaign: Annotated[Path, typer.Argument(help="The campaign's run directory.")],
    metric: Annotated[
        str | None, typer.Option(help="Another metric than the tuned one, e.g. observable.c2c_mean_mm.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Which parameters matter: Sobol indices of the surrogate.

    Example: gatetune study sensitivity runs/mine
    """
    from tuner.studies.sensitivity import campaign_sensitivity, sensitivity_tables, summary_lines

    result = campaign_sensitivity(campaign, metric)
    output.print(*sensitivity_tables(result, output.width))
    for line in summary_lines(result):
        output.print(line)
    answer_json(result)
