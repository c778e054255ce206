"""``python -m research.oracles oracles`` and ``oracle-states``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from nbv.errors import UserError
from research.study_command import (
    Fidelity,
    Out,
    QuickRocks,
    ReportOnly,
    SetForAll,
    Surface,
    end_study,
    fly_study,
    run,
    study_rocks,
)
from tuner.campaign.rock_choice import QUICK_ROCKS
from tuner.commands.console import output, parse_overrides
from tuner.commands.options import Timeout, Workers


def oracles(
    rocks: QuickRocks = None,
    replicates: Annotated[int, typer.Option(help="Of every strategy on every rock.")] = 2,
    preset: Annotated[str, typer.Option(help="Mission preset.")] = "campaign",
    set_: SetForAll = None,
    coverages: Annotated[
        list[str] | None, typer.Option("--coverage", help="Of Hyb-O, repeatable (default: all).")
    ] = None,
    greedy: Annotated[
        list[str] | None,
        typer.Option(
            "--greedy",
            help="Coverage of a greedy oracle, repeatable (default: all that do not "
            "saturate at once); none for no greedy oracle.",
        ),
    ] = None,
    surface: Surface = "observable",
    fidelity: Fidelity = "photogrammetric",
    workers: Workers = None,
    timeout_s: Timeout = 3600.0,
    out: Out = Path("runs/oracles"),
    report_only: ReportOnly = False,
) -> None:
    """When does the oracle count a sample as covered? Every reading of the paper, and what it gains.

    Example: python -m research.oracles oracles --rock slab
    """
    from research.oracles import OracleSettings, analyse
    from research.oracles.report import oracles_table, write_oracles_report
    from research.with_oracle import with_oracle

    complete = True
    if not report_only:
        options: dict[str, Any] = {"fidelity": with_oracle(fidelity)}
        if coverages:
            options["coverages"] = tuple(coverages)
        if greedy:
            options["greedy"] = tuple(name for name in greedy if name != "none")
        settings = OracleSettings(
            study_rocks(rocks, QUICK_ROCKS),
            replicates,
            preset,
            parse_overrides(set_ or []),
            surface=surface,
            **options,
        )
        complete = fly_study(settings, out, workers, timeout_s, f"{surface}.f_score_48mm")
    findings = analyse(out)
    output.print(oracles_table(findings))
    write_oracles_report(findings, out)
    end_study(findings.failures, findings.missions, findings.expected, out / "oracles.md", complete)


def oracle_states(
    runs: Annotated[
        list[Path], typer.Argument(help="Directories with missions that were flown with everything kept.")
    ],
    rocks: Annotated[
        list[str] | None, typer.Option("--rock", help="Mesh file that missions were flown on, repeatable.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Markdown file of the table.")] = Path("oracle_states.md"),
) -> None:
    """What every oracle would have preferred on the same planning states.

    Example: python -m research.oracles oracle-states runs/mission-slab-hyb-h-0
    """
    from nbv.mission.run_directory import write_atomic
    from research.oracles.report import states_markdown, states_table
    from research.oracles.states import judge

    judged = judge(runs, rocks or [])
    output.print(states_table(judged))
    try:
        write_atomic(out, states_markdown(judged))
    except OSError as error:
        raise UserError(f"cannot write {out}: {error.strerror}; choose another --out") from error
    output.print(f"report: {out}")


if __name__ == "__main__":
    run(oracles, oracle_states)
