"""``gatetune campaign run|resume|status``: job 1."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from nbv.errors import UserError
from tuner.commands.console import output, parse_overrides, rock_arguments, seconds
from tuner.commands.mission import progress_bar

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.progress import Progress

    from tuner.campaign.campaign import Campaign
    from tuner.campaign.events import CampaignEvent
    from tuner.campaign.settings import CampaignSettings
    from tuner.recommendation.recommendation import Recommendation

app = typer.Typer(no_args_is_help=True)

RUNS = Path("runs")
# `make tune`: what a real campaign needs, small enough for a quarter of an hour on two cores.
QUICK = {"space": "gate_and_weights", "budget": 48, "replicates": 2}
QUICK_ROCKS = ["slab", "vesicular", "cavern"]  # where configurations differ: docs/results/noise_floor.md


def training_rocks() -> list[str]:
    """The procedural rocks of the train split, in catalogue order."""
    from nbv.rocks import list_rocks

    return [info.name for info in list_rocks() if info.split == "train" and info.source == "procedural"]


@app.command()
def run(
    name: Annotated[str, typer.Option(help="The campaign's name; it lives in runs/NAME.")] = "campaign",
    space: Annotated[
        str,
        typer.Option(
            help="Search space: gate, gate_and_weights, paper_ten, gate_weights_and_pool, full, beyond_paper, or a YAML file."
        ),
    ] = "gate_and_weights",
    rocks: Annotated[
        list[str] | None,
        typer.Option("--rock", help="Training rock, repeatable (default: the procedural ones)."),
    ] = None,
    replicates: Annotated[int, typer.Option(help="Draws of arrival errors and noise per rock.")] = 2,
    budget: Annotated[int, typer.Option(help="Missions.")] = 64,
    seed: Annotated[int, typer.Option(help="Of the design and the acquisition.")] = 0,
    preset: Annotated[str, typer.Option(help="Mission preset.")] = "campaign",
    set_: Annotated[list[str] | None, typer.Option("--set", help="PATH=VALUE for every mission.")] = None,
    metric: Annotated[str | None, typer.Option(help="Metric to tune, e.g. observable.f_score_48mm.")] = None,
    minimise: Annotated[bool, typer.Option(help="Smaller is better (for distances).")] = False,
    sampler: Annotated[
        str, typer.Option(help="gp, sobol, random, tpe, cmaes, optuna-gp; after set-up ax, smac, hebo.")
    ] = "gp",
    workers: Annotated[
        int | None, typer.Option(help="Missions side by side (default: one per core).")
    ] = None,
    in_step: Annotated[
        int | None,
        typer.Option(
            help="Reproducible with any number of workers: a proposal knows all missions but the last N - 1; "
            "N workers have work (default: it knows what has ended)."
        ),
    ] = None,
    risk: Annotated[
        str, typer.Option(help="Tune the mean over the rocks, or that of the worst one: mean, worst.")
    ] = "mean",
    fidelity: Annotated[
        str,
        typer.Option(
            help="Of the missions: photogrammetric, or geometric (no photographs, a fraction of the time; it ranks "
            "configurations, it does not measure them)."
        ),
    ] = "photogrammetric",
    learn_from: Annotated[
        list[str] | None,
        typer.Option(
            "--learn-from",
            help="Run directory of an earlier campaign, of other rocks say; repeatable. shipped: the missions that come "
            "with this program for a space (default where there are some and the sampler is gp); nothing: begin without.",
        ),
    ] = None,
    second_metric: Annotated[
        str | None,
        typer.Option(help="Also optimise this, e.g. costs.flight_time_s, and list the Pareto front."),
    ] = None,
    second_minimise: Annotated[bool, typer.Option(help="Smaller is better for the second metric.")] = False,
    storage: Annotated[
        str | None, typer.Option(help="Optuna storage URL (default: a file in the run).")
    ] = None,
    timeout_s: Annotated[float, typer.Option(help="A mission that takes longer is killed.")] = 3600.0,
    keep: Annotated[
        str, typer.Option(help="summary, or all: images and models of every mission.")
    ] = "summary",
    out: Annotated[Path | None, typer.Option(help="Run directory (default: runs/NAME).")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="The small campaign of `make tune`.")] = False,
    resume_if_present: Annotated[bool, typer.Option(help="Go on if the directory holds it already.")] = False,
) -> None:
    """Run a campaign: the paper's defaults, an initial design, then a GP proposes; one mission per trial."""
    from tuner.campaign.begin import begin_campaign
    from tuner.campaign.campaign import Campaign
    from tuner.campaign.settings import SETTINGS_FILE, CampaignSettings
    from tuner.campaign.shipped import sources_by_default
    from tuner.missions.registry import registered
    from tuner.problem.objective import Objective
    from tuner.problem.search_space import load_search_space

    if keep not in ("summary", "all"):
        raise UserError(f"--keep is {keep!r}; it must be summary or all")
    directory = out or RUNS / name
    if resume_if_present and (directory / SETTINGS_FILE).is_file():
        output.print(f"{directory} holds a campaign already: going on with it")
        fly(Campaign.open(directory), workers, timeout_s)
        return
    if quick:
        space, budget, replicates = (
            str(QUICK["space"]),
            int(str(QUICK["budget"])),
            int(str(QUICK["replicates"])),
        )
        rocks = rocks or QUICK_ROCKS
    direction = {"direction": "minimise" if minimise else "maximise"}
    objective: Any = Objective(metric, **direction) if metric else Objective(**direction)  # type: ignore[arg-type]
    second = (
        Objective(second_metric, "minimise" if second_minimise else "maximise") if second_metric else None
    )
    chosen = rock_arguments(rocks or training_rocks())
    refuse_held_out(chosen)
    searched = load_search_space(space)
    settings = CampaignSettings(
        name=name,
        space=searched,
        rocks=tuple(chosen),
        budget=budget,
        replicates=replicates,
        seed=seed,
        preset=preset,
        overrides=parse_overrides(set_ or []),
        objective=objective,
        sampler=sampler,
        runner=registered(fidelity),
        keep=keep,  # type: ignore[arg-type]
        storage=storage,
        risk=risk,  # type: ignore[arg-type]
        second=second,
        learn_from=_sources(learn_from, sources_by_default(searched, objective, sampler, second)),
        in_step=in_step,
    )
    fly(begin_campaign(directory, settings), workers, timeout_s)


@app.command()
def resume(
    directory: Annotated[Path, typer.Argument(help="A campaign's run directory.")],
    workers: Annotated[int | None, typer.Option(help="Missions side by side.")] = None,
    missions: Annotated[
        int | None, typer.Option(help="A larger budget than the campaign began with, to search further.")
    ] = None,
    timeout_s: Annotated[float, typer.Option(help="A mission that takes longer is killed.")] = 3600.0,
) -> None:
    """Go on with an interrupted campaign; only the missions that were in flight are flown again."""
    from tuner.campaign.campaign import Campaign
    from tuner.campaign.extension import extend_campaign

    campaign = Campaign.open(directory) if missions is None else extend_campaign(directory, missions)
    fly(campaign, workers, timeout_s)


@app.command()
def status(directory: Annotated[Path, typer.Argument(help="A campaign's run directory.")]) -> None:
    """Counts, costs and the recommendation so far; safe while the campaign runs."""
    from tuner.campaign.campaign import Campaign

    campaign = Campaign.open(directory, read_only=True)
    facts = campaign.status()
    output.print(
        f"[bold]{facts.name}[/]: {facts.finished} of {facts.budget} missions "
        f"({facts.failed} failed, {facts.running} open); "
        f"{seconds(facts.mission_wall_s)} of computing, {seconds(facts.flight_time_s)} of simulated flight"
    )
    output.print(
        "missions per rock: " + ", ".join(f"{rock} {count}" for rock, count in facts.per_rock.items())
    )
    for reason, count in facts.failures.items():
        output.print(f"  failed {count} times: {reason}")
    show_recommendation(campaign.recommendation(save=False, check=True))
    show_front(campaign)


def refuse_held_out(rocks: Sequence[str]) -> None:
    """Held-out rocks are never tuned on, and no default is chosen on them.

    Raises
    ------
    UserError
        A rock of the held-out split.
    """
    from nbv.cache import Store
    from nbv.rocks import load_rock

    for rock in rocks:
        if load_rock(rock, Store()).split == "held-out":
            raise UserError(
                f"rock {rock!r} is held out: it may not be tuned on; `gatetune rocks list` names others"
            )


class CampaignProgress:
    """A line per mission and one bar."""

    def __init__(self, progress: Progress, settings: CampaignSettings) -> None:
        self._progress, self._settings = progress, settings
        self._task = progress.add_task("campaign", total=settings.budget)
        self._in_flight = 0

    def __call__(self, event: CampaignEvent) -> None:
        if event.kind == "launched":
            self._in_flight += 1
        elif event.kind in ("finished", "failed") and event.trial is not None:
            self._in_flight = max(0, self._in_flight - 1)
            self._progress.console.print(self._line(event))
        elif event.kind in ("interrupted", "stopped"):
            self._progress.console.print(f"[yellow]{event.kind}[/]: {event.message}")
        self._progress.update(
            self._task,
            completed=event.finished,
            description=f"{event.finished}/{event.budget}, {self._in_flight} in flight",
        )

    def _line(self, event: CampaignEvent) -> str:
        trial = event.trial
        assert trial is not None
        values = " ".join(f"{path.split('.')[-1]}={_short(value)}" for path, value in trial.values.items())
        if event.kind == "failed":
            outcome = f"[red]failed: {trial.reason}[/] {event.message}"
        else:
            outcome = f"{self._settings.objective.metric.split('.')[-1]} [bold]{trial.raw:6.2f}[/]"
        return f"#{trial.number:03d} {trial.rock:<12} r{trial.replicate} {outcome}  {trial.wall_s:4.0f} s  [dim]{values}[/]"


def _short(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _sources(given: list[str] | None, by_default: tuple[str, ...]) -> tuple[str, ...]:
    """What ``--learn-from`` means."""
    from tuner.campaign.shipped import NOTHING

    if given is None:
        return by_default
    if NOTHING in given:
        if len(given) > 1:
            raise UserError(
                f"--learn-from {NOTHING} stands beside another --learn-from; leave one of them out"
            )
        return ()
    return tuple(given)


def fly(campaign: Campaign, workers: int | None, timeout_s: float) -> None:
    """Run or resume, with live progress, and end in the report."""
    from tuner.campaign.session import fly_campaign
    from tuner.campaign.shipped import SHIPPED
    from tuner.missions.executors import LocalProcessExecutor
    from tuner.report import write_campaign_report

    if workers is not None and workers < 1:
        raise UserError(f"--workers is {workers}; give at least 1")
    count = workers or len(os.sched_getaffinity(0))
    settings = campaign.settings
    output.print(
        f"[bold]{settings.name}[/]: {settings.budget} missions over {', '.join(settings.rocks)}; "
        f"search space {settings.space.name} ({settings.space.dimension} parameters), sampler {settings.sampler}, "
        f"{count} workers"
    )
    if campaign.learned is not None:
        output.print(
            f"learned from {len(campaign.learned.observations)} earlier missions on {', '.join(campaign.learned.rocks)}"
            + (
                " that come with this program (--learn-from nothing begins without)"
                if SHIPPED in settings.learn_from
                else ""
            )
        )
    with (
        LocalProcessExecutor(count, timeout_s, preload=(settings.runner,)) as executor,
        progress_bar() as bar,
    ):
        summary = fly_campaign(campaign, executor, CampaignProgress(bar, settings))
    show_recommendation(summary.recommendation)
    show_front(campaign)
    output.print(
        f"{summary.message}; {seconds(summary.elapsed_s)}, of which the sampler {seconds(summary.ask_s)}"
    )
    if summary.status.finished:
        output.print(f"report: {write_campaign_report(campaign)}")
    if summary.stopped == "interrupted":
        output.print(f"go on with: gatetune campaign resume {campaign.directory}")
        raise typer.Exit(130)
    if summary.stopped == "failing":
        raise typer.Exit(1)


def show_front(campaign: Campaign) -> None:
    """The Pareto front of a campaign with two objectives."""
    from tuner.report.labels import parameter_label

    second, points = campaign.settings.second, campaign.front(save=False)
    if second is None:
        return
    if not points:
        output.print(
            f"no front: no mission has both metrics; mission.json lists {second.metric!r}'s neighbours by name"
        )
        return
    table = Table(title="Configurations flown that no other beats in both (posterior means over the rocks)")
    for metric in (campaign.settings.objective.metric, second.metric):
        table.add_column(metric.split(".")[-1], justify="right", no_wrap=True)
    table.add_column("configuration")
    for p in points:
        values = ", ".join(
            f"{parameter_label(path).short} {_short(value)}" for path, value in p.values.items()
        )
        table.add_row(f"{p.first:.2f} ± {p.first_sd:.2f}", f"{p.second:.1f} ± {p.second_sd:.1f}", values)
    output.print(table)


def show_recommendation(recommendation: Recommendation | None) -> None:
    """The recommended values beside the defaults, and what the difference is worth."""
    if recommendation is None:
        output.print("no recommendation yet: no mission has succeeded")
        return
    table = Table(title="Recommendation (best posterior mean over the training rocks)")
    for column in ("parameter", "paper", "recommended"):
        table.add_column(column, justify="left" if column == "parameter" else "right")
    for path, value in recommendation.values.items():
        table.add_row(path, _short(recommendation.default_values[path]), _short(value))
    table.add_row(recommendation.metric, f"{recommendation.default_mean:.2f} ± {recommendation.default_sd:.2f}",
                  f"{recommendation.mean:.2f} ± {recommendation.sd:.2f}", end_section=True)  # fmt: skip
    output.print(table)
    low, high = recommendation.improvement_interval_95
    output.print(
        f"improvement over the paper's defaults {recommendation.improvement:+.2f} "
        f"(95 % interval {low:+.2f} to {high:+.2f}) on the training rocks, by the surrogate; "
        "`gatetune evaluate` measures it on held-out rocks"
    )
    ahead = recommendation.ahead_of_search
    if ahead is not None:
        output.print(
            f"{100 * ahead['coverage_95']:.0f} % of {ahead['missions']:.0f} missions lay inside the 95 % intervals "
            f"predicted before they were flown; widened as the missions before them taught, "
            f"{100 * ahead['coverage_95_widened']:.0f} %"
        )
