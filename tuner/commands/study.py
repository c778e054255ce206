"""``gatetune study``: noise, departures, oracles, sensitivity."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from nbv.errors import UserError
from tuner.commands.comparison import ComparisonProgress
from tuner.commands.console import output, parse_overrides, rock_arguments
from tuner.commands.mission import progress_bar

if TYPE_CHECKING:
    from collections.abc import Callable

    from tuner.evaluation.flying import EvaluationEvent
    from tuner.missions.executors import Executor

app = typer.Typer(no_args_is_help=True)


@app.command()
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
    set_: Annotated[list[str] | None, typer.Option("--set", help="PATH=VALUE for every mission.")] = None,
    seed: Annotated[int, typer.Option(help="Of the Sobol points.")] = 0,
    workers: Annotated[
        int | None, typer.Option(help="Missions side by side (default: one per core).")
    ] = None,
    timeout_s: Annotated[float, typer.Option(help="A mission that takes longer is killed.")] = 3600.0,
    out: Annotated[Path, typer.Option(help="Directory; the same command goes on where it stopped.")] = Path(
        "runs/noise"
    ),
    report_only: Annotated[
        bool, typer.Option("--report-only", help="Fly nothing; report on what --out holds.")
    ] = False,
) -> None:
    """Does the objective tell configurations apart? Variance by configuration, rock and replicate."""
    from tuner.studies.noise.study import analyse

    complete = True
    if not report_only:
        complete = _fly_noise_study(
            space,
            rocks,
            budgets,
            configurations,
            replicates,
            repeats,
            controls,
            metrics,
            preset,
            set_,
            seed,
            workers,
            timeout_s,
            out,
        )
    from tuner.studies.noise.report import noise_table, write_noise_report

    findings = analyse(out)
    for metric in findings.settings.metrics:
        if findings.ranked(metric):
            output.print(noise_table(findings, metric))
        else:
            output.print(f"{metric}: not enough complete configurations yet")
    write_noise_report(findings, out)
    _end_study(findings.failures, len(findings.records), findings.expected, out / "noise.md", complete)


def _fly_noise_study(
    space: str,
    rocks: list[str] | None,
    budgets: list[int] | None,
    configurations: int,
    replicates: int,
    repeats: int,
    controls: list[str] | None,
    metrics: list[str] | None,
    preset: str,
    set_: list[str] | None,
    seed: int,
    workers: int | None,
    timeout_s: float,
    out: Path,
) -> bool:
    from tuner.commands.rock_choice import training_rocks
    from tuner.problem.space_files import load_search_space
    from tuner.studies.noise.study import NoiseSettings, fly

    count = _worker_count(workers)
    chosen = _study_rocks(rocks, training_rocks())
    given: dict[str, Any] = {"budgets": budgets, "metrics": metrics}
    if controls is not None:
        given["controls"] = [name for name in controls if name != "none"]
    options: dict[str, Any] = {name: tuple(value) for name, value in given.items() if value is not None}
    settings = NoiseSettings(
        load_search_space(space),
        chosen,
        configurations=configurations,
        replicates=replicates,
        repeats=repeats,
        seed=seed,
        preset=preset,
        overrides=parse_overrides(set_ or []),
        **options,
    )
    output.print(
        f"{len(settings.configs(settings.budgets[0]))} configurations and controls x {len(chosen)} rocks x "
        f"{replicates} replicates x budgets {', '.join(map(str, settings.budgets))}, and {repeats} more replicates "
        f"of the default: {settings.missions} missions, {count} workers"
    )
    return _fly_study(
        lambda executor, show: fly(settings, out, executor, show),
        (settings.runner,),
        count,
        timeout_s,
        f"agreement.{min(settings.levels)}.{settings.metrics[0]}",
    )


@app.command()
def departures(
    rocks: Annotated[
        list[str] | None,
        typer.Option(
            "--rock", help="Training rock or mesh file, repeatable (default: slab, vesicular, cavern)."
        ),
    ] = None,
    replicates: Annotated[int, typer.Option(help="Of every arm on every rock.")] = 2,
    preset: Annotated[str, typer.Option(help="Mission preset of the base.")] = "campaign",
    gate: Annotated[str, typer.Option(help="The base's gate.")] = "hyb-h",
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="PATH=VALUE for the base and all arms.")
    ] = None,
    arms: Annotated[
        list[str] | None, typer.Option("--arm", help="Departure, repeatable (default: all).")
    ] = None,
    surface: Annotated[str, typer.Option(help="observable or whole.")] = "observable",
    fidelity: Annotated[
        str, typer.Option(help="photogrammetric, or geometric: seconds instead of hours, no photographs.")
    ] = "photogrammetric",
    workers: Annotated[
        int | None, typer.Option(help="Missions side by side (default: one per core).")
    ] = None,
    timeout_s: Annotated[float, typer.Option(help="A mission that takes longer is killed.")] = 3600.0,
    out: Annotated[Path, typer.Option(help="Directory; the same command goes on where it stopped.")] = Path(
        "runs/departures"
    ),
    report_only: Annotated[
        bool, typer.Option("--report-only", help="Fly nothing; report on what --out holds.")
    ] = False,
) -> None:
    """What does each departure of the authors' public code do to the outcome? One at a time, paired."""
    from tuner.commands.rock_choice import QUICK_ROCKS
    from tuner.missions.registry import with_oracle
    from tuner.studies.departures import DEPARTURES, DepartureSettings, analyse, fly
    from tuner.studies.departures.report import departures_table, write_departures_report

    complete = True
    if not report_only:
        settings = DepartureSettings(
            _study_rocks(rocks, QUICK_ROCKS),
            replicates,
            preset,
            gate,
            parse_overrides(set_ or []),
            tuple(arms or DEPARTURES),
            surface,
            with_oracle(fidelity),
        )
        plan = settings.plan()
        output.print(
            f"{len(plan.strategies)} configurations x {len(plan.rocks)} rocks x {replicates} replicates: "
            f"{plan.missions} missions"
        )
        complete = _fly_study(
            lambda executor, show: fly(settings, out, executor, show),
            (settings.runner,),
            _worker_count(workers),
            timeout_s,
            f"{surface}.f_score_48mm",
        )
    findings = analyse(out)
    output.print(departures_table(findings))
    write_departures_report(findings, out)
    _end_study(findings.failures, findings.missions, findings.expected, out / "departures.md", complete)


@app.command()
def oracles(
    rocks: Annotated[
        list[str] | None,
        typer.Option(
            "--rock", help="Training rock or mesh file, repeatable (default: slab, vesicular, cavern)."
        ),
    ] = None,
    replicates: Annotated[int, typer.Option(help="Of every strategy on every rock.")] = 2,
    preset: Annotated[str, typer.Option(help="Mission preset.")] = "campaign",
    set_: Annotated[list[str] | None, typer.Option("--set", help="PATH=VALUE for every mission.")] = None,
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
    surface: Annotated[str, typer.Option(help="observable or whole.")] = "observable",
    fidelity: Annotated[
        str, typer.Option(help="photogrammetric, or geometric: seconds instead of hours, no photographs.")
    ] = "photogrammetric",
    workers: Annotated[
        int | None, typer.Option(help="Missions side by side (default: one per core).")
    ] = None,
    timeout_s: Annotated[float, typer.Option(help="A mission that takes longer is killed.")] = 3600.0,
    out: Annotated[Path, typer.Option(help="Directory; the same command goes on where it stopped.")] = Path(
        "runs/oracles"
    ),
    report_only: Annotated[
        bool, typer.Option("--report-only", help="Fly nothing; report on what --out holds.")
    ] = False,
) -> None:
    """When does the oracle count a sample as covered? Every reading of the paper, and what it gains."""
    from tuner.commands.rock_choice import QUICK_ROCKS
    from tuner.missions.registry import with_oracle
    from tuner.studies.oracles.report import oracles_table, write_oracles_report
    from tuner.studies.oracles.study import OracleSettings, analyse, fly

    complete = True
    if not report_only:
        options: dict[str, Any] = {"runner": with_oracle(fidelity)}
        if coverages:
            options["coverages"] = tuple(coverages)
        if greedy:
            options["greedy"] = tuple(name for name in greedy if name != "none")
        settings = OracleSettings(
            _study_rocks(rocks, QUICK_ROCKS),
            replicates,
            preset,
            parse_overrides(set_ or []),
            surface=surface,
            **options,
        )
        plan = settings.plan()
        output.print(
            f"{len(plan.strategies)} strategies x {len(plan.rocks)} rocks x {replicates} replicates: "
            f"{plan.missions} missions"
        )
        complete = _fly_study(
            lambda executor, show: fly(settings, out, executor, show),
            (settings.runner,),
            _worker_count(workers),
            timeout_s,
            f"{surface}.f_score_48mm",
        )
    findings = analyse(out)
    output.print(oracles_table(findings))
    write_oracles_report(findings, out)
    _end_study(findings.failures, findings.missions, findings.expected, out / "oracles.md", complete)


@app.command("oracle-states")
def oracle_states(
    runs: Annotated[
        list[Path], typer.Argument(help="Directories with missions that were flown with everything kept.")
    ],
    rocks: Annotated[
        list[str] | None, typer.Option("--rock", help="Mesh file that missions were flown on, repeatable.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Markdown file of the table.")] = Path("oracle_states.md"),
) -> None:
    """What every oracle would have preferred on the same planning states."""
    from nbv.mission.run_directory import write_atomic
    from tuner.studies.oracles.report import states_markdown, states_table
    from tuner.studies.oracles.states import judge

    judged = judge(runs, rocks or [])
    output.print(states_table(judged))
    try:
        write_atomic(out, states_markdown(judged))
    except OSError as error:
        raise UserError(f"cannot write {out}: {error.strerror}; choose another --out") from error
    output.print(out)


def _study_rocks(rocks: list[str] | None, otherwise: list[str]) -> tuple[str, ...]:
    from tuner.commands.rock_choice import refuse_held_out

    chosen = rock_arguments(rocks or otherwise)
    refuse_held_out(chosen)
    return tuple(chosen)


def _worker_count(workers: int | None) -> int:
    if workers is not None and workers < 1:
        raise UserError(f"--workers is {workers}; give at least 1")
    return workers or len(os.sched_getaffinity(0))


def _fly_study(
    fly: Callable[[Executor, Callable[[EvaluationEvent], None]], bool],
    runners: tuple[str, ...],
    workers: int,
    timeout_s: float,
    metric: str,
) -> bool:
    from tuner.missions.executors import LocalProcessExecutor

    with (
        LocalProcessExecutor(workers, timeout_s=timeout_s, preload=runners) as executor,
        progress_bar() as bar,
    ):
        return fly(executor, ComparisonProgress(bar, metric))


def _end_study(failures: dict[str, int], missions: int, expected: int, report: Path, complete: bool) -> None:
    for reason, times in failures.items():
        output.print(f"[red]failed {times} times: {reason}[/]")
    output.print(f"{missions} of {expected} missions; report: {report}")
    if not complete:
        output.print("interrupted; the same command goes on where it stopped")
        raise typer.Exit(130)


@app.command()
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
    """Which parameters matter: Sobol indices on the surrogate, beside fANOVA and PED-ANOVA."""
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
