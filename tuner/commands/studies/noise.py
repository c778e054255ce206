"""``gatetune study noise``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from tuner.campaign.rock_choice import training_rocks
from tuner.commands.console import output, parse_overrides
from tuner.commands.options import Timeout, Workers
from tuner.commands.studies.flying import (
    Out,
    ReportOnly,
    SetForAll,
    end_study,
    fly_study,
    study_rocks,
)


def noise(
    space: Annotated[
        str, typer.Option(help="Search space whose configurations are compared.")
    ] = "gate_and_weights",
    rocks: Annotated[
        list[str] | None,
        typer.Option("--rock", help="Training rock, repeatable (default: the procedural ones)."),
    ] = None,
    budgets: Annotated[
        list[int] | None,
        typer.Option("--budget", help="Adaptive captures, repeatable (default: 8, 12, 16, 40)."),
    ] = None,
    configurations: Annotated[int, typer.Option(help="Sobol points of the space.")] = 16,
    replicates: Annotated[int, typer.Option(help="Of every configuration on every rock.")] = 3,
    repeats: Annotated[int, typer.Option(help="Further replicates of the default configuration.")] = 5,
    controls: Annotated[
        list[str] | None,
        typer.Option(
            "--control", help="Repeatable (default: learned, random, greedy-oracle); none for no control."
        ),
    ] = None,
    metrics: Annotated[
        list[str] | None, typer.Option("--metric", help="Repeatable, e.g. observable.f_score_48mm.")
    ] = None,
    preset: Annotated[
        str, typer.Option(help="Mission preset; budget and agreement are the study's.")
    ] = "campaign",
    set_: SetForAll = None,
    seed: Annotated[int, typer.Option(help="Of the Sobol points.")] = 0,
    workers: Workers = None,
    timeout_s: Timeout = 3600.0,
    out: Out = Path("runs/noise"),
    report_only: ReportOnly = False,
) -> None:
    """Does the objective tell configurations apart? Variance by configuration, rock and replicate.

    Example: gatetune study noise --rock slab
    """
    from tuner.problem.space_files import load_search_space
    from tuner.studies.noise import NoiseSettings, analyse
    from tuner.studies.noise.report import noise_table, write_noise_report

    complete = True
    if not report_only:
        given = {"budgets": budgets, "metrics": metrics}
        if controls is not None:
            given["controls"] = [name for name in controls if name != "none"]
        options: dict[str, Any] = {name: tuple(v) for name, v in given.items() if v is not None}
        settings = NoiseSettings(
            load_search_space(space),
            study_rocks(rocks, training_rocks()),
            configurations=configurations,
            replicates=replicates,
            repeats=repeats,
            seed=seed,
            preset=preset,
            overrides=parse_overrides(set_ or []),
            **options,
        )
        metric = f"agreement.{min(settings.levels)}.{settings.metrics[0]}"
        complete = fly_study(settings, out, workers, timeout_s, metric)
    findings = analyse(out)
    for metric in findings.settings.metrics:
        if findings.ranked(metric):
            output.print(noise_table(findings, metric))
        else:
            output.print(f"{metric}: not enough complete configurations yet")
    write_noise_report(findings, out)
    end_study(findings.failures, len(findings.records), findings.expected, out / "noise.md", complete)
