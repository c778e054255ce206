"""A campaign on the terminal: its progress, its recommendation, its front."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import typer
from rich.table import Table

from nbv.config import IDEAL
from nbv.mission.result import json_ready
from tuner.commands.console import FlightProgress, output, seconds

if TYPE_CHECKING:
    from pathlib import Path

    from rich.progress import Progress

    from tuner.campaign.events import CampaignEvent, CampaignStatus
    from tuner.campaign.settings import CampaignSettings
    from tuner.recommendation.recommendation import NextRock, Recommendation


LINE = 80  # columns of a mission's line
_INITIALS = {"covis": "C", "b_aware": "B", "matchable": "M"}  # whose weight it is


class CampaignProgress(FlightProgress):
    """A line per mission and one bar: how far, what failed, what is left, the best so far, what flies now."""

    def __init__(self, progress: Progress, settings: CampaignSettings, directory: Path) -> None:
        super().__init__(progress, settings.budget)
        self._settings, self._directory = settings, directory
        self._began: int | None = None  # missions finished in earlier sessions
        self._failed = 0
        self._best = ""
        self.counts = f"0/{settings.budget}"

    def __call__(self, event: CampaignEvent) -> None:
        trial = event.trial
        if self._began is None:
            self._began = event.finished
        if trial is not None and event.kind == "launched":
            label = f"{trial.world.label} r{trial.replicate}"
            self.took_off(str(trial.number), label, self._directory / trial.directory)
        elif trial is not None and event.kind in ("finished", "failed", "lost"):
            self.landed(str(trial.number))
            self._failed += event.kind == "failed"
            self.say(mission_line(event, self._settings))
        elif event.kind in ("interrupted", "stopped"):
            self.progress.console.print(f"{event.kind}: {event.message}", style="yellow")
        elif event.kind == "recommendation" and event.recommendation is not None:
            low, high = event.recommendation.interval_95
            self._best = f", best {event.recommendation.mean:.1f} ({low:.1f} to {high:.1f})"
        self.counts = self._counted(event, self._began)
        self.reached(event.finished, event.budget)

    def _counted(self, event: CampaignEvent, began: int) -> str:
        flown, left = event.finished - began, event.budget - event.finished
        rest = f", {seconds(event.elapsed_s / flown * left)} left" if flown and left else ""
        failed = f", {self._failed} failed" if self._failed else ""
        return f"{event.finished}/{event.budget}{failed}{rest}{self._best}"


def mission_line(event: CampaignEvent, settings: CampaignSettings) -> str:
    """One mission in at most `LINE` columns: ``#012 slab r1  94.57  13 s  C.nov 1.2 B.nov 0.4 …``."""
    trial = event.trial
    assert trial is not None
    if event.kind == "lost":
        outcome = f"lost: {event.message.removeprefix('machine_error: ').removeprefix('no_result: ')}"
    elif event.kind == "failed":
        outcome = f"failed: {trial.reason} {event.message}"
    else:
        mark = " degraded" if trial.status == "degraded" else ""
        default = settings.default_values()
        changed = [
            f"{_initial(path)} {_short(value)}"
            for path, value in trial.values.items()
            if value != default.get(path)
        ]
        second = trial.measured(settings.second) if settings.second else None
        also = f" at {second:.1f}" if second is not None else ""
        outcome = f"{trial.raw:7.2f}{also}{mark} {trial.wall_s:4.0f} s  {' '.join(changed) or 'the default'}"
    line = f"#{trial.number + 1:03d} {trial.world.label:<12} r{trial.replicate} {' '.join(outcome.split(chr(10)))}"
    return line if len(line) <= LINE else f"{line[: LINE - 1]}…"


def event_line(event: CampaignEvent) -> str:
    """The event as one JSON object, for scripts."""
    fields: dict[str, Any] = {
        "event": event.kind,
        "elapsed_s": round(event.elapsed_s, 3),
        "finished": event.finished,
        "budget": event.budget,
    }
    if event.message:
        fields["message"] = event.message
    if (t := event.trial) is not None:
        fields |= {
            "mission": t.number + 1,
            "rock": t.rock,
            "condition": t.condition,
            "replicate": t.replicate,
        }
        fields |= {"values": t.values, "value": t.raw, "status": t.status, "reason": t.reason}
        fields |= {"wall_s": t.wall_s, "directory": t.directory}
    if (best := event.recommendation) is not None:
        fields["recommendation"] = {
            "values": best.values,
            "mean": best.mean,
            "interval_95": best.interval_95,
            "improvement": best.improvement,
            "improvement_interval_95": best.improvement_interval_95,
        }
    return json.dumps(json_ready(fields))


def echo_event(event: CampaignEvent) -> None:
    """Print `event_line`."""
    typer.echo(event_line(event))


def show_counts(facts: CampaignStatus) -> None:
    """Missions, failures and costs so far."""
    output.print(
        f"{facts.name}: {facts.finished} of {facts.budget} missions "
        f"({facts.failed} failed, {facts.running} open); "
        f"{seconds(facts.mission_wall_s)} of computing"
        + (f", {seconds(facts.flight_time_s)} of simulated flight" if facts.flight_time_s else "")
    )
    output.print(
        "missions per rock: " + ", ".join(f"{rock} {count}" for rock, count in facts.per_rock.items())
    )
    if list(facts.per_condition) != [IDEAL]:
        output.print(
            "missions per condition: "
            + ", ".join(f"{name} {count}" for name, count in facts.per_condition.items())
        )
    for reason, count in facts.failures.items():
        output.print(f"  failed {count} times: {reason}")


def _initial(path: str) -> str:
    section, _, rest = path.partition(".")
    name = rest.rpartition(".")[2] or path
    return f"{_INITIALS[section]}.{name}" if section in _INITIALS else name


def _short(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _show_front(recommendation: Recommendation | None, settings: CampaignSettings) -> None:
    """The Pareto front of a campaign with two objectives."""
    second, points = settings.second, [] if recommendation is None else recommendation.front
    if second is None or settings.limit is not None:
        return
    from tuner.report.labels import parameter_label  # half a second to load, with every metric

    if not points:
        output.print(
            f"no front: no mission has both metrics; mission.json lists {second.metric!r}'s neighbours by name"
        )
        return
    table = Table(title="Configurations flown that no other beats in both (posterior means over the rocks)")
    for metric in (settings.objective.metric, second.metric):
        table.add_column(metric.split(".")[-1], justify="right", no_wrap=True)
    table.add_column("configuration")
    for p in points:
        values = ", ".join(
            f"{parameter_label(path).short} {_short(value)}" for path, value in p.values.items()
        )
        table.add_row(f"{p.first:.2f} ± {p.first_sd:.2f}", f"{p.second:.1f} ± {p.second_sd:.1f}", values)
    output.print(table)


def use_text(found: Recommendation, whose: str = "paper's ") -> str:
    """``use: pool.max_altitude_m 1.45 (the other 8 stay at the paper's values)``."""
    if found.keep_default:
        return f"use: the {whose}defaults; nothing flown is known to be worth more"
    values = ", ".join(f"{path} {_short(found.values[path])}" for path in found.changed)
    rest = len(found.values) - len(found.changed)
    others = "the other stays" if rest == 1 else f"the other {rest} stay"
    return f"use: {values}" + (f" ({others} at the {whose or 'default '}values)" if rest else "")


def next_rock_lines(found: NextRock) -> list[str]:
    """The gain on a rock nobody has flown, and what is known of how rocks differ."""
    low, high = found.interval_95
    gain = f"on a rock nobody has flown: {found.gain:+.2f} (95 % interval {low:+.2f} to {high:+.2f})"
    return [gain, *found.warnings()]


def show_recommendation(recommendation: Recommendation | None, settings: CampaignSettings) -> None:
    """The verdict and what to use, the values beside the defaults, and the front of two objectives."""
    if recommendation is None:
        output.print("no recommendation yet: no mission has succeeded")
    else:
        _show_values(recommendation, settings)
    _show_front(recommendation, settings)


def _show_values(recommendation: Recommendation, settings: CampaignSettings) -> None:
    show_verdict(recommendation, settings)
    table = Table(
        title="Recommendation (fewest changes that are not worse than the best, of what has flown often enough)"
    )
    for column in ("parameter", "paper" if settings.mission is None else "default", "recommended"):
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
    if recommendation.limit is not None:
        from tuner.report.campaign.answers import limit_text  # a second to load, with what draws

        output.print(limit_text(recommendation.limit))
    if recommendation.next_rock is not None:
        for line in next_rock_lines(recommendation.next_rock):
            output.print(line)
    for why in dict.fromkeys(silent.values()):
        output.print(f"no effect: {', '.join(p for p in silent if silent[p] == why)}: {why}")
    found = recommendation.calibration
    if found["coverage_95"] is not None:
        output.print(
            f"{100 * found['coverage_95']:.0f} % of {found['missions']:.0f} missions lay inside the 95 % intervals "
            "predicted before they were flown; the intervals above are wider by what that taught (calibrated)"
        )


def show_verdict(recommendation: Recommendation, settings: CampaignSettings) -> None:
    """What the recommendation is worth against the default, and what of it to use."""
    from tuner.missions.registry import is_geometric

    low, high = recommendation.improvement_interval_95
    whose = "paper's " if settings.mission is None else ""
    by = "predicted by the low-fidelity simulator" if is_geometric(settings.fidelity) else "by the surrogate"
    where = "the worst of the training rocks" if settings.risk == "worst" else "the training rocks"
    where += "" if settings.mission is None else " (instances of the mission file)"
    saved = ""
    if recommendation.metric.startswith("costs."):
        from tuner.report.labels import metric_label

        name = metric_label(recommendation.metric).axis
        saved = f"{name}: {recommendation.mean:.1f} in place of {recommendation.default_mean:.1f}; "
    output.print(
        f"{saved}improvement over the {whose}defaults {recommendation.improvement:+.2f} "
        f"(calibrated 95 % interval {low:+.2f} to {high:+.2f}) on {where}, {by}; "
        "`gatetune evaluate` measures it on held-out rocks"
    )
    output.print(use_text(recommendation, whose))
