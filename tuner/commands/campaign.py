"""``gatetune campaign run|resume|status|list``: job 1."""

from __future__ import annotations

import contextlib
import json
import shlex
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.padding import Padding

from nbv import plugins
from nbv.errors import UserError
from nbv.safe_files import read_json
from tuner.answer.answer import ANSWER_FILE, Answer
from tuner.campaign.begin import begin_campaign, extend_campaign
from tuner.campaign.campaign import Campaign, CampaignSummary
from tuner.campaign.session import run_showcase, showcase_jobs
from tuner.campaign.settings import SEARCH, CampaignSettings
from tuner.campaign.settings_file import SETTINGS_FILE, merged_settings, resolved_settings, settings_there
from tuner.commands.campaign_display import (
    CampaignProgress,
    event_line,
    expected_s,
    expected_text,
    show_answer,
    show_counts,
)
from tuner.commands.console import (
    LOADING_ROCKS,
    AsJson,
    answer_json,
    executor_at,
    load,
    note_dense_stage,
    output,
    parse_overrides,
    require_complete,
    under_conditions,
    working,
)
from tuner.commands.evaluate import run_with_progress
from tuner.commands.options import (
    EXECUTION,
    ExecutorOption,
    Scheduler,
    Timeout,
    Workers,
    with_settings,
)
from tuner.comparison.of_campaign import PlannedComparison, require_comparable
from tuner.jobs import run_to_end
from tuner.missions import pool
from tuner.missions.registry import mission_kind
from tuner.report import words
from tuner.report.labels import counted, duration

app = typer.Typer(no_args_is_help=True)

MODEL = "tuner.samplers.gp"  # takes a second to load; a finished campaign is shown without it
RUNS = Path("runs")


@app.command()
@with_settings(CampaignSettings)
def run(
    given: dict[str, Any],
    settings: Annotated[
        Path | None,
        typer.Argument(
            help="YAML file of settings, such as another campaign's campaign.yaml; options go before it."
        ),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="The small campaign of `make tune`.", rich_help_panel=SEARCH)
    ] = False,
    workers: Workers = None,
    timeout_s: Timeout = 3600.0,
    executor: ExecutorOption = "local",
    scheduler: Scheduler = None,
    out: Annotated[
        Path | None, typer.Option(help="Run directory (default: runs/NAME).", rich_help_panel=EXECUTION)
    ] = None,
    resume_if_present: Annotated[
        bool,
        typer.Option(
            "--resume-if-present",
            help="Resume the campaign if the directory already holds it; settings given must be its own.",
            rich_help_panel=EXECUTION,
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Run a campaign: first the paper's values, then an initial design, then what a Gaussian process proposes.

    A trial is one mission.

    Example: gatetune campaign run --name mine --rock mine --budget 32
    """
    if "overrides" in given:
        given["overrides"] = parse_overrides(given["overrides"])
    fields = merged_settings(settings, given, quick=quick)
    named = str(fields["name"])
    if out is None and (named in (".", "..") or Path(named).name != named):
        raise UserError(f"--name {named!r} must be a folder name without '/'; --out names a folder elsewhere")
    directory, where = out or RUNS / named, (executor, scheduler)
    output.print(f"campaign {fields['name']} in {directory}")
    if resume_if_present and (directory / SETTINGS_FILE).is_file():
        asked = merged_settings(settings, given, quick=False) if settings or given else {}
        if out is None:  # it chose the directory
            asked.pop("name", None)
        campaign = Campaign.open(directory, settings_there(directory, asked))
        output.print("it exists already and is resumed")
        ready = executor_at(where, campaign.settings, workers, timeout_s)
        return run_and_report(campaign, ready, show_pair=quick)
    with working(LOADING_ROCKS):
        resolved = resolved_settings(fields, str(settings or "command line"))
        require_comparable(resolved)
    if executor == "local" and scheduler is None:
        mission_kind(resolved.fidelity).require_dense_stage(resolved.problem.base)
    # Before anything is written: a wrong address leaves no campaign behind.
    with executor_at(where, resolved, workers, timeout_s) as ready:
        ready.begin()
        load(MODEL)
        run_and_report(begin_campaign(directory, resolved), ready, show_pair=quick)


@app.command()
def resume(
    directory: Annotated[Path, typer.Argument(help="A campaign's run directory.")],
    workers: Workers = None,
    missions: Annotated[
        int | None, typer.Option(help="A larger budget than the campaign began with.")
    ] = None,
    timeout_s: Timeout = 3600.0,
    executor: ExecutorOption = "local",
    scheduler: Scheduler = None,
    accept_changes: Annotated[
        bool, typer.Option("--accept-changes", help="Resume although rocks or code have changed since.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Resume an interrupted campaign; only the missions that were running are repeated.

    Example: gatetune campaign resume runs/mine --missions 64
    """
    output.print(f"campaign in {directory}")
    campaign = Campaign.open(directory)
    # The same number is given again where a resume was refused.
    if missions is not None and missions != campaign.settings.budget:
        campaign = extend_campaign(campaign, missions)
    ready = executor_at((executor, scheduler), campaign.settings, workers, timeout_s)
    run_and_report(campaign, ready, accept_changes=accept_changes)


@app.command()
def status(
    directory: Annotated[Path, typer.Argument(help="A campaign's run directory.")], as_json: AsJson = False
) -> None:
    """Show counts, costs and the recommendation so far; safe while the campaign runs.

    Example: gatetune campaign status runs/mine
    """
    output.print(f"campaign in {directory}")
    campaign = Campaign.open(directory, read_only=True)
    counts = campaign.status()
    show_counts(counts)
    answer = show_answer(campaign, save=False)
    with contextlib.suppress(
        OSError
    ):  # `list` reads it; a folder that cannot be written is looked at all the same
        answer.save(campaign)
    missions = {**vars(counts), "finished": counts.finished, "trials": counts.complete + counts.failed}
    answer_json(
        {
            "directory": directory,
            "status": {name: value for name, value in missions.items() if name != "complete"},
            "fly": None if answer.fly is None else answer.fly.strategy,
            "sentences": words.sentences(answer),
            "answer": answer.to_dict(),
        }
    )


@app.command("list")
def list_(
    folder: Annotated[Path, typer.Argument(help="Folder that holds run directories.")] = Path("runs"),
    as_json: AsJson = False,
) -> None:
    """List the campaigns in a folder: progress, objective and answer of each.

    Example: gatetune campaign list
    """
    directories = sorted(path.parent for path in folder.glob(f"*/{SETTINGS_FILE}"))
    if not directories:
        raise UserError(
            f"{folder} holds no campaign; begin one: gatetune campaign run, or name another folder"
        )
    rows = [_row(directory) for directory in directories]
    for row in rows:
        output.print(row["directory"], style="bold", soft_wrap=True)
        output.print(Padding(row["answer"], (0, 0, 0, 2)))
    answer_json(rows)


def _row(directory: Path) -> dict[str, Any]:
    """What `list` shows of one campaign; of one that cannot be read, the reason."""
    row: dict[str, Any] = {"directory": str(directory), "finished": None, "budget": None}
    try:
        campaign = Campaign.open(directory, read_only=True)
    except UserError as error:
        return {**row, "answer": f"cannot be read: {error}"}
    counts, saved = campaign.status(), dict[str, Any]()
    with contextlib.suppress(UserError):  # damaged: `status` makes it anew
        saved = read_json(directory / ANSWER_FILE) if (directory / ANSWER_FILE).is_file() else {}
    fly, reason = (saved.get("fly") or {}).get("label"), campaign.nothing_yet()
    answer = f"nothing to fly yet: {reason}" if reason else f"fly {fly}"
    if not reason and (fly is None or saved.get("finished") != counts.finished):
        answer = f"not computed yet: gatetune campaign status {shlex.quote(str(directory))}"
    answer = f"{counts.finished} of {counts.budget} missions, tuned for {campaign.settings.goal}: {answer}"
    return {**row, "finished": counts.finished, "budget": counts.budget, "answer": answer}


def run_and_report(
    campaign: Campaign,
    executor: pool.Executor,
    *,
    accept_changes: bool = False,
    show_pair: bool = False,
) -> None:
    """Run or resume a campaign with live progress, and write its report.

    ``show_pair``: run the default and the recommendation once more with all files kept, for the interactive page.
    """
    settings, counts = campaign.settings, campaign.status()
    remaining = 0 if counts.exhausted else counts.remaining
    if remaining:
        load(MODEL)
    workers = getattr(executor, "workers", executor.capacity)  # a cluster may have none yet
    output.print(
        f"{settings.name}: {settings.budget} missions over {', '.join(settings.rocks)}{under_conditions(settings.conditions)}; "
        f"search space {settings.space.name} ({settings.space.dimension} parameters), sampler {settings.sampler}, "
        f"{counted(workers, 'worker') if workers else 'no worker yet: missions wait for the first'}"
    )
    note_dense_stage(mission_kind(settings.fidelity), settings.problem.base)
    about_s = expected_s(campaign, workers)
    if remaining:
        then = "; then a comparison" if settings.compare_on else ""
        output.print(expected_text(remaining, about_s) + then)
    if note := mission_kind(settings.fidelity).note:
        output.print(note)
    if campaign.learned is not None:
        output.print(
            f"learned from {len(campaign.learned.observations)} earlier missions on {', '.join(campaign.learned.rocks)}"
        )
    with executor, contextlib.ExitStack() as shown:
        progress = shown.enter_context(CampaignProgress(settings))

        def searched(summary: CampaignSummary) -> None:
            shown.close()
            if summary.stopped == "interrupted":  # and the prompt is back at once
                where = shlex.quote(str(campaign.directory))
                named = [word for spec in plugins.plugin_specs() for word in ("--plugin", spec)]
                program = shlex.join(["gatetune", *named])
                output.print(f"resume with: {program} campaign resume {where}", soft_wrap=True)
                output.print(f"write its report so far: {program} mission view {where}", soft_wrap=True)
                raise typer.Exit(130)
            output.print(
                f"{summary.message}; {duration(summary.elapsed_s)}, of which the sampler {duration(summary.ask_s)}"
            )
            if settings.compare_on and summary.found:
                output.print(f"preparing the comparison, {LOADING_ROCKS}")

        def compared(planned: PlannedComparison) -> None:  # what has run is not run again
            plan = planned.plan
            output.print(
                f"comparison on {', '.join(plan.rocks)}: {len(plan.strategies)} strategies, {plan.missions} missions"
            )
            where = shlex.quote(str(campaign.directory))
            evaluated = run_with_progress(planned, executor)
            require_complete(evaluated, f"resume with: gatetune campaign resume {where}")

        summary = run_to_end(
            campaign,
            executor,
            (lambda event: typer.echo(event_line(event))) if output.quiet else progress,
            searched=searched,
            compare=compared,
            accept_changes=accept_changes,
        )
        answer = show_answer(campaign)
        if output.quiet:
            typer.echo(json.dumps({"event": "answer", **answer.to_dict()}))
        if summary.status.finished:
            write_pages(campaign, answer, executor if show_pair and summary.stopped == "budget" else None)
    if summary.stopped == "failing" or not summary.status.complete:
        raise typer.Exit(1)


def write_pages(campaign: Campaign, answer: Answer, pair: pool.Executor | None) -> None:
    """Write the report; with the executor ``pair`` first run the default and the tuned mission with all files kept."""
    from tuner.report.campaign_page import write_campaign_report, write_showcase_page

    page, shown = None, showcase_jobs(campaign)
    try:
        if pair is not None and shown:
            with working("running the default and the tuned mission once more, to show them"):
                run_showcase(campaign, pair)
                page = write_showcase_page(campaign)
        with working("writing the report"):
            report = write_campaign_report(campaign, answer)
    except KeyboardInterrupt:
        output.print(
            f"no report: gatetune mission view {shlex.quote(str(campaign.directory))} writes it",
            soft_wrap=True,
        )
        raise typer.Exit(130) from None
    output.print(f"report: {report}", soft_wrap=True)
    if page is not None:
        output.print(f"interactive page, the default beside the tuned mission: {page}", soft_wrap=True)
    elif shown:
        output.print(
            f"write an interactive page of it: gatetune mission view {shlex.quote(str(campaign.directory))}",
            soft_wrap=True,
        )
