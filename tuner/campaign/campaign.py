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
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from nbv.config import MissionConfig
from nbv.errors import UserError
from nbv.rocks.families import HELD_OUT_FROM, generated_name
from nbv.safe_files import RESULT_BYTES, read_json, read_text, write_atomic
from tuner.campaign.mission_problem import procedural_rocks, rock_arguments
from tuner.campaign.settings import CampaignSettings
from tuner.campaign.settings_file import (
    SETTINGS_FILE,
    first_difference,
    read_settings,
    settings_from_dict,
)
from tuner.missions.job import MissionJob, Trial, repeated
from tuner.missions.run_jobs import exclusive
from tuner.problem.observations import Observation, Proposal, blocks_evaluated
from tuner.recommendation.recommendation import Recommendation
from tuner.samplers.base import EarlierMissions, Sampler, SamplerSettings, ask_many, make_sampler

if TYPE_CHECKING:
    from tuner.campaign.ledger import Ledger
    from tuner.surrogate.model import InstanceMeanGP


# What a campaign tells while it runs and when it ends: events, counts, the summary of a session.


EventKind = Literal[
    "launched",
    "finished",
    "failed",
    "lost",  # the machine ended the mission; its trial stays open
    "interrupted",
    "stopped",
    "done",
]
Ending = Literal["budget", "interrupted", "failing", "exhausted"]


@dataclass(frozen=True)
class CampaignEvent:
    kind: EventKind
    elapsed_s: float  # since this session began
    finished: int  # missions finished so far, failed ones included, repeats left out
    budget: int
    trial: Trial | None = None
    recommendation: Recommendation | None = None
    message: str = ""


@dataclass(frozen=True)
class CampaignStatus:
    name: str
    budget: int
    complete: int
    failed: int
    running: int  # in flight, or interrupted and waiting for a resume
    per_rock: dict[str, int]
    per_condition: dict[str, int]
    failures: dict[str, int]  # by reason
    mission_wall_s: float
    repeats: int = 0  # trials that took the photographs of an earlier one: they use no budget
    exhausted: str = ""  # why the search ended before the budget was used, so that a resume runs nothing

    @property
    def finished(self) -> int:
        """Missions with an outcome, failures included, repeats left out."""
        return self.complete + self.failed - self.repeats

    @property
    def remaining(self) -> int:
        return max(0, self.budget - self.finished)


@dataclass(frozen=True)
class CampaignSummary:
    """How one session (``run_campaign``) ended."""

    stopped: Ending
    message: str
    elapsed_s: float
    ask_s: float  # spent by the sampler
    status: CampaignStatus
    recommendation: Recommendation | None

    @property
    def found(self) -> bool:
        """Whether the search has come to its end, with a recommendation."""
        return self.stopped in ("budget", "exhausted") and self.recommendation is not None


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
        self.learned: EarlierMissions | None = None
        if settings.learn_from:
            path = directory / LEARNED_FILE
            try:
                self.learned = EarlierMissions.from_json(read_text(path, RESULT_BYTES), settings.space)
            except (UserError, ValueError, KeyError, TypeError) as error:
                raise UserError(f"{path} cannot be read ({error}); restore it") from error

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
        directory: str | Path, expected: CampaignSettings | None = None, *, read_only: bool = False
    ) -> Campaign:
        """Return the campaign in ``directory``.

        ``expected``: settings that it must have. ``read_only``: it may be running.

        Raises `UserError`: no campaign there, other settings, a ledger that is missing or belongs elsewhere, an unknown
        fidelity.
        """
        directory = Path(directory)
        if directory.name in ("", ".."):  # ``.``: names beside it are made from its own
            directory = directory.resolve()
        from tuner.campaign.ledger import Ledger  # noqa: PLC0415  loads Optuna

        stored, identity, digest = read_settings(directory)
        settings = settings_from_dict(stored, str(directory / SETTINGS_FILE))
        if expected is not None and (difference := first_difference(settings.to_dict(), expected.to_dict())):
            raise UserError(
                f"{directory} holds a campaign with other settings: {difference}; "
                f"resume it as it is (gatetune campaign resume {shlex.quote(str(directory))}; --missions N for more) or choose another directory"
            )
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

    def status(self) -> CampaignStatus:
        """Return counts, as the ledger knows them."""
        trials = self.trials()
        done = [t for t in trials if t.record.status]
        values = [t.raw for t in done if t.raw is not None]
        repeats = len(repeated(trials))
        is_open = len(trials) > len(done) or len(done) - repeats >= self.settings.budget
        return CampaignStatus(
            name=self.settings.name,
            budget=max(self.settings.budget, len(done) - repeats),  # favourites fly behind it
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
        run = blocks_evaluated(p.space, trials).values()
        if sum(replicate < p.replicates for blocks in run for _, replicate in blocks) < every:
            return ""
        return (
            f"all {p.space.size:.0f} configurations have run with every replicate: the other "
            f"{budget + len(again) - len(trials)} missions of the budget would repeat them; for repeats give --replicates"
        )

    def recommendations(self, *, save: bool = True, only_verified: bool = True) -> dict[str, Recommendation]:
        """Return what is recommended in every region by its name (`tuner.problem.search_space`); nothing while `nothing_yet`.

        That is the configuration with the fewest changes among those that ran often enough and are not worse than the one with
        the largest posterior mean (`tuner.recommendation.choose`). Those that were saved after these very missions are read.
        Without ``only_verified`` those that ran once count, too.
        """
        history = self.history()
        if self.nothing_yet(history):
            return {}
        if only_verified and (saved := self.saved_recommendations(history)):
            return saved
        from tuner.recommendation.choose import recommend  # noqa: PLC0415  who looks need not wait for torch

        # Samplers that run nothing again leave no configuration that has run often enough: theirs is any that has run.
        s = self.settings
        found = recommend(s.problem, s.goal, history, only_verified=only_verified and s.sampler == "gp")
        if found and save:
            tree = {name: each.to_dict() for name, each in found.items()}
            write_atomic(self.directory / RECOMMENDATION_FILE, json.dumps(tree, indent=1))
        return found

    def recommendation(self, name: str = "", *, save: bool = True) -> Recommendation | None:
        """Return one of the `recommendations`, by default the one of the largest region; None while there is none."""
        found = self.recommendations(save=save)
        return found.get(name or self.settings.problem.answers[-1].name)

    def nothing_yet(self, history: Sequence[Observation] | None = None) -> str:
        """Return why nothing is recommended after ``history`` (None: all missions); empty where something is."""
        history, s = self.history() if history is None else history, self.settings
        if not any(o.feasible for o in history):
            return f"none of the {len(history)} finished missions succeeded"
        first = min(max(2, len(s.search.arms)), s.budget)
        if len(history) < first:
            return f"{len(history)} of the first {first} missions have ended, which show how the plain plans vary over rocks and replicates"
        return ""

    def surrogate(self) -> InstanceMeanGP:
        """Return the surrogate of the objective after all missions; `UserError` without a success."""
        from tuner.surrogate.model import InstanceMeanGP  # noqa: PLC0415

        history, p = self.history(), self.settings.problem
        if not any(o.feasible for o in history):
            raise UserError(f"{self.directory} has no model: {self.nothing_yet(history)}")
        return InstanceMeanGP(p.space, history, p.instances)

    def propose(self, trials: Sequence[Trial], known: int, count: int = 1) -> list[Proposal]:
        """Return the sampler's next ``count`` missions after the first ``known`` trials; the others count as in flight."""
        history = self.history(trials[:known])
        running: list[Observation] = [
            dataclasses.replace(t, outcome=None, second=None)
            for i, t in enumerate(trials)
            if not t.record.status or i >= known
        ]
        return ask_many(self._sampler, self._sampler_settings, history, running, count)

    def job(self, trial: Trial, config: MissionConfig) -> MissionJob:
        """Return the job that runs ``config`` where ``trial`` runs, and writes into its directory."""
        s = self.settings
        return MissionJob(
            id=f"{trial.number:04d}",
            config=config,
            rock=trial.rock,
            replicate=trial.replicate,
            directory=trial.record.directory,
            keep=s.keep,
            fidelity=s.fidelity,
        )

    def evaluation_rocks(self, rocks: Sequence[str] | None) -> tuple[str, ...]:
        """Return the rocks of an evaluation, ``rocks`` or by default `held_out`.

        Raises `UserError`: a rock that the campaign, or one that it learned from, was tuned on; as `rock_arguments`.
        """
        chosen = tuple(rock_arguments(rocks or self.held_out()))
        if tuned := sorted(self.rocks_seen().intersection(chosen), key=chosen.index):
            raise UserError(
                f"rock {tuned[0]!r} was tuned on in {self.directory}, or in a campaign that it learned from; evaluate "
                "on rocks that neither has seen"
            )
        return chosen

    def held_out(self) -> list[str]:
        """Return held-out targets of the kinds that it was tuned on: the catalogue's rocks, three of each family."""
        kinds = dict.fromkeys(drawn and drawn[0] for drawn in map(generated_name, self.settings.rocks))
        family = [f"{kind}-{HELD_OUT_FROM + k}" for k in range(3) for kind in kinds if kind]
        return [*(procedural_rocks("held-out") if None in kinds else ()), *family]

    def rocks_seen(self) -> set[str]:
        """Return all rocks that it, or a campaign that it learned from, was tuned on."""
        learned = () if self.learned is None else (*self.learned.rocks, *self.learned.seen)
        return {*self.settings.rocks, *learned}

    def mean_photographs(self, values: Mapping[str, Any]) -> int | None:
        """Return how many photographs missions at ``values`` took, mean rounded up; None where none is known."""
        taken = [t.costs.get("images") for t in self.trials() if dict(t.values) == dict(values)]
        numbers = [number for number in taken if number is not None]
        return math.ceil(sum(numbers) / len(numbers)) if numbers else None

    def recommended(self) -> dict[str, Recommendation]:
        """Return the `recommendations` without saving them.

        Raises `UserError`: there is none yet.
        """
        found = self.recommendations(save=False)
        if not found:
            raise UserError(
                f"{self.directory} recommends nothing yet: {self.nothing_yet()}; run or resume the campaign first"
            )
        return found

    def recommended_config(self, name: str = "") -> MissionConfig:
        """Return one of the recommendations as a complete configuration under no condition, by default that of the largest region; raises as `recommended`."""
        found = self.recommended()
        return self.settings.problem.config(found[name or list(found)[-1]].values)

    def predict(self, values: Mapping[str, Any]) -> tuple[float, float, float]:
        """Return ``(mean, low, high)``: what the surrogate predicts at tuned values, the others at the default, with its 95 % interval.

        Of the objective's mean over the training instances, in the metric's unit. Raises `UserError`: a name that is not tuned, a
        value outside its range, no mission that succeeded.
        """
        from tuner.surrogate.fit import interval_95  # noqa: PLC0415  loads torch

        space, sign = self.settings.space, self.settings.objective.sign
        space.require(values)
        full = space.settled({**self.settings.problem.default, **values})
        posterior = self.surrogate().posterior([full])
        mean, sd = float(posterior.mean[0]), float(posterior.sd[0])
        low, high = sorted(sign * bound for bound in interval_95(mean, sd))
        return sign * mean, low, high

    def saved_recommendations(self, history: Sequence[Observation]) -> dict[str, Recommendation]:
        """Return those saved after exactly ``history``; nothing without such a file."""
        try:
            tree = read_json(self.directory / RECOMMENDATION_FILE)
            saved = {name: Recommendation.from_dict(each) for name, each in tree.items()}
        except (UserError, AttributeError, ValueError, KeyError, TypeError):
            return {}
        ran = [dict(o.values) for o in history]
        evaluated = all(each.values in ran for each in saved.values())
        current = all(each.missions_behind == len(history) for each in saved.values())
        return saved if evaluated and current else {}
