"""Where a campaign's numbers come from, and the command that makes them again."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from typing import Any

from nbv.errors import UserError
from nbv.provenance import git_revision, versions
from nbv.safe_files import RESULT_BYTES, RESULT_NODES, read_json
from tuner.campaign.campaign import Campaign
from tuner.campaign.settings_file import SETTINGS_FILE
from tuner.missions.job import RESULT_FILE
from tuner.report.answer import place_word
from tuner.report.campaign.facts import CampaignFacts

MOST_READ = 200  # missions whose documents are read


def provenance_rows(facts: CampaignFacts) -> tuple[list[tuple[str, str]], str]:
    """Rows for the page, and the revision that flew the missions (several are all listed)."""
    trees = _provenance_of_missions(facts.campaign)
    revisions = _revisions(trees)
    software = trees[-1].get("versions", {}) if trees else versions()
    machines = sorted({str(tree["machine"]) for tree in trees if "machine" in tree})
    backends = sorted({str(tree["backend"]) for tree in trees if "backend" in tree})
    hashes = {facts.rock_names.get(t.rock, t.rock): t.rock_sha256[:12] for t in facts.trials if t.rock_sha256}
    times = [t.started for t in facts.trials if t.started], [t.finished for t in facts.trials if t.finished]
    rows = [
        (
            "flown between",
            f"{min(times[0]):%Y-%m-%d %H:%M} and {max(times[1]):%Y-%m-%d %H:%M}" if all(times) else "–",
        ),
        ("revision of the missions", ", ".join(revisions) or "not recorded"),
        ("revision of this page", git_revision()),
        ("versions", ", ".join(f"{name} {number}" for name, number in software.items())),
        ("machine", ", ".join(machines) or "not recorded"),
        ("renderer", ", ".join(backends) or "not recorded"),
        ("mission preset", facts.settings.preset)
        if facts.settings.mission is None
        else (
            "mission file",
            f"{facts.settings.mission.path} (SHA-256 {facts.settings.mission.sha256[:12]}…)",
        ),
        ("conditions", ", ".join(condition.name for condition in facts.settings.conditions)),
        ("base configuration", facts.settings.base_config().digest()),
        ("sampler and seed", f"{facts.settings.sampler}, {facts.settings.seed}"),
    ]
    if hashes:
        rows.append(
            (
                f"{place_word(facts.settings)}s (SHA-256)",
                ", ".join(f"{name} {digest}…" for name, digest in sorted(hashes.items())),
            )
        )
    return rows, ", ".join(revisions) or git_revision()


def flown_by(campaign: Campaign) -> list[str]:
    """The revisions of this program that flew the campaign's missions."""
    return _revisions(_provenance_of_missions(campaign))


def _provenance_of_missions(campaign: Campaign) -> list[dict[str, Any]]:
    """What missions that ended recorded of themselves, where they did: of many every few."""
    trees, trials = [], campaign.trials()
    for t in trials[:: -(-len(trials) // MOST_READ) or 1]:
        path = campaign.directory / t.directory / RESULT_FILE
        try:
            tree = read_json(path, RESULT_BYTES, RESULT_NODES).get("provenance") or {}
        except (UserError, AttributeError):
            continue
        if tree:
            trees.append(tree)
    return trees


def _revisions(trees: Sequence[Mapping[str, Any]]) -> list[str]:
    return sorted({str(tree.get("revision", "unknown")) for tree in trees})


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
