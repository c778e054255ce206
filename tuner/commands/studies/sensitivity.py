"""``gatetune study sensitivity``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from nbv.errors import UserError
from tuner.commands.console import output, parse_overrides


def sensitivity(
    runs: Annotated[
        list[Path],
        typer.Argument(
            help="A campaign's directory, or directories with missions (a noise study, an evaluation, ...)."
        ),
    ],
    space: Annotated[
        str | None, typer.Option(help="Search space of the missions (a campaign knows its own).")
    ] = None,
    metric: Annotated[
        str | None,
        typer.Option(
            help="E.g. observable.f_score_48mm, or agreement.5.observable.f_score_48mm of a noise study."
        ),
    ] = None,
    where: Annotated[
        list[str] | None, typer.Option(help="PATH=VALUE: only missions with that value.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Of fit and sampling.")] = 0,
    out: Annotated[Path | None, typer.Option(help="Directory (default: RUN/sensitivity).")] = None,
) -> None:
    """Which parameters matter: Sobol indices on the surrogate, beside fANOVA and PED-ANOVA.

    Example: gatetune study sensitivity runs/mine
    """
    from tuner.problem.objective import DEFAULT_METRIC
    from tuner.problem.space_files import load_search_space
    from tuner.studies.missions_as_data import campaign_data, is_campaign, mission_data
    from tuner.studies.sensitivity.report import sensitivity_table, summary_lines, write_sensitivity_report
    from tuner.studies.sensitivity.study import sensitivity as analyse_sensitivity

    if len(runs) == 1 and is_campaign(runs[0]):
        if space is not None or where:
            raise UserError(f"{runs[0]} is a campaign with a space of its own; leave out --space and --where")
        data = campaign_data(runs[0], metric)
    else:
        chosen = load_search_space(space or "gate_and_weights")
        data = mission_data(runs, chosen, metric or DEFAULT_METRIC, parse_overrides(where or []))
    result = analyse_sensitivity(data, seed)
    output.print(sensitivity_table(result))
    for line in summary_lines(result):
        output.print(line)
    directory = out or runs[0] / "sensitivity"
    write_sensitivity_report(result, directory)
    output.print(f"report: {directory / 'sensitivity.md'}")
