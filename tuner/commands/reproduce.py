"""``gatetune reproduce``: job 3."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from nbv.config import IDEAL, PRESETS, load_conditions
from tuner.commands.comparison import compare
from tuner.commands.console import (
    AsJson,
    load,
    mission_config,
    output,
    rock_arguments,
)
from tuner.commands.options import Conditions, Fidelity, Overrides, Timeout, Workers
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
    conditions: Conditions = None,
    replicates: Annotated[int, typer.Option(help="Per rock; the paper flew one.")] = 1,
    strategies: Annotated[
        list[str] | None,
        typer.Option("--strategy", help="Repeatable (default: the paper's four, learned, greedy-oracle)."),
    ] = None,
    set_: Overrides = None,
    fidelity: Fidelity = DEFAULT_FIDELITY,
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
    from tuner.evaluation.of_campaign import Asked, CampaignEvaluation
    from tuner.evaluation.plan import EvaluationPlan

    base = mission_config(preset, set_ or [])
    chosen = tuple(rock_arguments(rocks or ["vesicular"]))
    configs = baseline_configs(list(strategies or REPRODUCTION_STRATEGIES), base)
    plan = EvaluationPlan(
        configs,
        chosen,
        replicates,
        keep="all",
        fidelity=fidelity,
        conditions=load_conditions(conditions or [IDEAL]),
    )
    asked = Asked(Objective("whole.completeness_48mm"))
    compare(
        CampaignEvaluation(plan, next(iter(configs)), asked),
        Path("runs/reproduce"),
        out,
        workers=workers,
        timeout_s=timeout_s,
        title=f"Table I reproduced with preset {preset}: {PRESETS[preset].purpose}",
        paper=True,
    )
