"""A campaign on the terminal: its progress, its recommendation."""

from __future__ import annotations

import json
from typing import Any

from nbv.config import IDEAL
from nbv.safe_files import json_ready
from tuner.answer.answer import ANSWER_FILE, Answer, answer_of
from tuner.campaign.campaign import Campaign, CampaignEvent, CampaignStatus
from tuner.campaign.settings import CampaignSettings
from tuner.commands.console import MissionProgress, output
from tuner.missions.registry import mission_kind
from tuner.problem.goal import COUNTS
from tuner.report import words
from tuner.report.labels import counted, duration, number_text

LINE = 80  # columns of a mission's line


class CampaignProgress(MissionProgress):
    """A line per mission and one bar: how far, what failed, what runs now."""

    def __init__(self, settings: CampaignSettings) -> None:
        super().__init__(settings.budget)
        self._settings = settings
        self._failed = 0

    def __call__(self, event: CampaignEvent) -> None:
        trial = event.trial
        if trial is not None and event.kind == "launched":
            self.launched(
                str(trial.number), f"{trial.instance.label} r{trial.replicate}", trial.record.directory
            )
        elif trial is not None and event.kind in ("finished", "failed", "lost"):
            self._failed += event.kind == "failed"
            self.ended(str(trial.number), mission_line(event, self._settings))
        elif event.kind in ("interrupted", "stopped"):
            output.print(f"{event.kind}: {event.message}", style="yellow")
        failed = f", {self._failed} failed" if self._failed else ""
        counts = f"{event.finished}/{event.budget}{failed}"
        self.reached(event.finished, event.budget, counts)


def expected_s(campaign: Campaign, workers: int) -> float:
    """Expected duration of the remaining missions, from those so far or else from a quiet machine; 0 if unknown."""
    s, status, one_s = campaign.settings, campaign.status(), 0.0
    if ended := status.complete + status.failed:
        one_s = status.mission_wall_s / ended
    elif (seconds := mission_kind(s.fidelity).seconds) is not None:
        one_s = seconds(s.problem.config(s.problem.default))
    return one_s * status.remaining / max(1, workers)


def expected_text(missions: int, about_s: float) -> str:
    """``36 missions to run, in about 4 min 14 s``; before anything runs."""
    to_run = f"{counted(missions, 'mission')} to run"
    if not about_s:
        return f"{to_run}; their duration is known when the first has ended"
    return f"{to_run}, in about {duration(about_s)} where nothing else runs"


def mission_line(event: CampaignEvent, settings: CampaignSettings) -> str:
    """One mission in at most `LINE` columns: ``#0012 slab r1  94.57  13 s  proposal``."""
    trial = event.trial
    assert trial is not None
    if event.kind == "lost":
        outcome = f"lost: {event.message.removeprefix('machine_error: ').removeprefix('no_result: ')}"
    elif event.kind == "failed":
        outcome = f"failed: {trial.reason} {event.message}"
    else:
        mark = " degraded" if trial.record.status == "degraded" else ""
        second = trial.measured(settings.second) if settings.second else None
        also = f" at {number_text(second)}" if second is not None else ""
        raw = trial.raw or 0.0
        value = f"{f'{raw:g}' if settings.objective.metric in COUNTS else number_text(raw):>7}{also}{mark}"
        outcome = f"{value} {trial.record.wall_s:4.0f} s  {trial.record.metadata.get('phase', '')}"
    line = f"#{trial.number:04d} {trial.instance.label:<12} r{trial.replicate} {' '.join(outcome.split(chr(10)))}"
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
        fields["mission"] = t.number
        for name in ("rock", "condition", "replicate", "values", "reason"):
            fields[name] = getattr(t, name)
        for name in ("status", "wall_s", "directory"):
            fields[name] = getattr(t.record, name)
        fields["value"] = t.raw
    if (best := event.recommendation) is not None:
        fields["recommendation"] = {"keep_default": best.keep_default, **best.to_dict()}
    return json.dumps(json_ready(fields))


def show_counts(facts: CampaignStatus) -> None:
    """Missions, failures and costs so far."""
    output.print(
        f"{facts.name}: {facts.finished} of {facts.budget} missions "
        f"({facts.failed} failed, {facts.running} open); "
        f"{duration(facts.mission_wall_s)} of computing"
    )
    if facts.repeats:
        repeats = counted(facts.repeats, "more trial")
        output.print(f"{repeats} took the photographs of an earlier mission and used no budget")
    if facts.exhausted:
        output.print(f"the search has ended: {facts.exhausted}")
    parts = {"rock": facts.per_rock}
    if list(facts.per_condition) != [IDEAL]:
        parts["condition"] = facts.per_condition
    for what, counts in parts.items():
        named = ", ".join(f"{name} {count}" for name, count in counts.items())
        output.print(f"missions per {what}: {named}")
    for reason, count in facts.failures.items():
        output.print(f"  failed {count} times: {reason}")


def show_answer(campaign: Campaign, *, save: bool = True) -> Answer:
    """Print the answer from everything in the run directory, in a screen: what to fly, the table, what was tuned, what next.

    ``save``: as ``answer.json``, too.
    """
    answer = answer_of(campaign)
    for sentence in words.sentences(answer):
        output.print(sentence, style="bold", highlight=False)
    if answer.tables:
        fly, narrow = "" if answer.fly is None else answer.fly.strategy, output.width < 100
        output.print(*words.table_lines(answer.tables[0], answer.metric, fly, narrow=narrow).for_terminal())
    if answer.recommended:
        output.print(*words.values_table(answer).for_terminal())
        for names, gate in words.alike({name: gate for name, gate in answer.gates.items() if gate.views}):
            output.print(words.gate_sentence(names, gate), highlight=False)
        output.print(words.legend(answer.tables), style="dim")
    output.print(words.chosen_text(answer.chosen_by), highlight=False)
    output.print(f"What next: {answer.next.why}", highlight=False)
    if answer.next.command:
        output.print(answer.next.command, highlight=False, soft_wrap=True)
    if save:
        try:
            answer.save(campaign)
        except OSError as error:  # of a campaign that may only be read
            output.print(f"{ANSWER_FILE} stays as it was: {error.strerror}", highlight=False, soft_wrap=True)
    return answer
