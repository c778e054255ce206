"""A campaign: ask, fly, tell, until the budget is used; interrupted and resumed without losing a mission.

A trial is one mission: one configuration on one rock with one replicate. Rocks are taken in turn, and missions
share replicate numbers, so that configurations meet on common (rock, replicate) pairs. The run directory::

    campaign.yaml          what was asked for; a resume must agree with it
    study.journal          the ledger (unless another storage was named)
    missions/NNNN_ROCK_rK  one directory per mission
    recommendation.json    the current recommendation
    screening.json         the missions of a low fidelity, where one was asked for
    learned_from.json      the missions of earlier campaigns, where some were named
    front.json             the Pareto front, where a second objective was asked for
"""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import datetime
import json
import threading
import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import yaml

from nbv.config import MissionConfig, preset
from nbv.errors import UserError
from nbv.run_directory import write_atomic
from tuner.confirmation import (
    MAX_SHARE,
    choose_finalists,
    confirmation_missions,
    finalist_count,
    schedule,
)
from tuner.executors import Executor
from tuner.gp_options import GPOptions
from tuner.history import Observation, Proposal
from tuner.initial_design import initial_design_size
from tuner.ledger import Ledger, TrialRecord
from tuner.missions import (
    DEFAULT_RUNNER,
    Keep,
    MissionJob,
    MissionOutcome,
    MissionRunner,
    collect_outcome,
    resolve_runner,
)
from tuner.objective import Direction, Objective
from tuner.recommendation import Recommendation, recommend
from tuner.samplers import (
    ALL_SAMPLER_NAMES,
    Sampler,
    SamplerSettings,
    make_sampler,
    require_sampler,
    surrogate_settings,
)
from tuner.search_space import SearchSpace, Values, space_from_dict
from tuner.session import exclusive, stop_signals
from tuner.slots import next_slot

if TYPE_CHECKING:
    from tuner.earlier_missions import EarlierMissions
    from tuner.pareto import FrontPoint
    from tuner.surrogate import RockMeanGP, SurrogateSettings

SETTINGS_FILE = "campaign.yaml"
RECOMMENDATION_FILE = "recommendation.json"
SCREENING_FILE = "screening.json"
LEARNED_FILE = "learned_from.json"
FRONT_FILE = "front.json"
# What `low_fidelity` may be called instead of module:function.
LOW_FIDELITIES = {"geometric": "nbv.geometric:run_geometric_mission"}
FIDELITIES = {"photogrammetric": DEFAULT_RUNNER, **LOW_FIDELITIES}
FORMAT_VERSION = 1
# So many failures in a row mean that something is wrong with the set-up, not with the configurations.
MAX_CONSECUTIVE_FAILURES = 8
_POLL_S = 0.5
_SCREENING_EVENTS = 25


@dataclass(frozen=True)
class CampaignSettings:
    """What a campaign is; two campaigns with equal settings are the same experiment.

    Raises
    ------
    UserError
        A budget, replicate count or rock list that makes no campaign; an unknown sampler or preset.
    """

    name: str
    space: SearchSpace
    rocks: tuple[str, ...]  # training rocks: names or mesh files
    budget: int  # missions
    replicates: int = 1  # per rock, numbered from 0
    seed: int = 0
    preset: str = "campaign"
    overrides: dict[str, Any] = field(default_factory=dict)  # parameter paths laid over the preset
    objective: Objective = field(default_factory=Objective)
    sampler: str = "gp"
    initial: int | None = None  # missions of the initial design; None: as many as suit sampler and budget
    runner: str = DEFAULT_RUNNER
    keep: Keep = "summary"
    storage: str | None = None  # None: study.journal in the run directory
    confirmation: float = 0.0  # share of the budget that flies the finalists again, see tuner.confirmation
    gp: GPOptions = field(default_factory=GPOptions)  # of sampler gp
    second: Objective | None = None  # search the front between the objective and this one
    low_fidelity: str | None = None  # screen with it first: geometric, or module:function of a mission runner
    learn_from: tuple[str, ...] = ()  # run directories of earlier campaigns, see tuner.transfer
    stop_when_settled: bool = False  # before the budget is used, see tuner.stopping
    # A proposal knows every earlier mission but the last in_step - 1, whichever of those have ended: the same campaign
    # with any number of workers (of which in_step have work). None: it knows what has ended, so that nobody waits.
    in_step: int | None = None

    def __post_init__(self) -> None:
        if not self.name:
            raise UserError("the campaign needs a name")
        if self.budget < 1:
            raise UserError(f"the budget is {self.budget} missions; give at least 1")
        if self.replicates < 1:
            raise UserError(f"replicates is {self.replicates}; give at least 1")
        if self.in_step is not None and self.in_step < 1:
            raise UserError(f"in step is {self.in_step} missions; give at least 1")
        if self.seed < 0:
            raise UserError(f"the seed is {self.seed}; give 0 or more")
        if not self.rocks:
            raise UserError("the campaign has no rocks; name at least one")
        twice = [rock for rock, count in collections.Counter(self.rocks).items() if count > 1]
        if twice:
            raise UserError(f"rock {twice[0]!r} is named twice; name each rock once")
        if self.initial is not None and self.initial < 1:
            raise UserError(f"the initial design has {self.initial} missions; give at least 1")
        if not 0.0 <= self.confirmation <= MAX_SHARE:
            raise UserError(
                f"the confirmation stage has a share of {self.confirmation:g}; give 0 to {MAX_SHARE:g}"
            )
        if self.confirmation > 0 and self.budget - self.search_budget < 2:
            raise UserError(
                f"a share of {self.confirmation:g} of {self.budget} missions confirms nothing: two configurations "
                "must meet; raise the budget or the share"
            )
        self._check_options()
        if self.sampler not in ALL_SAMPLER_NAMES:
            raise UserError(f"unknown sampler {self.sampler!r}; there are {', '.join(ALL_SAMPLER_NAMES)}")
        self.default_values()  # the space must fit the preset

    def _check_options(self) -> None:
        asked = {
            "a risk measure, prior, sparse or fully Bayesian model": not self.gp.is_default,
            "a second objective": self.second is not None,
            "a low fidelity": self.low_fidelity is not None,
            "learning from earlier campaigns": bool(self.learn_from),
            "stopping when settled": self.stop_when_settled,
        }
        for what, wanted in asked.items():
            if wanted and self.sampler != "gp":
                raise UserError(f"{what} needs sampler gp, not {self.sampler}; leave it out or choose gp")
            if wanted and self.second is not None and what != "a second objective":
                raise UserError(f"{what} cannot be combined with a second objective; leave one of them out")
        if self.gp.risk != "mean" and len(self.rocks) < 2:
            raise UserError(f"risk measure {self.gp.risk} is over rocks; name at least two")
        if self.stop_when_settled and self.confirmation > 0:
            raise UserError("a confirmation stage needs its budget; leave it or stopping when settled out")
        if self.low_fidelity is not None:
            self.low_fidelity_runner()
            if self.low_fidelity == self.fidelity:
                raise UserError(
                    f"the campaign's own missions are {self.low_fidelity} already; screen with another fidelity or none"
                )

    @property
    def fidelity(self) -> str | None:
        """What the command line calls its missions' fidelity; None: a runner of somebody's own."""
        return next((name for name, runner in FIDELITIES.items() if runner == self.runner), None)

    def low_fidelity_runner(self) -> MissionRunner:
        """What flies the cheap missions.

        Raises
        ------
        UserError
            There is no such runner.
        """
        return resolve_runner(LOW_FIDELITIES.get(str(self.low_fidelity), str(self.low_fidelity)))

    def base_config(self) -> MissionConfig:
        """The mission configuration on which tuned values are laid."""
        return self.space.base_config(preset(self.preset).with_values(self.overrides))

    def config(self, values: Mapping[str, Any]) -> MissionConfig:
        """The mission configuration at tuned ``values``."""
        return self.base_config().with_values(dict(values))

    def default_values(self) -> Values:
        """Where every sampler starts: the paper's values."""
        return self.space.default(preset(self.preset).with_values(self.overrides))

    @property
    def search_budget(self) -> int:
        """Missions before the confirmation stage."""
        return self.budget - confirmation_missions(self.budget, self.confirmation)

    def initial_size(self) -> int:
        """Missions of the initial design."""
        if self.initial is not None:
            return min(self.initial, self.search_budget)
        # The paper's values were chosen by hand. Other samplers keep the designs their authors recommend.
        trusted = self.sampler == "gp"
        return initial_design_size(
            self.space.dimension, self.search_budget, trusted_default=trusted,
            earlier=bool(self.learn_from),
        )  # fmt: skip

    def make_sampler(self, earlier: EarlierMissions | None = None) -> Sampler:
        """The sampler at work; ``earlier``: missions flown before the campaign."""
        settings = SamplerSettings(
            self.space, self.default_values(), self.rocks, self.seed, self.initial_size(), self.replicates,
            self.gp, earlier, self.second is not None, self.stop_when_settled, self.search_budget,
            trusted_default=True,
        )  # fmt: skip
        return make_sampler(self.sampler, settings)

    def learned(self) -> EarlierMissions | None:
        """The missions of the earlier campaigns named; None where none is.

        Raises
        ------
        UserError
            As ``tuner.transfer.learn_from``.
        """
        if not self.learn_from:
            return None
        from tuner.transfer import learn_from

        return learn_from(self.learn_from, self.space, self.base_config(), self.objective)

    def surrogate(self) -> SurrogateSettings:
        """What sampler gp, the recommendation and the report model."""
        return surrogate_settings(self.gp, self.space)

    def to_dict(self) -> dict[str, Any]:
        """YAML form."""
        return {
            "name": self.name,
            "search_space": self.space.to_dict(),
            "rocks": list(self.rocks),
            "budget": self.budget,
            "replicates": self.replicates,
            "seed": self.seed,
            "preset": self.preset,
            "overrides": dict(self.overrides),
            "objective": {"metric": self.objective.metric, "direction": self.objective.direction},
            "sampler": self.sampler,
            "initial": self.initial_size(),
            "runner": self.runner,
            "keep": self.keep,
            "storage": self.storage,
            "confirmation": self.confirmation,
            "gp": self.gp.to_dict(),
            "second": None if self.second is None else dataclasses.asdict(self.second),
            "low_fidelity": self.low_fidelity,
            "learn_from": list(self.learn_from),
            "stop_when_settled": self.stop_when_settled,
            "in_step": self.in_step,
        }

    @staticmethod
    def from_dict(tree: Mapping[str, Any], source: str) -> CampaignSettings:
        """The inverse of ``to_dict``; ``source`` names the file in messages."""
        try:
            return CampaignSettings(
                name=tree["name"],
                space=space_from_dict(tree["search_space"], source),
                rocks=tuple(tree["rocks"]),
                budget=tree["budget"],
                replicates=tree["replicates"],
                seed=tree["seed"],
                preset=tree["preset"],
                overrides=dict(tree["overrides"]),
                objective=Objective(tree["objective"]["metric"], tree["objective"]["direction"]),
                sampler=tree["sampler"],
                initial=tree["initial"],
                runner=tree["runner"],
                keep=tree["keep"],
                storage=tree["storage"],
                confirmation=tree.get("confirmation", 0.0),  # campaigns begun before there was one, and so on
                # Of no meaning to other samplers; earlier versions wrote defaults that are none any more.
                gp=GPOptions.from_dict(tree.get("gp") or {}) if tree["sampler"] == "gp" else GPOptions(),
                second=Objective(**tree["second"]) if tree.get("second") else None,
                low_fidelity=tree.get("low_fidelity"),
                learn_from=tuple(tree.get("learn_from") or ()),
                stop_when_settled=tree.get("stop_when_settled", False),
                in_step=tree.get("in_step"),
            )
        except (KeyError, TypeError, AttributeError) as error:
            raise UserError(f"{source} is not a campaign's settings ({error!r}); restore the file") from error


EventKind = Literal[
    "screening",
    "proposed",
    "launched",
    "finished",
    "failed",
    "recommendation",
    "interrupted",
    "stopped",
    "done",
]


@dataclass(frozen=True)
class CampaignEvent:
    """Something a live display may show."""

    kind: EventKind
    elapsed_s: float  # since this session began
    finished: int  # missions finished so far, failed ones included
    budget: int
    trial: TrialRecord | None = None
    recommendation: Recommendation | None = None
    ask_s: float = 0.0  # time the sampler took, for "proposed"
    message: str = ""


@dataclass(frozen=True)
class CampaignStatus:
    """Counts and costs of a campaign."""

    name: str
    budget: int
    complete: int
    failed: int
    running: int  # in flight, or interrupted and waiting for a resume
    per_rock: dict[str, int]
    failures: dict[str, int]  # by reason
    mission_wall_s: float
    flight_time_s: float
    path_length_m: float
    images: float
    best_observed: float | None  # luckiest mission; see the recommendation for the best configuration

    @property
    def finished(self) -> int:
        """Missions with an outcome, failures included."""
        return self.complete + self.failed

    @property
    def remaining(self) -> int:
        """Missions still to finish."""
        return max(0, self.budget - self.finished)


@dataclass(frozen=True)
class CampaignSummary:
    """How one session of ``Campaign.run`` ended."""

    stopped: Literal["budget", "settled", "interrupted", "failing"]
    message: str
    elapsed_s: float
    ask_s: float  # spent by the sampler
    status: CampaignStatus
    recommendation: Recommendation | None


class Campaign:
    """One run directory. Use ``create`` or ``open``."""

    def __init__(self, directory: Path, settings: CampaignSettings, ledger: Ledger) -> None:
        self.directory = directory
        self.settings = settings
        self.ledger = ledger
        self.learned = self._read_earlier(LEARNED_FILE, "restore it") if settings.learn_from else None
        self.screening = None
        if settings.low_fidelity is not None and (directory / SCREENING_FILE).is_file():
            self.screening = self._read_earlier(SCREENING_FILE, "delete it and resume: it is flown again")
        self._sampler = settings.make_sampler(self.earlier)

    @property
    def earlier(self) -> EarlierMissions | None:
        """What was flown before the campaign: its screening, which has learned from earlier campaigns, or those."""
        return self.screening or self.learned

    # -- the run directory -----------------------------------------------------------------------------------

    @staticmethod
    def create(directory: Path, settings: CampaignSettings) -> Campaign:
        """Begin a campaign in a new or empty directory.

        Raises
        ------
        UserError
            The directory holds something already or cannot be written; the storage cannot be used.
        """
        if (directory / SETTINGS_FILE).exists():
            theirs = _read_settings(directory)[0]
            what = (
                "this campaign" if theirs == settings.to_dict() else f"another campaign ({theirs['name']!r})"
            )
            raise UserError(
                f"{directory} already holds {what}; resume it with `gatetune campaign resume {directory}` "
                "or choose another directory"
            )
        if directory.exists() and (not directory.is_dir() or any(directory.iterdir())):
            raise UserError(f"{directory} exists and is not an empty directory; choose another directory")
        learned = settings.learned()
        settings.make_sampler()
        require_sampler(settings.sampler)  # here and not in make_sampler: a report must open without the peer
        was_there = directory.exists()
        try:
            directory.mkdir(parents=True, exist_ok=True)
            identity = uuid.uuid4().hex
            try:
                ledger = Ledger(
                    directory, settings.storage, settings.name, identity, settings.space, settings.objective,
                    create=True,
                )  # fmt: skip
            except UserError:
                if not was_there:
                    with contextlib.suppress(OSError):  # not empty: somebody else's
                        directory.rmdir()
                raise
            tree = {
                "format": FORMAT_VERSION,
                "id": identity,
                "created": datetime.datetime.now().astimezone().isoformat(timespec="seconds"),
                "base_config_digest": settings.base_config().digest(),
                "settings": settings.to_dict(),
            }
            if learned is not None:
                write_atomic(directory / LEARNED_FILE, learned.to_json())
            write_atomic(directory / SETTINGS_FILE, yaml.safe_dump(tree, sort_keys=False, allow_unicode=True))
        except OSError as error:
            raise UserError(
                f"cannot write to {directory}: {error.strerror}; choose another directory"
            ) from error
        return Campaign(directory, settings, ledger)

    @staticmethod
    def open(
        directory: Path, expected: CampaignSettings | None = None, *, read_only: bool = False
    ) -> Campaign:
        """The campaign in ``directory``.

        Parameters
        ----------
        expected
            Settings the caller believes in; a difference is refused.
        read_only
            For status and reports of a campaign that may be running.

        Raises
        ------
        UserError
            No campaign there, other settings, a ledger that is missing or belongs elsewhere.
        """
        stored, identity, digest = _read_settings(directory)
        settings = CampaignSettings.from_dict(stored, str(directory / SETTINGS_FILE))
        if expected is not None:
            difference = _first_difference(settings.to_dict(), expected.to_dict())
            if difference:
                raise UserError(
                    f"{directory} holds a campaign with other settings: {difference}; "
                    "resume it as it is or choose another directory"
                )
        if settings.base_config().digest() != digest:
            raise UserError(
                f"preset {settings.preset!r} has changed since the campaign in {directory} began; resume it with "
                "the version that began it, or start a new campaign"
            )
        with contextlib.ExitStack() as stack:
            if not read_only:  # repairs to the ledger need the campaign to be idle
                stack.enter_context(exclusive(directory))
            ledger = Ledger(
                directory, settings.storage, settings.name, identity, settings.space, settings.objective,
                read_only=read_only,
            )  # fmt: skip
        return Campaign(directory, settings, ledger)

    # -- looking ---------------------------------------------------------------------------------------------

    def trials(self) -> list[TrialRecord]:
        """All missions, in trial order."""
        return self.ledger.trials()

    def history(self, trials: Sequence[TrialRecord] | None = None) -> list[Observation]:
        """Finished missions, with the second objective's outcome where there is one."""
        trials = self.trials() if trials is None else trials
        history = self.ledger.history(trials)
        second = self.settings.second
        if second is None:
            return history
        outcomes: dict[int, float | None] = {}
        for t in trials:
            value = second.measure({**t.metrics, "costs": t.costs}) if t.state == "complete" else None
            outcomes[t.number] = None if value is None else second.sign * value
        return [dataclasses.replace(o, second=outcomes[o.number]) for o in history]

    def _read_earlier(self, name: str, remedy: str) -> EarlierMissions:
        from tuner.earlier_missions import EarlierMissions

        path = self.directory / name
        try:
            return EarlierMissions.from_json(path.read_text(), self.settings.space)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise UserError(f"{path} cannot be read ({error!r}); {remedy}") from error

    def fly_screening(self, on_mission: Callable[[int, int], None]) -> None:
        """Fly the missions of the low fidelity and keep them; ``on_mission`` hears (flown, total)."""
        from threadpoolctl import threadpool_limits

        from tuner.screening import CheapMissions, screen

        s = self.settings
        fly = CheapMissions(s.low_fidelity_runner(), s.config, s.objective)
        with threadpool_limits(1):
            flown = screen(
                s.space, s.rocks, s.default_values(), fly, s.seed, on_mission, trusted_default=True,
                earlier=self.learned,
            )  # fmt: skip
        write_atomic(self.directory / SCREENING_FILE, flown.to_json())
        self.screening = flown
        self._sampler = s.make_sampler(self.earlier)

    def flown_in_both(self) -> list[FrontPoint]:
        """What is believed of every configuration in both objectives; empty without a second one or its values."""
        s = self.settings
        history = [o for o in self.history() if o.outcome is not None and o.second is not None]
        if s.second is None or not history:
            return []
        from tuner.pareto import flown_in_both, two_models

        models = two_models(s.space, history, s.rocks, s.seed, s.surrogate())
        return flown_in_both(models, (s.objective, s.second))

    def front(self, *, save: bool = True) -> list[FrontPoint]:
        """The Pareto front of the configurations flown; empty where `flown_in_both` is."""
        points = self.flown_in_both()
        if self.settings.second is None or not points:
            return []
        from tuner.pareto import pareto_front

        points = pareto_front(points, (self.settings.objective, self.settings.second))
        if save:
            write_atomic(self.directory / FRONT_FILE, json.dumps([p.to_dict() for p in points], indent=1))
        return points

    def status(self) -> CampaignStatus:
        """Counts and costs."""
        trials = self.trials()
        done = [t for t in trials if t.state != "running"]
        values = [t.raw for t in done if t.raw is not None]
        best = max if self.settings.objective.direction == "maximise" else min

        def total(key: str) -> float:
            return float(sum(t.costs.get(key) or 0.0 for t in done))

        return CampaignStatus(
            name=self.settings.name,
            budget=self.settings.budget,
            complete=sum(t.state == "complete" for t in trials),
            failed=sum(t.state == "failed" for t in trials),
            running=len(trials) - len(done),
            per_rock={rock: sum(t.rock == rock for t in trials) for rock in self.settings.rocks},
            failures=dict(collections.Counter(t.reason for t in trials if t.state == "failed")),
            mission_wall_s=float(sum(t.wall_s for t in done)),
            flight_time_s=total("flight_time_s"),
            path_length_m=total("path_length_m"),
            images=total("images"),
            best_observed=best(values) if values else None,
        )

    def recommendation(self, *, save: bool = True, check: bool = False) -> Recommendation | None:
        """The evaluated configuration with the best posterior mean over the training rocks.

        ``check``: how well the missions were predicted before they were flown, a fit each for up to 24 of them.
        """
        history = self.history()
        result = self.recommend_from(history)
        if result is not None and check:
            from tuner.forward_check import check_ahead

            s = self.settings
            found = check_ahead(
                s.space, history, s.rocks, s.initial_size(), s.seed, s.surrogate(), self.earlier
            )
            result = dataclasses.replace(result, ahead_of_search=found.to_dict() if found else None)
        if result is not None and save:
            write_atomic(self.directory / RECOMMENDATION_FILE, json.dumps(result.to_dict(), indent=1))
        return result

    def recommend_from(self, history: Sequence[Observation]) -> Recommendation | None:
        """What would be recommended after ``history``."""
        s = self.settings
        return recommend(
            s.space, history, s.rocks, s.default_values(), s.objective, s.seed,
            confirmed=range(s.search_budget, s.budget), settings=s.surrogate(), risk=s.gp.risk,
            earlier=self.earlier,
        )  # fmt: skip

    def surrogate_from(
        self, history: Sequence[Observation], rocks: Sequence[str] | None = None
    ) -> RockMeanGP:
        """The surrogate behind such a recommendation, of ``rocks`` (the campaign's where None).

        ``ValueError`` without a successful mission.
        """
        from tuner.surrogate import RockMeanGP

        s = self.settings
        return RockMeanGP(s.space, history, rocks or s.rocks, s.seed, s.surrogate(), self.earlier)

    def confirmation_plan(self) -> list[Proposal]:
        """The missions of the confirmation stage, a function of the search missions alone.

        Empty without a stage, and where no search mission succeeded.
        """
        s = self.settings
        search = [o for o in self.history() if o.number < s.search_budget]
        missions = s.budget - s.search_budget
        result = self.recommend_from(search) if missions else None
        if result is None:
            return []
        ranked = [candidate.values for candidate in result.top]
        count = finalist_count(missions, len(s.rocks))
        # Beside a trend length scales say nothing of how alike two configurations are.
        lengths = None if s.surrogate().trend else result.lengthscales
        finalists = choose_finalists(s.space, ranked, s.default_values(), count, lengths)
        first_replicate = max(s.replicates, 1 + max(o.replicate for o in search))
        return schedule(finalists, s.rocks, first_replicate, missions)

    def recommended_config(self) -> MissionConfig:
        """The recommendation as a complete mission configuration.

        What the campaign ended with stands, so that an evaluation goes on after an upgrade of this program whose
        surrogate would choose another one; it is made anew where missions have come since.

        Raises
        ------
        UserError
            No mission has succeeded yet.
        """
        values = self._saved_recommendation()
        if values is None:
            result = self.recommendation(save=False)
            if result is None:
                raise UserError(
                    f"{self.directory} has no successful mission yet; run or resume the campaign first"
                )
            values = result.values
        return self.settings.config(values)

    def _saved_recommendation(self) -> dict[str, Any] | None:
        """The values saved after exactly the missions there are, and flown by one of them; None without such a file."""
        history = self.history()
        failures = sum(not o.feasible for o in history)
        try:
            saved = json.loads((self.directory / RECOMMENDATION_FILE).read_text())
            counted = (saved["observations"], saved["failures"])
            values = dict(saved["values"])
        except (OSError, ValueError, KeyError, TypeError):
            return None
        flown = any(values == dict(o.values) for o in history)
        return values if flown and counted == (len(history) - failures, failures) else None

    # -- flying ----------------------------------------------------------------------------------------------

    def run(
        self,
        executor: Executor,
        on_event: Callable[[CampaignEvent], None] | None = None,
        *,
        recommend_every: int = 0,
    ) -> CampaignSummary:
        """Fly missions until the budget is used, Ctrl-C or SIGTERM; also resumes.

        Missions that were in flight when an earlier session ended are flown again under their old trial
        numbers (or entered, if they had finished). The executor is left open; missions still in flight at an
        interruption are killed. A second Ctrl-C interrupts at once.

        Parameters
        ----------
        recommend_every
            Emit a "recommendation" event (and save it) after every so many finished missions; 0: only at the end.

        Raises
        ------
        UserError
            The campaign is running elsewhere; a mission met a user's mistake (its trial stays open, so a resume
            flies it again); the ledger cannot be written.
        """
        session = _Session(self, executor, on_event or (lambda event: None), recommend_every)
        try:
            with exclusive(self.directory), stop_signals() as stop:
                try:
                    return session.fly(stop)
                finally:
                    executor.cancel_all()
        except OSError as error:
            raise UserError(
                f"cannot write to {self.directory}: {error.strerror or error}; make room, then resume"
            ) from error


class _Stopped(Exception):
    """A signal during the screening."""


class _Session:
    """One call of ``Campaign.run``."""

    def __init__(
        self,
        campaign: Campaign,
        executor: Executor,
        on_event: Callable[[CampaignEvent], None],
        recommend_every: int,
    ) -> None:
        self._campaign = campaign
        self._settings = campaign.settings
        self._ledger = campaign.ledger
        self._executor = executor
        self._on_event = on_event
        self._recommend_every = recommend_every
        self._began = time.monotonic()
        self._ask_s = 0.0
        self._finished = 0
        self._failures_in_row = 0
        self._in_flight: dict[str, TrialRecord] = {}
        self._plan: list[Proposal] | None = None  # of the confirmation stage, once the search has ended

    def fly(self, stop: threading.Event) -> CampaignSummary:
        if self._settings.low_fidelity is not None and self._campaign.screening is None:
            try:
                self._campaign.fly_screening(lambda done, total: self._screened(stop, done, total))
            except _Stopped:
                message = "the screening will be flown again by a resume"
                self._emit("interrupted", message=message)
                return self._summary("interrupted", message)
        again = self._recover()
        while True:
            if stop.is_set():
                self._executor.cancel_all()
                message = f"{len(self._in_flight)} missions in flight will be flown again by a resume"
                self._emit("interrupted", message=message)
                return self._summary("interrupted", message)
            if self._failures_in_row >= MAX_CONSECUTIVE_FAILURES:
                self._executor.cancel_all()
                last = next(t for t in reversed(self._ledger.trials()) if t.state == "failed")
                why = f" ({last.message})" if last.message else ""
                message = (
                    f"{self._failures_in_row} missions failed in a row, the last with {last.reason!r}{why}; "
                    "mend the cause, then resume"
                )
                self._emit("stopped", message=message)
                return self._summary("failing", message)
            while len(self._in_flight) < self._executor.capacity and not stop.is_set():
                trial = again.popleft() if again else self._next_trial()
                if trial is None:
                    break
                self._launch(trial)
            if not self._in_flight and not stop.is_set():
                if self._settled(self._ledger.trials()):
                    summary = self._summary("settled", self._why_settled())
                else:
                    summary = self._summary("budget", "the budget is used")
                if self._settings.second is not None:
                    self._campaign.front()
                self._emit("done", recommendation=summary.recommendation)
                return summary
            for outcome in self._executor.wait_any(_POLL_S):
                self._finish(outcome)

    def _screened(self, stop: threading.Event, done: int, total: int) -> None:
        if stop.is_set():
            raise _Stopped
        if done == total or done % _SCREENING_EVENTS == 0:
            self._emit("screening", message=f"{done} of {total} missions of the low fidelity")

    def _settled(self, trials: Sequence[TrialRecord]) -> bool:
        if not self._settings.stop_when_settled:
            return False
        from tuner.stopping import settled

        return settled([t.why for t in trials])

    def _why_settled(self) -> str:
        last = self._ledger.trials()[-1].why
        return (
            f"settled: {last['gain_left']:.3g} is expected to be left to gain, less than the "
            f"{last['comparison_noise']:.3g} that a final comparison can tell"
        )

    def _recover(self) -> collections.deque[TrialRecord]:
        """Enter missions that finished but were not told; return those to fly again."""
        trials = self._ledger.trials()
        self._finished = sum(t.state != "running" for t in trials)
        again: collections.deque[TrialRecord] = collections.deque()
        for trial in trials:
            if trial.state == "running":
                outcome = collect_outcome(self._job(trial))
                if outcome is not None and outcome.reason != "user_error":
                    self._enter(trial, outcome)
                else:
                    again.append(trial)
        return again

    def _next_trial(self) -> TrialRecord | None:
        trials = self._ledger.trials()
        if len(trials) >= self._settings.budget or self._settled(trials):
            return None
        confirming = len(trials) - self._settings.search_budget
        if confirming >= 0 and any(t.state == "running" for t in trials[: self._settings.search_budget]):
            return None  # the finalists are known when the search has ended
        known = trials
        if self._settings.in_step is not None:
            known = trials[: max(0, len(trials) + 1 - self._settings.in_step)]
            if any(t.state == "running" for t in known):
                return None  # its turn comes when they have ended
        started = time.monotonic()
        if confirming >= 0 and self._plan is None:
            self._plan = self._campaign.confirmation_plan()
        if confirming >= 0 and self._plan:
            proposal = self._plan[confirming]
        else:
            proposal = self._campaign._sampler.ask(
                self._campaign.history(known), self._ledger.pending(trials, len(known))
            )
        ask_s = time.monotonic() - started
        self._ask_s += ask_s
        rock, replicate = next_slot(self._settings.rocks, self._settings.replicates, trials, proposal)
        digest = self._settings.config(proposal.values).digest()
        trial = self._ledger.start(proposal, rock, replicate, digest, self._settings.seed)
        self._emit("proposed", trial, ask_s=ask_s)
        return trial

    def _job(self, trial: TrialRecord) -> MissionJob:
        return MissionJob(
            id=f"{trial.number:04d}",
            config=self._settings.config(trial.values),
            rock=trial.rock,
            replicate=trial.replicate,
            directory=self._campaign.directory / trial.directory,
            keep=self._settings.keep,
            runner=self._settings.runner,
        )

    def _launch(self, trial: TrialRecord) -> None:
        job = self._job(trial)
        self._executor.submit(job)
        self._in_flight[job.id] = trial
        self._emit("launched", trial)

    def _finish(self, outcome: MissionOutcome) -> None:
        trial = self._in_flight.pop(outcome.job_id)
        if outcome.reason == "user_error":
            # Every other mission would meet it too: stop, and leave the trial open for the resume.
            raise UserError(outcome.message)
        self._enter(trial, outcome)

    def _enter(self, trial: TrialRecord, outcome: MissionOutcome) -> None:
        record = self._ledger.finish(trial.number, outcome)
        self._finished += 1
        self._failures_in_row = self._failures_in_row + 1 if record.state == "failed" else 0
        self._emit("failed" if record.state == "failed" else "finished", record, message=record.message)
        if self._recommend_every and self._finished % self._recommend_every == 0:
            recommendation = self._campaign.recommendation()
            if recommendation is not None:
                self._emit("recommendation", recommendation=recommendation)

    def _summary(
        self, stopped: Literal["budget", "settled", "interrupted", "failing"], message: str
    ) -> CampaignSummary:
        return CampaignSummary(
            stopped,
            message,
            time.monotonic() - self._began,
            self._ask_s,
            self._campaign.status(),
            self._campaign.recommendation(check=True),
        )

    def _emit(
        self,
        kind: EventKind,
        trial: TrialRecord | None = None,
        *,
        recommendation: Recommendation | None = None,
        ask_s: float = 0.0,
        message: str = "",
    ) -> None:
        elapsed_s = time.monotonic() - self._began
        budget = self._settings.budget
        self._on_event(
            CampaignEvent(kind, elapsed_s, self._finished, budget, trial, recommendation, ask_s, message)
        )


# -- helpers -------------------------------------------------------------------------------------------------


def _read_settings(directory: Path) -> tuple[dict[str, Any], str, str]:
    path = directory / SETTINGS_FILE
    if not path.is_file():
        raise UserError(
            f"{directory} holds no campaign ({SETTINGS_FILE} is missing); name a campaign's directory"
        )
    try:
        tree = yaml.safe_load(path.read_text())
        if tree["format"] != FORMAT_VERSION:
            raise UserError(f"{path} has format {tree['format']}, this version reads {FORMAT_VERSION}")
        return tree["settings"], tree["id"], tree["base_config_digest"]
    except (OSError, yaml.YAMLError, KeyError, TypeError) as error:
        raise UserError(f"{path} is not a campaign's settings ({error!r}); restore the file") from error


def _first_difference(stored: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    for key in wanted:
        if stored.get(key) != wanted[key]:
            if key == "search_space":
                return f"search space {stored[key].get('name')!r} differs from {wanted[key].get('name')!r}"
            return f"{key} is {stored.get(key)!r} there, not {wanted[key]!r}"
    return ""


__all__ = [
    "Campaign",
    "CampaignEvent",
    "CampaignSettings",
    "CampaignStatus",
    "CampaignSummary",
    "Direction",
    "Keep",
]
