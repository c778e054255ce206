"""``python -m research.departures``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from research.study_command import (
    Fidelity,
    Out,
    QuickRocks,
    ReportOnly,
    Surface,
    end_study,
    fly_study,
    run,
    study_rocks,
)
from tuner.campaign.rock_choice import QUICK_ROCKS
from tuner.commands.console import output, parse_overrides
from tuner.commands.options import Timeout, Workers


def departures(
    rocks: QuickRocks = None,
    replicates: Annotated[int, typer.Option(help="Of every arm on every rock.")] = 2,
    preset: Annotated[str, typer.Option(help="Mission preset of the base.")] = "campaign",
    gate: Annotated[str, typer.Option(help="The base's gate.")] = "hyb-h",
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="PATH=VALUE for the base and all arms.")
    ] = None,
    arms: Annotated[
        list[str] | None, typer.Option("--arm", help="Departure, repeatable (default: all).")
    ] = None,
    surface: Surface = "observable",
    fidelity: Fidelity = "photogrammetric",
    workers: Workers = None,
    timeout_s: Timeout = 3600.0,
    out: Out = Path("runs/departures"),
    report_only: ReportOnly = False,
) -> None:
    """What does each departure of the authors' public code do to the outcome? One at a time, paired.

    Example: python -m research.departures --fidelity geometric
    """
    from research.departures import DEPARTURES, DepartureSettings, analyse
    from research.departures.report import departures_table, write_departures_report
    from research.with_oracle import with_oracle

    complete = True
    if not report_only:
        settings = DepartureSettings(
            study_rocks(rocks, QUICK_ROCKS),
            replicates,
            preset,
            gate,
            parse_overrides(set_ or []),
            tuple(arms or DEPARTURES),
            surface,
            with_oracle(fidelity),
        )
        complete = fly_study(settings, out, workers, timeout_s, f"{surface}.f_score_48mm")
    findings = analyse(out)
    output.print(departures_table(findings))
    write_departures_report(findings, out)
    end_study(findings.failures, findings.missions, findings.expected, out / "departures.md", complete)


if __name__ == "__main__":
    run(departures)
