"""A campaign on the terminal: its progress, its recommendation."""

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
    from tuner.recommendation.recommendation import Recommendation


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
            self._best = f", best {best_text(event.recommendation)}"
        self.counts = self._counted(event, self._began)
        self.reached(event.finished, event.budget)

    def _counted(self, event: CampaignEvent, began: int) -> str:
        flown, left = event.finished - began, event.budget - event.finished
        rest = f", {seconds(event.elapsed_s / flown * left)} left" if flown and left else ""
        failed = f", {self._failed} failed" if self._failed else ""
        return f"{event.finished}/{event.budget}{failed}{rest}{self._best}"


def best_text(found: Recommendation) -> str:
    """``26`` where the configuration decides it, else ``98.3 (97.8 to 98.8)``."""
    if found.exact:
        return f"{found.mean:g}"
    low, high = found.interval_95
    return f"{found.mean:.1f} ({low:.1f} to {high:.1f})"


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
        outcome = f"{trial.raw:7.{0 if settings.exact.first else 2}f}{also}{mark} {trial.wall_s:4.0f} s  {' '.join(changed) or 'the default'}"
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
        fields["recommendation"] = {"keep_default": best.keep_default, **best.to_dict()}
    return json.dumps(json_ready(fields))


def echo_event(event: CampaignEvent) -> None:
    """Print `event_line`."""
    typer.echo(event_line(event))


def show_counts(facts: CampaignStatus, place: str) -> None:
    """Missions, failures and costs so far; ``place``: what missions are flown on."""
    output.print(
        f"{facts.name}: {facts.finished} of {facts.budget} missions "
        f"({facts.failed} failed, {facts.running} open); "
        f"{seconds(facts.mission_wall_s)} of computing"
    )
    output.print(
        f"missions per {place}: " + ", ".join(f"{rock} {count}" for rock, count in facts.per_rock.items())
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


def show_recommendation(recommendation: Recommendation | None, settings: CampaignSettings) -> None:
    """The answer, the values beside the defaults, rock by rock."""
    if recommendation is None:
        output.print("no recommendation yet: no mission has succeeded")
    else:
        show_verdict(recommendation, settings)
        _show_values(recommendation, settings)


def show_verdict(recommendation: Recommendation, settings: CampaignSettings) -> None:
    """What to use, and what that is worth."""
    from tuner.report.answer import use_sentence, worth_sentences  # loads every metric

    for line in (use_sentence(recommendation, settings), *worth_sentences(recommendation, settings)):
        output.print(line, highlight=False)


def _show_values(recommendation: Recommendation, settings: CampaignSettings) -> None:
    from tuner.report.answer import default_note, place_word, runner_up_sentence
    from tuner.report.labels import decimals_for, format_number, metric_label

    table = Table()
    for column in ("parameter", "default", "recommended"):
        table.add_column(column, justify="left" if column == "parameter" else "right")
    for path, value in recommendation.values.items():
        table.add_row(path, _short(recommendation.default_values[path]), _short(value))
    output.print(table)
    label, place = metric_label(recommendation.modelled_metric), place_word(settings)
    digits = decimals_for(recommendation.noise_sd)
    rows = [
        f"{row.world.label} {format_number(label.possible(row.predicted), digits)}"
        + ("" if row.observed is None else f" (measured {format_number(row.observed, digits)})")
        for row in recommendation.per_rock
    ]
    output.print(f"{label.axis}, {place} by {place}: {', '.join(rows)}", highlight=False)
    for line in filter(None, (runner_up_sentence(recommendation, settings), default_note(settings))):
        output.print(line, highlight=False)
