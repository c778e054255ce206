"""A campaign's configuration as the authors' files, with a header that says where it is from."""

from __future__ import annotations

import datetime
from pathlib import Path

from adapters.photogrammetry_nbv import (
    FUNCTION,
    configuration,
    files_beside,
    read_file,
    write_mission,
    write_scoring,
    write_text,
)
from nbv.provenance import git_revision, versions
from tuner.campaign.campaign import Campaign
from tuner.missions.external import ExternalConfig
from tuner.problem.search_space import Configuration, ours
from tuner.recommendation.recommendation import Recommendation

SCORING, MISSION = "scoring.yaml", "unified_mission.yaml"


def authors_file(
    campaign: Campaign,
    config: Configuration,
    name: str,
    best: Recommendation | None,
    onto: Path | None = None,
) -> tuple[str, list[str]]:
    """`SCORING` or `MISSION` of ``config`` as text, and what of it does not transfer.

    Parameters
    ----------
    best
        What the campaign recommends, for the header.
    onto
        A file of this kind whose other keys are kept; None: as published.

    Raises
    ------
    UserError
        The campaign's missions are neither ours nor theirs; ``onto`` cannot be read.
    """
    theirs = read_file(onto, name) if onto is not None else None
    if isinstance(config, ExternalConfig) and config.mission.function == FUNCTION:  # their own mission
        mission = config.mission
        theirs = theirs or files_beside(mission.folder)[name]
        config = configuration(config.values, mission.instances[0].facts.get("set", {}), mission.folder)
    values, remarks = (write_scoring if name == SCORING else write_mission)(ours(config), theirs)
    lost = [str(remark) for remark in remarks]
    lines = [*header(campaign, best), *(f"does not transfer: {text}" for text in lost)]
    return write_text(values, name, "\n".join(lines)), lost


def header(campaign: Campaign, best: Recommendation | None) -> list[str]:
    """Where the numbers are from, and what they were worth."""
    s = campaign.settings
    lines = [
        f"gatetune {versions().get('gatetune', 'unknown')}, revision {git_revision()}, "
        f"{datetime.date.today().isoformat()}",
        f"campaign {s.name}: space {s.space.name}, {len(s.rocks)} rocks, {s.budget} missions, "
        f"fidelity {s.runner}, metric {s.objective.metric}",
    ]
    if best is not None:
        low, high = best.improvement_interval_95
        lines.append(
            f"posterior mean against the default on the training rocks: {best.improvement:+.2f} "
            f"[{low:+.2f}, {high:+.2f}] (95 %)"
        )
    return lines
