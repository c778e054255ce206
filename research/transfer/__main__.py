"""``python -m research.transfer``."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from nbv.config import available_conditions, load_conditions
from research.study_command import ReportOnly, end_study, fly_study, run
from tuner.commands.console import output, working
from tuner.commands.options import Timeout, Workers


def transfer(
    campaign: Annotated[Path, typer.Argument(help="The campaign's run directory.")],
    conditions: Annotated[
        list[str] | None,
        typer.Option("--condition", help="Name or YAML file, repeatable (default: all that ship)."),
    ] = None,
    fidelities: Annotated[
        list[str] | None,
        typer.Option("--fidelity", help="photogrammetric, geometric; repeatable (default: photogrammetric)."),
    ] = None,
    rocks: Annotated[
        list[str] | None,
        typer.Option("--rock", help="Held-out rock, repeatable (default: the procedural ones)."),
    ] = None,
    replicates: Annotated[int, typer.Option(help="Of every configuration on every rock.")] = 2,
    metric: Annotated[
        str | None,
        typer.Option(help="Default: the campaign's; e.g. registered.observable.f_score_48mm."),
    ] = None,
    neighbours: Annotated[int, typer.Option(help="Configurations drawn around the tuned one.")] = 6,
    workers: Workers = None,
    timeout_s: Timeout = 3600.0,
    out: Annotated[Path | None, typer.Option(help="Directory (default: CAMPAIGN/transfer).")] = None,
    report_only: ReportOnly = False,
) -> None:
    """Does what was tuned hold in another world? Rank correlation, regret, paired differences.

    Example: python -m research.transfer runs/mine --condition field
    """
    from research.transfer import TransferSettings, analyse, worlds
    from research.transfer.report import pairs_table, transfer_table, write_transfer_report

    directory = out or campaign / "transfer"
    complete = True
    if not report_only:
        from research.transfer.study import carried_over
        from tuner.campaign.campaign import Campaign
        from tuner.problem.objective import Objective, direction_of

        asked = worlds(
            load_conditions(conditions or list(available_conditions())),
            fidelities or ["photogrammetric"],
        )
        source = Campaign.open(campaign, read_only=True)
        objective = (
            Objective(metric, direction_of(metric)) if metric is not None else source.settings.objective
        )
        settings = TransferSettings(
            source.settings.name,
            asked,
            carried_over(source, neighbours),
            source.unseen_rocks(rocks, working),
            replicates,
            objective.metric,
            objective.direction,
        )
        complete = fly_study(settings, directory, workers, timeout_s, settings.metric)
    findings = analyse(directory)
    output.print(transfer_table(findings))
    if (table := pairs_table(findings)) is not None:
        output.print(table)
    report = write_transfer_report(
        findings, directory, f"python -m research.transfer {shlex.join(sys.argv[1:])}"
    )
    end_study(findings.failures, findings.missions, findings.expected, report, complete)


if __name__ == "__main__":
    run(transfer)
