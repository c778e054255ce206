"""Where a campaign's numbers come from, and the command that makes them again."""

from __future__ import annotations

import shlex

from tuner.campaign.campaign import Campaign
from tuner.campaign.settings_file import SETTINGS_FILE
from tuner.report.answer import place_word
from tuner.report.campaign.facts import CampaignFacts
from tuner.report.pages import recorded, recorded_rows


def provenance_rows(facts: CampaignFacts) -> list[tuple[str, str]]:
    """Rows for the page: when, by what, with which settings, on which rocks."""
    s, directory = facts.settings, facts.campaign.directory
    hashes = {facts.rock_names.get(t.rock, t.rock): t.rock_sha256[:12] for t in facts.trials if t.rock_sha256}
    times = [t.started for t in facts.trials if t.started], [t.finished for t in facts.trials if t.finished]
    between = f"{min(times[0]):%Y-%m-%d %H:%M} and {max(times[1]):%Y-%m-%d %H:%M}" if all(times) else "–"
    return [
        ("flown between", between),
        *recorded_rows(recorded([directory / t.directory for t in facts.trials])),
        ("mission preset", s.preset)
        if s.mission is None
        else ("mission file", f"{s.mission.path} (SHA-256 {s.mission.sha256[:12]}…)"),
        ("conditions", ", ".join(condition.name for condition in s.conditions)),
        ("base configuration", s.base_config().digest()),
        ("sampler and seed", f"{s.sampler}, {s.seed}"),
        (
            f"{place_word(s)}s (SHA-256)",
            ", ".join(f"{name} {digest}…" for name, digest in sorted(hashes.items())) or "not recorded",
        ),
    ]


def reproduce_command(campaign: Campaign) -> str:
    """The command line that runs the same campaign again, in a directory beside it."""
    beside = campaign.directory.with_name(f"{campaign.directory.name}-again")
    words = ["gatetune", "campaign", "run", str(campaign.directory / SETTINGS_FILE), "--out", str(beside)]
    if campaign.settings.mission is not None:
        words += ["--mission", str(campaign.settings.mission.path)]
    return shlex.join(words)


def command_note(campaign: Campaign) -> str:
    """What the reader of `reproduce_command` must know besides."""
    notes = [f"Without this run directory: save the settings below as {SETTINGS_FILE} and name that file."]
    if campaign.settings.in_step is None:
        notes.append(
            "With one worker the sequence of proposals repeats exactly; with more it depends on which mission ends "
            "first, unless the settings have `in_step`."
        )
    return " ".join(notes)
