"""A campaign as its run directory holds it: what was asked for, what has run, what is recommended.

A trial is one mission: one configuration on one instance (a rock under a condition) with one replicate. Instances are taken
in turn, and missions share replicate numbers, so that configurations are compared on common (instance, replicate) pairs. The
run directory::

    campaign.yaml          what was asked for; a resume must agree with it
    study.journal          the ledger
    missions/NNNN_ROCK_rK  one directory per mission (NNNN_ROCK_CONDITION_rK where that is not ideal)
    recommendation.json    the current recommendation
    learned_from.json      the missions of earlier campaigns, where some were named
"""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import functools
import json
import math
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nbv.errors import UserError
from nbv.safe_files import RESULT_BYTES, read_json, read_text, write_atomic
from tuner.campaign.events import CampaignStatus
from tuner.campaign.settings import CampaignSettings
from tuner.campaign.settings_file import (
    SETTINGS_FILE,
    first_difference,
    read_settings,
    settings_from_dict,
    with_mission_file,
)
from tuner.missions.job import MissionJob, Trial, repeated
from tuner.missions.long_runs import exclusive
from tuner.problem.observations import Observation, Proposal, configuration_key
from tuner.problem.search_space import Configuration
from tuner.recommendation.recommendation import Recommendation
from tuner.samplers.base import Sampler, SamplerSettings, ask_many
from tuner.samplers.earlier_missions import EarlierMissions
from tuner.samplers.registry import make_sampler

if TYPE_CHECKING:
    from tuner.campaign.ledger import Ledger
    from tuner.surrogate.model import InstanceMeanGP

# After so many trials in a row without a new photograph the search space has no other plan to try.
MAX_CONSECUTIVE_REPEATS = 12
RECOMMENDATION_FILE = "recommendation.json"
LEARNED_FILE = "learned_from.json"


class Campaign:
    """One run directory: `begin_campaign` makes it, `open` looks at it, `run_campaign` fills it."""

    def __init__(self, directory: Path, settings: CampaignSettings, ledger: Ledger) -> None:
        self.directory = directory
        self.settings = settings
        self.ledger = ledger
        self.learned = self._read_learned() if settings.sources else None

    def __repr__(self) -> str:
        """``Campaign(mine in runs/mine: space gate, rocks slab, fin, 64 missions)``; the ledger is not read for it."""
        s = self.settings
        return f"Campaign({s.name} in {self.directory}: space {s.space.name}, rocks {', '.join(s.rocks)}, {s.budget} missions)"

    @functools.cached_property
    def _sampler_settings(self) -> SamplerSettings:
        return dataclasses.replace(self.settings.search, earlier=self.learned)

    @functools.cached_property
    def _sampler(self) -> Sampler:
        return make_sampler(self.settings.sampler, self._sampler_settings)

    @staticmethod
    def open(
        directory: Path,
        expected: CampaignSettings | None = None,
        *,
        read_only: bool = False,
        mission: Path | None = None,
    ) -> Campaign:
        """Return the campaign in ``directory``.

        ``expected``: settings that it must have. ``read_only``: it may be running. ``mission``: the mission file whose program it
        may run.

        Raises `UserError`: no campaign there, other settings, a ledger that is missing or belongs elsewhere, an unknown
        fidelity, a mission file whose program is not allowed.
        """
        if directory.name in ("", ".."):  # ``.``: names beside it are made from its own
            directory = directory.resolve()
        from tuner.campaign.ledger import Ledger  # noqa: PLC0415  loads Optuna

        stored, identity, digest = read_settings(directory)
        if mission is not None:
            stored = with_mission_file(stored, mission, directory)
        settings = settings_from_dict(stored, str(directory / SETTINGS_FILE))
        if expected is not None:
            difference = first_difference(settings.to_dict(), expected.to_dict())
            if difference:
                raise UserError(
                    f"{directory} holds a campaign with other settings: {difference}; "
                    f"resume it as it is (gatetune campaign resume {shlex.quote(str(directory))}; --missions N for more) or choose another directory"
                )
        if not read_only:
            settings.problem.require_named(mission is not None)
        if settings.problem.base.digest() != digest:
            raise UserError(
                f"preset {settings.preset!r} has changed since the campaign in {directory} began; resume it with "
                "the version that began it, or start a new campaign"
            )
        with contextlib.ExitStack() as stack:
            if not read_only:  # repairs to the ledger need the campaign to be idle
                stack.enter_context(exclusive(directory))
            ledger = Ledger(
                directory, settings.name, settings.problem, settings.goal, identity, read_only=read_only
            )
        return Campaign(directory, settings, ledger)

    def trials(self) -> list[Trial]:
        """Return all missions, in trial order."""
        return self.ledger.trials()

    def history(self, trials: Sequence[Trial] | None = None) -> list[Observation]:
        """Return the finished of ``trials`` (None: of all), which samplers and the surrogate learn from."""
        chosen = self.trials() if trials is None else trials
        again = repeated(chosen)
        return [
            dataclasses.replace(t, repeat=True) if t.number in again else t for t in chosen if t.record.status
        ]

    def _read_learned(self) -> EarlierMissions:
        path = self.directory / LEARNED_FILE
        try:
            return EarlierMissions.from_json(read_text(path, RESULT_BYTES), self.settings.space)
        except (UserError, ValueError, KeyError, TypeError) as error:
            raise UserError(f"{path} cannot be read ({error}); restore it") from error

    def status(self) -> CampaignStatus:
        """Return counts, as the ledger knows them."""
        trials = self.trials()
        done = [t for t in trials if t.record.status]
        values = [t.raw for t in done if t.raw is not None]
        repeats = len(repeated(trials))
        is_open = len(trials) > len(done) or len(done) - repeats >= self.settings.budget
        return CampaignStatus(
            name=self.settings.name,
            budget=self.settings.budget,
            complete=len(values),
            failed=len(done) - len(values),
            running=len(trials) - len(done),
            per_rock={rock: sum(t.rock == rock for t in trials) for rock in self.settings.rocks},
            per_condition={
                c.name: sum(t.condition == c.name for t in trials) for c in self.settings.conditions
            },
            failures=dict(collections.Counter(t.reason for t in done if t.raw is None)),
            mission_wall_s=float(sum(t.record.wall_s for t in done)),
            repeats=repeats,
            exhausted="" if is_open else self.exhausted(trials),
        )

    def exhausted(self, trials: Sequence[Trial]) -> str:
        """Return why nothing is left to try after ``trials``, in trial order; empty where something is."""
        budget, p = self.settings.budget, self.settings.problem
        again, in_row = repeated(trials), 0
        done = [t for t in trials if t.record.status]
        for trial in done:
            if trial.record.metadata.get("phase") != "simplified":  # which repeats on purpose
                in_row = in_row + 1 if trial.number in again else 0
        if in_row >= MAX_CONSECUTIVE_REPEATS:
            return (
                f"the last {in_row} trials took photographs that earlier ones had taken: the search has no plan left to try, "
                f"and used {len(done) - len(again)} of {budget} missions"
            )
        every = p.space.size * len(p.instances) * p.replicates
        if len(trials) < every:
            return ""
        run = {(configuration_key(p.space, t.values), t.instance, t.replicate) for t in trials}
        if sum(replicate < p.replicates for _, _, replicate in run) < every:
            return ""
        return (
            f"all {p.space.size:.0f} configurations have run with every replicate: the other "
            f"{budget + len(again) - len(trials)} missions of the budget would repeat them; for repeats give --replicates"
        )

    def recommendation(self, *, save: bool = True, latest: bool = False) -> Recommendation | None:
        """Return the best of what may be recommended, by posterior mean over the training instances; None while `nothing_yet`.

        One that was saved after these very missions is read. ``latest``: also one that was saved before further missions ended,
        since a model of thousands takes long.
        """
        history = self.history()
        if self.nothing_yet(history):
            return None
        if (saved := self.saved_recommendation(history, latest=latest)) is not None:
            return saved
        from tuner.recommendation.choose import recommend  # noqa: PLC0415  who looks need not wait for torch

        # Samplers that run nothing again leave no configuration that has run often enough: theirs is any that has run.
        result = recommend(
            self.settings.problem,
            self.settings.goal,
            history,
            only_verified=self.settings.sampler == "gp",
        )
        if result is not None and save:
            write_atomic(self.directory / RECOMMENDATION_FILE, json.dumps(result.to_dict(), indent=1))
        return result

    def nothing_yet(self, history: Sequence[Observation] | None = None) -> str:
        """Return why nothing is recommended after ``history`` (None: all missions); empty where something is."""
        history, s = self.history() if history is None else history, self.settings
        if not any(o.feasible for o in history):
            return f"none of the {len(history)} finished missions succeeded"
        first = min(max(2, len(s.search.arms)), s.budget)
        if len(history) < first:
            return f"{len(history)} of the first {first} missions have ended, which show how the plain plans vary over rocks and replicates"
        return ""

    def surrogate_from(self, history: Sequence[Observation]) -> InstanceMeanGP:
        """Return the surrogate of `Goal.shown` behind such a recommendation; ``ValueError`` without a success."""
        from tuner.surrogate.model import InstanceMeanGP  # noqa: PLC0415

        p = self.settings.problem
        return InstanceMeanGP(p.space, self.settings.goal.as_shown(history), p.instances)

    def propose(self, trials: Sequence[Trial], known: int, count: int = 1) -> list[Proposal]:
        """Return the sampler's next ``count`` missions after the first ``known`` trials; the others count as in flight."""
        history = self.history(trials[:known])
        running: list[Observation] = [
            dataclasses.replace(t, outcome=None, second=None)
            for i, t in enumerate(trials)
            if not t.record.status or i >= known
        ]
        return ask_many(self._sampler, self._sampler_settings, history, running, count)

    def job(self, trial: Trial, config: Configuration) -> MissionJob:
        """Return the job that runs ``config`` where ``trial`` runs, and writes into its directory."""
        s = self.settings
        return MissionJob(
            id=f"{trial.number:04d}",
            config=config,
            rock=s.problem.drawn_rock(trial.rock, trial.replicate),
            replicate=trial.replicate,
            directory=trial.record.directory,
            keep=s.keep,
            fidelity=s.fidelity,
        )

    def evaluation_rocks(
        self, rocks: Sequence[str] | None, replicates: int = 1
    ) -> tuple[tuple[str, ...], int]:
        """Return the rocks of an evaluation, ``rocks`` or by default the held-out ones, and its number of replicates.

        Raises `UserError`: a rock that the campaign, or one that it learned from, was tuned on; as
        `Problem.evaluated_on`.
        """
        chosen, replicates = self.settings.problem.evaluated_on(rocks, replicates)
        seen = self.rocks_seen()
        for rock in chosen:
            if rock in seen:
                raise UserError(
                    f"rock {rock!r} was tuned on in {self.directory}, or in a campaign that it learned from; evaluate "
                    "on rocks that neither has seen"
                )
        return chosen, replicates

    def rocks_seen(self) -> set[str]:
        """Return all rocks and families that it, or a campaign that it learned from, was tuned on; drawn rocks by name, too."""
        drawn = {self.settings.problem.drawn_rock(t.rock, t.replicate) for t in self.trials()}
        learned = () if self.learned is None else (*self.learned.rocks, *self.learned.seen)
        return {*self.settings.rocks, *drawn, *learned}

    def mean_photographs(self, values: Mapping[str, Any]) -> int | None:
        """Return how many photographs missions at ``values`` took, mean rounded up; None where none is known."""
        numbers = [
            taken
            for t in self.trials()
            if dict(t.values) == dict(values) and (taken := t.costs.get("images")) is not None
        ]
        return math.ceil(sum(numbers) / len(numbers)) if numbers else None

    def recommended_config(self) -> Configuration:
        """Return the recommendation as a complete mission configuration, under no condition; raises as `recommended`."""
        return self.settings.problem.config(self.recommended().values)

    def recommended(self) -> Recommendation:
        """Return the `recommendation` without saving it.

        Raises `UserError`: there is none yet.
        """
        result = self.recommendation(save=False)
        if result is None:
            raise UserError(
                f"{self.directory} recommends nothing yet: {self.nothing_yet()}; run or resume the campaign first"
            )
        return result

    def saved_recommendation(
        self, history: Sequence[Observation] | None = None, *, latest: bool = False
    ) -> Recommendation | None:
        """Return the recommendation saved after exactly ``history`` (None: all missions); None without such a file.

        ``latest``: however many missions have ended since.
        """
        history = self.history() if history is None else history
        try:
            saved = Recommendation.from_dict(read_json(self.directory / RECOMMENDATION_FILE))
        except (UserError, AttributeError, ValueError, KeyError, TypeError):
            return None
        evaluated = any(saved.values == dict(o.values) for o in history)
        return saved if evaluated and (latest or saved.missions_behind == len(history)) else None
