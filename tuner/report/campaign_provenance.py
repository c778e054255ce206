"""Where a campaign's numbers come from, and the command that makes them again."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

from nbv.errors import UserError
from nbv.provenance import git_revision, versions
from tuner.campaign.campaign import Campaign
from tuner.campaign.shipped import NOTHING
from tuner.missions.job import RESULT_FILE
from tuner.missions.registry import DEFAULT_RUNNER, RUNNERS
from tuner.report.campaign_facts import CampaignFacts


def provenance_rows(facts: CampaignFacts) -> tuple[list[tuple[str, str]], str]:
    """Rows for the page, and the revision that flew the missions (several are all listed)."""
    trees = _provenance_of_missions(facts.campaign)
    revisions = _revisions(trees)
    software = trees[-1].get("versions", {}) if trees else versions()
    machines = sorted({str(tree["machine"]) for tree in trees if "machine" in tree})
    backends = sorted({str(tree["backend"]) for tree in trees if "backend" in tree})
    hashes = {
        facts.rock_names.get(t.rock, t.rock): str(tree["rock_sha256"])[:12]
        for t, tree in zip([t for t in facts.trials if t.state != "running"], trees)
        if "rock_sha256" in tree
    } if len(trees) == facts.status.finished else {}  # fmt: skip
    times = [t.started for t in facts.trials if t.started], [t.finished for t in facts.trials if t.finished]
    rows = [
        ("flown between", f"{min(times[0]):%Y-%m-%d %H:%M} and {max(times[1]):%Y-%m-%d %H:%M}" if all(times) else "–"),
        ("revision of the missions", ", ".join(revisions) or "not recorded"),
        ("revision of this page", git_revision()),
        ("versions", ", ".join(f"{name} {number}" for name, number in software.items())),
        ("machine", ", ".join(machines) or "not recorded"),
        ("renderer", ", ".join(backends) or "not recorded"),
        ("mission preset", facts.settings.preset),
        ("base configuration", facts.settings.base_config().digest()),
        ("sampler and seed", f"{facts.settings.sampler}, {facts.settings.seed}"),
    ]  # fmt: skip
    if hashes:
        rows.append(
            ("rocks (SHA-256)", ", ".join(f"{name} {digest}…" for name, digest in sorted(hashes.items())))
        )
    return rows, ", ".join(revisions) or git_revision()


def flown_by(campaign: Campaign) -> list[str]:
    """The revisions of this program that flew the campaign's missions."""
    return _revisions(_provenance_of_missions(campaign))


def _provenance_of_missions(campaign: Campaign) -> list[dict[str, Any]]:
    """What each mission that ended recorded of itself, where it did."""
    trees = []
    for t in campaign.trials():
        path = campaign.directory / t.directory / RESULT_FILE
        try:
            tree = json.loads(path.read_text()).get("provenance") or {}
        except (OSError, ValueError, AttributeError):
            continue
        if tree:
            trees.append(tree)
    return trees


def _revisions(trees: Sequence[Mapping[str, Any]]) -> list[str]:
    return sorted({str(tree.get("revision", "unknown")) for tree in trees})


def reproduce_command(campaign: Campaign) -> str:
    """The command line that runs the same campaign again."""
    s = campaign.settings
    words = ["gatetune", "campaign", "run", "--name", s.name, "--space", _space_argument(campaign)]
    for rock in s.rocks:
        words += ["--rock", rock]
    words += ["--replicates", str(s.replicates), "--budget", str(s.budget), "--seed", str(s.seed)]
    words += ["--preset", s.preset, "--metric", s.objective.metric, "--sampler", s.sampler]
    if s.objective.direction == "minimise":
        words.append("--minimise")
    for path, value in s.overrides.items():
        words += ["--set", f"{path}={json.dumps(value)}"]
    # Always said: what a campaign learns from unless told otherwise may change with what comes with the program.
    for source in s.learn_from or (NOTHING,):
        words += ["--learn-from", source]
    return " ".join(shlex.quote(word) for word in [*words, *_optional_words(campaign)])


def _optional_words(campaign: Campaign) -> list[str]:
    """What of the settings is not a campaign's default."""
    s, words = campaign.settings, []
    with_values = {
        "--keep": s.keep if s.keep != "summary" else None, "--in-step": s.in_step,
        "--fidelity": s.runner if s.runner in RUNNERS and s.runner != DEFAULT_RUNNER else None,
        "--risk": s.risk if s.risk != "mean" else None,
        "--second-metric": s.second.metric if s.second is not None else None,
    }  # fmt: skip
    for option, value in with_values.items():
        if value is not None:
            words += [option, str(value)]
    flags = {
        "--second-minimise": s.second is not None and s.second.direction == "minimise",
    }  # fmt: skip
    return [*words, *(option for option, wanted in flags.items() if wanted)]


def _space_argument(campaign: Campaign) -> str:
    from tuner.problem.search_space import load_search_space

    space = campaign.settings.space
    try:
        if load_search_space(space.name).to_dict() == space.to_dict():
            return space.name
    except UserError:
        pass
    return f"{space.name}.yaml"


def command_note(campaign: Campaign) -> str:
    """What the reader of `reproduce_command` must know besides."""
    s, notes = campaign.settings, []
    if _space_argument(campaign).endswith(".yaml"):
        notes.append(
            f"Save the section “search_space” of the settings below as {_space_argument(campaign)} first."
        )
    if s.runner not in RUNNERS:
        notes.append(f"Missions were flown by {s.runner}, which the command line cannot name.")
    if s.in_step is None:
        notes.append(
            "With one worker the sequence of proposals repeats exactly; with more it depends on which mission ends "
            "first, unless the campaign is run --in-step."
        )
    return " ".join(notes)
