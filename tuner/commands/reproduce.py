"""``gatetune reproduce``: job 3."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from nbv.config import IDEAL, PRESETS, load_conditions
from tuner.commands.comparison import compare
from tuner.commands.console import (
    CONDITION_HELP,
    AsJson,
    load,
    mission_config,
    output,
    rock_arguments,
)
from tuner.commands.options import Fidelity, Timeout, Workers
from tuner.missions.registry import DEFAULT_FIDELITY
from tuner.problem.objective import Objective


def reproduce(
    rocks: Annotated[
        list[str] | None, typer.Option("--rock", help="Rock or mesh file, repeatable (default: vesicular).")
    ] = None,
    preset: Annotated[
        str,
        typer.Option(
            help="paper (the text), paper-reduced (the text with reduced SfM, for speed) or paper-code (what the public code does)."
        ),
    ] = "paper",
    conditions: Annotated[
        list[str] | None, typer.Option("--condition", help=CONDITION_HELP + " Repeatable (default: ideal).")
    ] = None,
    replicates: Annotated[int, typer.Option(help="Per rock; the paper flew one.")] = 1,
    strategies: Annotated[
        list[str] | None,
        typer.Option("--strategy", help="Repeatable (default: the paper's four, learned, greedy-oracle)."),
    ] = None,
    set_: Annotated[list[str] | None, typer.Option("--set", help="PATH=VALUE for every mission.")] = None,
    fidelity: Fidelity = DEFAULT_FIDELITY,
    keep: Annotated[bool, typer.Option(help="Keep images, models and clouds of every mission.")] = True,
    workers: Workers = None,
    timeout_s: Timeout = 7200.0,
    out: Annotated[Path | None, typer.Option(help="Directory (default: runs/reproduce).")] = None,
    as_json: AsJson = False,
) -> None:
    """Fly the paper's default configuration for its strategies and two references; print its Table I beside the paper's numbers.

    Example: gatetune reproduce --replicates 3
    """
    output.print(f"reproducing Table I with preset {preset}")  # before what takes seconds to load
    load("tuner.evaluation.baselines")
    from tuner.evaluation.baselines import REPRODUCTION_STRATEGIES, baseline_configs
    from tuner.evaluation.flying import place_for
    from tuner.evaluation.of_campaign import Asked
    from tuner.evaluation.plan import EvaluationPlan

    base = mission_config(preset, set_ or [])
    chosen = tuple(rock_arguments(rocks or ["vesicular"]))
    configs = baseline_configs(list(strategies or REPRODUCTION_STRATEGIES), base)
    plan = EvaluationPlan(
        configs,
        chosen,
        replicates,
        keep="all" if keep else "summary",
        fidelity=fidelity,
        conditions=load_conditions(conditions or [IDEAL]),
    )
    compare(
        plan,
        out or place_for(plan, Path("runs/reproduce")),
        workers=workers,
        timeout_s=timeout_s,
        asked=Asked(Objective("whole.completeness_48mm")),
        reference=next(iter(configs)) if len(configs) > 1 else None,
        title=f"Table I reproduced with preset {preset}: {PRESETS[preset].purpose}",
        paper=True,
    )
