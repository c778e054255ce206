"""A campaign on the terminal: its progress, its recommendation, its front."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.markup import escape
from rich.table import Table

from tuner.commands.console import output

if TYPE_CHECKING:
    from rich.progress import Progress

    from tuner.campaign.campaign import Campaign
    from tuner.campaign.events import CampaignEvent
    from tuner.campaign.settings import CampaignSettings
    from tuner.recommendation.recommendation import Recommendation
    from tuner.recommendation.sparsest import Sparsest


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
            self._progress.console.print(self._line(event), markup=True)
        elif event.kind == "lost" and event.trial is not None:
            self._in_flight = max(0, self._in_flight - 1)
            self._progress.console.print(
                f"#{event.trial.number:03d} {event.trial.rock} lost: {event.message}"
            )
        elif event.kind in ("interrupted", "stopped"):
            self._progress.console.print(f"{event.kind}: {event.message}", style="yellow")
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
            outcome = f"[red]failed: {escape(trial.reason)}[/] {escape(event.message)}"
        else:
            outcome = f"{self._settings.objective.metric.split('.')[-1]} [bold]{trial.raw:6.2f}[/]"
        return f"#{trial.number:03d} {escape(trial.world.label):<12} r{trial.replicate} {outcome}  {trial.wall_s:4.0f} s  [dim]{escape(values)}[/]"


def _short(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


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


def sparsest_text(found: Sparsest, whose: str = "paper's ") -> str:
    """``use: pool.max_altitude_m 1.45 (the other 8 go back to the paper's values)``, and what that costs."""
    low, high = found.difference_interval_95
    costs = (
        f"against the recommendation {found.difference:+.2f} ({low:+.2f} to {high:+.2f}), by the surrogate"
    )
    if not found.kept:
        return f"use: the {whose}defaults; nothing tuned is known to be worth more ({costs})"
    values = ", ".join(f"{path} {_short(found.values[path])}" for path in found.kept)
    rest = len(found.values) - len(found.kept)
    back = (
        f" (the other {rest} go back to the {whose}values; {costs})" if rest else " (all of them are needed)"
    )
    return f"use: {values}{back}"


def show_recommendation(recommendation: Recommendation | None, *, of_paper: bool = True) -> None:
    """The recommended values beside the defaults, and what the difference is worth."""
    if recommendation is None:
        output.print("no recommendation yet: no mission has succeeded")
        return
    table = Table(title="Recommendation (best posterior mean among what has flown often enough)")
    for column in ("parameter", "paper" if of_paper else "default", "recommended"):
        table.add_column(column, justify="left" if column == "parameter" else "right")
    silent = {found.path: found.why for found in recommendation.inactive}
    for path, value in recommendation.values.items():
        shown = "no effect" if path in silent else _short(value)
        table.add_row(path, _short(recommendation.default_values[path]), shown)
    table.add_row(
        recommendation.metric,
        f"{recommendation.default_mean:.2f} ± {recommendation.default_sd:.2f}",
        f"{recommendation.mean:.2f} ± {recommendation.sd:.2f}",
        end_section=True,
    )
    output.print(table)
    low, high = recommendation.improvement_interval_95
    whose = "paper's " if of_paper else ""
    output.print(
        f"improvement over the {whose}defaults {recommendation.improvement:+.2f} "
        f"(calibrated 95 % interval {low:+.2f} to {high:+.2f}) on the training rocks, by the surrogate; "
        "`gatetune evaluate` measures it on held-out rocks"
    )
    for why in dict.fromkeys(silent.values()):
        output.print(f"no effect: {', '.join(p for p in silent if silent[p] == why)}: {why}")
    if recommendation.sparsest is not None:
        output.print(sparsest_text(recommendation.sparsest, whose))
    found = recommendation.calibration
    if found["coverage_95"] is not None:
        output.print(
            f"{100 * found['coverage_95']:.0f} % of {found['missions']:.0f} missions lay inside the 95 % intervals "
            "predicted before they were flown; the intervals above are wider by what that taught (calibrated)"
        )
