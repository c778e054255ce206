"""The three jobs from Python: what the commands do, with values instead of printed lines.

They run in processes of their own, so a script needs no ``if __name__ == "__main__"``.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from nbv.config import load_conditions, preset
from nbv.errors import UserError
from tuner.answer.answer import answer_of
from tuner.campaign.begin import begin_campaign
from tuner.campaign.campaign import Campaign, CampaignEvent, CampaignSummary
from tuner.campaign.session import run_campaign
from tuner.campaign.settings_file import SETTINGS_FILE, resolved_settings, settings_there
from tuner.comparison.of_campaign import (
    PlannedComparison,
    end_of_campaign,
    held_out,
    reproduction,
    require_comparable,
)
from tuner.comparison.plan import EvaluationEvent, EvaluationRun
from tuner.missions.pool import Executor, local_pool
from tuner.problem.baselines import REPRODUCTION_STRATEGIES

__all__ = ["evaluate", "reproduce", "tune"]


def tune(
    directory: str | Path,
    *,
    workers: int | None = None,
    timeout_s: float = 3600.0,
    on_event: Callable[[CampaignEvent], None] | None = None,
    **settings: Any,
) -> Campaign:
    """Job 1: run a campaign in ``directory``, or go on with the one that is there; then its comparison, where it asks for one.

    Parameters
    ----------
    workers
        Missions side by side; by default one per core.
    timeout_s
        A mission that takes longer is killed.
    on_event
        Called with everything that happens, in this process.
    settings
        A campaign's settings by name, as a settings file has them (docs/reference/commands.md). What is left out has
        the command's default, the name the directory's; of a campaign that is there already it is its own, and what is given
        must be that.

    Raises
    ------
    UserError
        A setting is wrong, or the directory holds something else.
    """
    where = Path(directory)
    given = {name: list(v) if isinstance(v, tuple) else v for name, v in settings.items() if v is not None}
    if (where / SETTINGS_FILE).is_file():
        campaign = Campaign.open(where, settings_there(where, given))
    else:
        resolved = resolved_settings({"name": where.resolve().name, **given}, "tune()")
        require_comparable(resolved)
        campaign = begin_campaign(where, resolved)
    with local_pool(campaign.settings.fidelity, workers, timeout_s) as executor:
        run_to_end(campaign, executor, on_event)
    _write_answer(campaign)
    return campaign


def _write_answer(campaign: Campaign) -> None:
    """Write ``answer.json`` and ``report.html``, as the commands do; a campaign that may only be read stays as it was."""
    from tuner.report.campaign_page import write_campaign_report  # noqa: PLC0415  loads torch

    with contextlib.suppress(OSError, UserError):
        answer = answer_of(campaign)
        answer.save(campaign)
        write_campaign_report(campaign, answer)


def run_to_end(
    campaign: Campaign,
    executor: Executor,
    on_event: Callable[[CampaignEvent], None] | None = None,
    *,
    searched: Callable[[CampaignSummary], None] | None = None,
    compare: Callable[[PlannedComparison], object] | None = None,
    accept_changes: bool = False,
) -> CampaignSummary:
    """`run_campaign`, then the comparison that the campaign asks for: what `tune` and the command do.

    ``searched`` is called between the two; ``compare`` runs the comparison, by default without showing anything.
    """
    summary = run_campaign(campaign, executor, on_event, accept_changes=accept_changes)
    if searched is not None:
        searched(summary)
    if summary.found and (planned := end_of_campaign(campaign)) is not None:
        planned.run(executor) if compare is None else compare(planned)
    return summary


def evaluate(
    campaign: Campaign | str | Path,
    *,
    rocks: Sequence[str] | None = None,
    replicates: int = 3,
    strategies: Sequence[str] | None = None,
    conditions: Sequence[str] | None = None,
    fidelity: str = "photogrammetric",
    directory: str | Path | None = None,
    workers: int | None = None,
    timeout_s: float = 3600.0,
    on_event: Callable[[EvaluationEvent], None] | None = None,
) -> EvaluationRun:
    """Job 2: the tuned configurations and the baselines on rocks that the campaign has not seen; its answer is written anew.

    Parameters
    ----------
    rocks
        By default `Campaign.held_out`.
    strategies
        The baselines, by default the command's; at the recommendation's number of photographs, and the default's own plan
        beside them.
    conditions
        Names or files; by default the campaign's.
    directory
        By default ``evaluation`` in the campaign's; missions that are there are not run again.

    Raises
    ------
    UserError
        The campaign has no recommendation, or was tuned on one of the rocks.
    """
    if not isinstance(campaign, Campaign):
        campaign = Campaign.open(Path(campaign), read_only=True)
    comparison = held_out(
        campaign,
        rocks=rocks,
        replicates=replicates,
        strategies=strategies,
        conditions=load_conditions(conditions) if conditions else None,
        fidelity=fidelity,
    )
    with local_pool(fidelity, workers, timeout_s) as executor:
        evaluated = comparison.run(executor, on_event, out=None if directory is None else Path(directory))
    _write_answer(campaign)
    return evaluated


def reproduce(
    directory: str | Path,
    *,
    rocks: Sequence[str] = ("vesicular",),
    preset_name: str = "paper",
    strategies: Sequence[str] = REPRODUCTION_STRATEGIES,
    replicates: int = 1,
    overrides: dict[str, Any] | None = None,
    fidelity: str = "photogrammetric",
    workers: int | None = None,
    timeout_s: float = 7200.0,
) -> EvaluationRun:
    """Job 3: the paper's configuration for its strategies.

    Parameters
    ----------
    rocks
        Catalogue names or mesh files.
    overrides
        Values by parameter path, laid over the preset.

    Raises
    ------
    UserError
        Something is unknown, or the directory holds another plan.
    """
    base = preset(preset_name).with_values(overrides or {})
    comparison = reproduction(base, rocks, strategies=strategies, replicates=replicates, fidelity=fidelity)
    with local_pool(fidelity, workers, timeout_s) as executor:
        return comparison.run(executor, out=Path(directory))
