"""The campaign's one ledger: an Optuna study in which every trial is one mission.

Parameters of a trial are the tuned ones only; rock, condition, replicate, costs, metrics and the reason for the proposal
are user attributes, so that Optuna's importances and dashboards see what was tuned and nothing else. A trial
is created running in one write, gets its attributes while it runs, and is told once; finished trials are
never touched again. A failed mission is a trial in state FAIL, without a value.
"""

from __future__ import annotations

import contextlib
import datetime
import functools
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeVar

import optuna
from optuna.trial import TrialState, create_trial

from nbv.checksums import checksum_of
from nbv.config import IDEAL
from nbv.errors import UserError
from tuner.campaign.coordinator_lock import coordinator_lock
from tuner.campaign.storage import (
    JOURNAL_FILE,
    Journal,
    journal_path,
    one_writer,
    open_storage,
    patiently,
    reachable,
)
from tuner.campaign.trial_checksums import (
    ENDED,
    ENTERED,
    ending_checksum,
    entry_checksum,
    require_all_there,
    require_trial,
)
from tuner.missions.job import MissionOutcome
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation, Pending, Proposal
from tuner.problem.search_space import SearchSpace
from tuner.problem.worlds import World
from tuner.samplers.distributions import distributions

T = TypeVar("T")
_CAMPAIGN_ID, _FILES = "campaign_id", "files"


def kept_files(storage: str, name: str, directory: Path) -> dict[str, str]:
    """Return what `Ledger.keep_files` kept of the campaign ``name``; ``UserError`` where the database has no such campaign."""
    try:
        study = optuna.load_study(study_name=name, storage=open_storage(storage, directory, must_exist=True))
        return dict(study.user_attrs[_FILES])
    except KeyError as error:
        raise UserError(
            f"that ledger has no campaign {name!r} to go on with; name the directory after it"
        ) from error


@dataclass(frozen=True)
class TrialRecord:
    """One mission as the ledger knows it."""

    number: int
    state: Literal["running", "complete", "failed"]
    values: dict[str, Any]  # tuned parameters
    rock: str
    replicate: int
    directory: str  # of the mission, relative to the run directory
    why: dict[str, Any]  # who proposed it and for what reason
    sampler_state: dict[str, Any]
    raw: float | None  # the metric as measured; None while running and when failed
    status: str = ""  # the mission's: ok, degraded, failed; empty while running
    reason: str = ""
    message: str = ""
    metrics: dict[str, Any] = field(default_factory=dict)
    costs: dict[str, Any] = field(default_factory=dict)
    timings_s: dict[str, Any] = field(default_factory=dict)
    wall_s: float = 0.0
    config_digest: str = ""
    started: datetime.datetime | None = None
    finished: datetime.datetime | None = None
    condition: str = IDEAL
    code: str = (
        ""  # digest of what flies it, see `tuner.campaign.reproducibility_check`; empty in ledgers of before
    )
    rock_sha256: str = ""  # of the rock that was flown; empty while running, and where no mission said so

    def __repr__(self) -> str:
        """``TrialRecord(12: complete, 94.57 on slab r1)``."""
        found = self.reason if self.raw is None else f"{self.raw:.4g}"
        return f"TrialRecord({self.number}: {self.state}, {found} on {self.world.label} r{self.replicate})"

    @functools.cached_property
    def world(self) -> World:
        """The world in which it flies."""
        return World(self.rock, self.condition)

    def measured(self, objective: Objective) -> float | None:
        """An objective's metric, perhaps another than the campaign's; None while flying, where it failed or has none."""
        return (
            objective.outcome(self.status, {**self.metrics, "costs": self.costs})[0]
            if self.state == "complete"
            else None
        )


class Ledger:
    """Opens (or creates) the study of one campaign.

    Parameters
    ----------
    directory
        The campaign's run directory, which holds the default storage.
    storage
        None for ``study.journal`` in ``directory``; otherwise an Optuna storage: an SQLAlchemy URL such as
        ``sqlite:///missions.db``, or ``journal:PATH``.
    study_name, campaign_id
        The study's name, and the identity that tells it from another campaign of the same name.
    space, objective
        What is tuned and for what.
    create
        Make a new study; it must not exist. Otherwise it must exist and belong to ``campaign_id``.
    read_only
        Only look: leave the files of a campaign that may be running alone.

    Raises
    ------
    UserError
        Unknown or unreachable storage, missing study, or a study of another campaign.
    """

    def __init__(
        self,
        directory: Path,
        storage: str | None,
        study_name: str,
        campaign_id: str,
        space: SearchSpace,
        objective: Objective,
        *,
        create: bool = False,
        read_only: bool = False,
    ) -> None:
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self._space = space
        self._objective = objective
        self._distributions = distributions(space)
        self._known: dict[int, tuple[optuna.trial.FrozenTrial, TrialRecord]] = {}
        self.pause: Callable[[float], bool] = threading.Event().wait  # for a database that is away
        self._alone = False  # while nobody else may write, what is known is all there is
        self._campaign_id = campaign_id
        self._journal = journal_path(storage, directory)
        self._shown = shown = storage or str(directory / JOURNAL_FILE)
        # A campaign that was killed before its first mission may not have a ledger yet, or half of one.
        begun = not create and (read_only or (directory / "missions").exists())
        self._storage = open_storage(storage, directory, must_exist=begun, heal=not read_only)
        identity = {
            "metric": objective.metric,
            "search_space": space.to_dict(),
            _CAMPAIGN_ID: campaign_id,  # the last: without it the study is half made
        }
        try:
            with reachable(shown):
                self._study = self._open_study(study_name, create=create, begun=begun)
                self._study_id = self._storage.get_study_id_from_name(study_name)
                found = self._study.user_attrs
                if create or (not begun and _CAMPAIGN_ID not in found and not self._study.get_trials()):
                    for key, content in identity.items():
                        self._study.set_user_attr(key, content)
                    found = self._study.user_attrs
        except optuna.exceptions.DuplicatedStudyError as error:
            raise UserError(
                f"{shown} already holds a study {study_name!r}; choose another campaign name or storage"
            ) from error
        except KeyError as error:
            raise UserError(
                f"{shown} holds no study {study_name!r}; the ledger was moved or never made: "
                "restore it, or start a new campaign"
            ) from error
        if found.get(_CAMPAIGN_ID) != campaign_id:
            raise UserError(
                f"the study {study_name!r} in {shown} belongs to another campaign; "
                "choose another name or storage"
            )
        for key, content in identity.items():
            if key in found and checksum_of(found[key]) != checksum_of(content):
                raise UserError(
                    f"the ledger {shown} has another {key.replace('_', ' ')} than the campaign's settings: one of them was "
                    "changed; restore it from a copy"
                )
        if not create:
            require_all_there(lambda: len(self.trials()), directory, shown)
        engine = getattr(self._storage, "engine", None)
        self._lock = None if engine is None else coordinator_lock(engine, study_name)

    def _open_study(self, name: str, *, create: bool, begun: bool) -> optuna.Study:
        try:
            if not create:
                return optuna.load_study(study_name=name, storage=self._storage)
        except KeyError:
            if begun:
                raise
        direction = "maximize" if self._objective.direction == "maximise" else "minimize"
        return optuna.create_study(study_name=name, storage=self._storage, direction=direction)

    # -- writing ---------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def exclusive(self) -> Iterator[None]:
        """Hold the ledger while this campaign flies; ``UserError`` where another coordinator does.

        A journal is for one campaign; a database for several, each with one coordinator, on whatever machine.
        """
        if self._journal is not None:
            held: contextlib.AbstractContextManager[None] = one_writer(self._journal)
        else:
            held = contextlib.nullcontext() if self._lock is None else self._lock.held()
        with held:
            self.trials()
            self._alone = True
            try:
                yield
            finally:
                self._alone = False

    @contextlib.contextmanager
    def together(self) -> Iterator[None]:
        """Enter several missions, or their ends, in one synchronised write, which happens when the context ends.

        A database takes them one by one.
        """
        storage = self._storage
        with (
            reachable(self._shown),
            storage.together() if isinstance(storage, Journal) else contextlib.nullcontext(),
        ):
            yield

    def start(
        self,
        proposal: Proposal,
        world: World,
        replicate: int,
        config_digest: str,
        seed: int,
        code: str = "",
    ) -> TrialRecord:
        """Enter a mission that is about to fly, in one write.

        Parameters
        ----------
        proposal
            What the sampler asked for.
        world, replicate
            The block on which it flies.
        config_digest
            The digest of the complete configuration.
        seed
            The campaign's seed.
        code
            The digest of the code that flies it (`tuner.campaign.reproducibility_check`).
        """
        number = len(self.trials())
        attributes = {
            "rock": world.rock,
            "condition": world.condition,
            "replicate": replicate,
            "seed": seed,
            "config_digest": config_digest,
            "directory": mission_directory(number, world, replicate),
            "why": proposal.why,
            "code": code,
        }
        if proposal.sampler_state:
            attributes["memory"] = proposal.sampler_state
        attributes[ENTERED] = entry_checksum(self._campaign_id, number, proposal.values, attributes)
        trial = create_trial(
            state=TrialState.RUNNING,
            params=dict(proposal.values),
            distributions=self._distributions,
            user_attrs=attributes,
        )

        def enter(again: bool) -> int:
            self._require_ours()
            known = self._storage.get_all_trials(self._study_id, deepcopy=False) if again else []
            if len(known) == number + 1 and known[-1].user_attrs.get(ENTERED) == attributes[ENTERED]:
                return known[-1]._trial_id  # the answer to the first try was lost
            return self._storage.create_new_trial(self._study_id, trial)

        record = self._record(self._read_back(self._patiently(enter)))
        if record.number != number or record.directory != attributes["directory"]:
            raise UserError("another process writes to this campaign's study; let only one run at a time")
        return record

    def finish(self, number: int, outcome: MissionOutcome) -> TrialRecord:
        """Enter how a mission ended; once per mission."""
        self._patiently(lambda _: self._require_ours())
        self.trials()
        frozen = self._known[number][0]
        if frozen.state.is_finished():
            raise ValueError(f"trial {number} is finished already")
        value, why_not = self._objective.outcome(outcome.status, {**outcome.metrics, "costs": outcome.costs})
        attributes = {
            "status": outcome.status,
            "reason": outcome.reason or (why_not if value is None else ""),
            "message": outcome.message,
            "metrics": outcome.metrics,
            "costs": outcome.costs,
            "timings_s": outcome.timings_s,
            "wall_s": round(outcome.wall_s, 3),
            "feasible": value is not None,
            "rock_sha256": outcome.rock_sha256,
        }
        if ENTERED in frozen.user_attrs:
            attributes[ENDED] = ending_checksum(frozen.user_attrs[ENTERED], value, attributes)
        state, values = (TrialState.FAIL, None) if value is None else (TrialState.COMPLETE, [value])

        def end(again: bool) -> None:
            self._require_ours()
            if again and self._storage.get_trial(frozen._trial_id).state.is_finished():
                return  # the answer to the first try was lost
            with self.together():
                for key, content in attributes.items():  # before its state: finished trials are frozen
                    self._storage.set_trial_user_attr(frozen._trial_id, key, content)
                self._storage.set_trial_state_values(frozen._trial_id, state, values)

        self._patiently(end)
        return self._record(self._read_back(frozen._trial_id))

    def _require_ours(self) -> None:
        if self._lock is not None:
            self._lock.require()

    def _read_back(self, trial_id: int) -> optuna.trial.FrozenTrial:
        return self._patiently(lambda _: self._storage.get_trial(trial_id))

    def _patiently(self, step: Callable[[bool], T]) -> T:
        return patiently(self._shown, step, self.pause)

    def keep_files(self, files: Mapping[str, str]) -> None:
        """Keep these of the run directory's files beside the missions of a database, for a coordinator on another machine."""
        if self._lock is not None:
            with reachable(self._shown):
                self._study.set_user_attr(_FILES, {**self._study.user_attrs.get(_FILES, {}), **files})

    # -- reading ---------------------------------------------------------------------------------------------

    def trials(self) -> list[TrialRecord]:
        """All missions in trial order."""
        if self._alone:
            return [record for _, record in self._known.values()]
        found = self._patiently(lambda _: self._study.get_trials(deepcopy=False))
        return [self._record(trial) for trial in found]

    def _record(self, trial: optuna.trial.FrozenTrial) -> TrialRecord:
        """Return the trial as a record; finished trials never change, so theirs are kept."""
        known = self._known.get(trial.number)
        if known is None or (known[0] is not trial and known[1].state == "running"):
            require_trial(trial, self._campaign_id, self._shown)
            trial.distributions = self._distributions  # the same of all: kept once
            known = self._known[trial.number] = (trial, _record(trial))
        return known[1]

    def history(self, trials: Sequence[TrialRecord] | None = None) -> list[Observation]:
        """Return the finished missions as the samplers and the surrogate see them."""
        sign = self._objective.sign
        return [
            Observation(
                t.number,
                t.values,
                t.rock,
                t.replicate,
                None if t.raw is None else sign * t.raw,
                t.raw,
                t.reason,
                t.sampler_state,
                condition=t.condition,
            )
            for t in (self.trials() if trials is None else trials)
            if t.state != "running"
        ]

    def pending(self, trials: Sequence[TrialRecord], known: int) -> list[Pending]:
        """Return missions in flight, and all after the first ``known``, which count as if they were."""
        return [
            Pending(t.number, t.values, t.rock, t.replicate, t.sampler_state, t.condition)
            for i, t in enumerate(trials)
            if t.state == "running" or i >= known
        ]


def mission_directory(number: int, world: World, replicate: int) -> str:
    """Return a mission's directory, relative to the run directory: ``missions/0007_boulder-a_r1``, ``..._boulder-a_field_r1``."""
    return f"missions/{number:04d}_{world.file_name}_r{replicate}"


def _record(trial: optuna.trial.FrozenTrial) -> TrialRecord:
    states: Mapping[TrialState, Literal["running", "complete", "failed"]] = {
        TrialState.RUNNING: "running",
        TrialState.COMPLETE: "complete",
        TrialState.FAIL: "failed",
    }
    a = trial.user_attrs
    if trial.state not in states or "rock" not in a:
        raise UserError(
            f"trial {trial.number} of this campaign's study was not entered by gatetune; "
            "do not add trials to it by hand"
        )
    return TrialRecord(
        number=trial.number,
        state=states[trial.state],
        values=dict(trial.params),
        rock=a["rock"],
        replicate=a["replicate"],
        directory=a["directory"],
        why=a["why"],
        sampler_state=a.get("memory", {}),
        raw=trial.value if trial.state == TrialState.COMPLETE else None,
        status=a.get("status", "") if trial.state != TrialState.RUNNING else "",
        reason=a.get("reason", ""),
        message=a.get("message", ""),
        metrics=a.get("metrics", {}),
        costs=a.get("costs", {}),
        timings_s=a.get("timings_s", {}),
        wall_s=a.get("wall_s", 0.0),
        config_digest=a.get("config_digest", ""),
        started=trial.datetime_start,
        finished=trial.datetime_complete,
        condition=a.get("condition", IDEAL),  # ledgers of before there were conditions
        code=a.get("code", ""),
        rock_sha256=a.get("rock_sha256", ""),
    )
