"""One session of a campaign: ask, run, tell, until the budget is used or somebody interrupts."""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import functools
import itertools
import shlex
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from nbv.cache import KnownOnly
from nbv.errors import MissionFailure, UserError
from tuner.campaign.campaign import Campaign, CampaignEvent, CampaignSummary, Ending, EventKind
from tuner.missions.job import MissionJob, Trial, load_trial
from tuner.missions.pool import Executor
from tuner.missions.registry import BUILT_IN, kind_on, mission_kind
from tuner.missions.run_jobs import JobList, Stop, long_run, run_jobs
from tuner.problem.observations import (
    Key,
    Proposal,
    blocks_evaluated,
    configuration_key,
    next_block,
    photographs_key,
)
from tuner.problem.search_space import Values
from tuner.recommendation.recommendation import Recommendation

# A gate that never switches makes its thresholds, and the weights of the scorer that it never asks, values of nothing: missions
# whose every photograph is in the store tell which. The trials of simplified configurations repeat others and use no budget.


def simplified(campaign: Campaign, known: dict[Any, str]) -> list[Proposal]:
    """Return what repeats the recommendations' trials with all values at their default that change no photograph of these.

    ``known``: what `known_photographs` has found in this session; what it finds now is entered.
    """
    return [each for best in _distinct(campaign).values() for each in _simplified(campaign, best, known)]


def unflown(campaign: Campaign, known: dict[Any, str]) -> list[Proposal]:
    """Return the favourites on training targets where they have not flown: all that repeat others, else the next few.

    What is recommended flies where it repeats others, too. ``known``: as in `simplified`.
    """
    trials, s = campaign.trials(), campaign.settings
    ran = blocks_evaluated(s.space, trials)
    at = {(t.instance, t.replicate): t for t in trials if t.record.status}
    favourites = _distinct(campaign, only_verified=False)
    blocks = [(key, b, t) for key, b in (_distinct(campaign) | favourites).items() for t in at.values()]
    missing = [(key, b, t) for key, b, t in blocks if (t.instance, t.replicate) not in ran[key]]
    taken = {(t.instance, t.replicate, t.record.photographs) for t in trials if t.record.photographs}
    taking = [
        (t.instance, t.replicate, known_photographs(campaign, b.values, t, known)) for _, b, t in missing
    ]
    again = [x for x, photographs in zip(missing, taking) if photographs in taken]
    left = s.budget + (s.budget // VERIFY if s.sampler == "gp" else 0) - campaign.status().finished
    new = [(key, b, t) for key, b, t in missing if key in favourites and t.replicate == 0]
    why = {"sampler": s.sampler, "phase": "verification"}
    return [
        Proposal(dict(b.values), {**why, "region": b.name}, t.instance, t.replicate)
        for _, b, t in again or new[: max(0, min(AT_ONCE, left))]
    ]


def _distinct(campaign: Campaign, *, only_verified: bool = True) -> dict[Key, Recommendation]:
    found = campaign.recommendations(save=only_verified, only_verified=only_verified).values()
    return {configuration_key(campaign.settings.space, best.values): best for best in found}


def _simplified(campaign: Campaign, best: Recommendation, known: dict[Any, str]) -> list[Proposal]:
    space, trials = campaign.settings.space, campaign.trials()
    own = [t for t in trials if t.state == "complete" and t.values == best.values]
    if best.keep_default or not own or not all(t.record.photographs for t in own):
        return []
    values, before = dict(best.values), None
    while values != before:  # one threshold may have no effect only where the other has its default
        before = values
        for paths in _parts(best.changed):
            reset = space.settled({**values, **{path: best.default_values[path] for path in paths}})
            taking = (known_photographs(campaign, reset, t, known) for t in own)
            if reset != values and all(each == t.record.photographs for each, t in zip(taking, own)):
                values = reset
    ran = blocks_evaluated(space, trials)[configuration_key(space, values)]
    metadata = {"sampler": campaign.settings.sampler, "phase": "simplified", "region": best.name}
    blocks = [(t.instance, t.replicate) for t in own]
    return [Proposal(values, metadata, *block) for block in blocks if block not in ran]


def _parts(changed: Sequence[str]) -> list[tuple[str, ...]]:
    """Return what to reset, one after the other: sections of the configuration, then single parameters."""
    sections = itertools.groupby(sorted(changed), key=lambda path: path.partition(".")[0])
    return [*(tuple(paths) for _, paths in sections), *((path,) for path in changed)]


def known_photographs(campaign: Campaign, values: Values, t: Trial, known: dict[Any, str]) -> str:
    """Return the `photographs_key` of values on a trial's block, if it repeats a mission; in a tenth of a second: nothing is computed.

    The text is empty where a model or a photograph of it has never been made here, or where the mission fails; only then the mission
    is asked again. ``known``: what was found before; what is found now is entered.
    """
    block = (configuration_key(campaign.settings.space, values), t.instance, t.replicate)
    known[block] = known.get(block) or _photographs(campaign, values, t)
    return known[block]


def _photographs(campaign: Campaign, values: Values, t: Trial) -> str:
    job = campaign.job(t, campaign.settings.problem.config(values, t.condition))
    if job.fidelity not in BUILT_IN:  # a plug-in's missions keep nothing in the store
        return ""
    run = kind_on(job.rock, job.fidelity)
    try:
        result = run(job.config, job.rock, job.replicate, None, keep="summary", cache=KnownOnly())
    except MissionFailure:
        return ""
    chosen = [step.chosen for step in result.trace]
    return "" if result.status == "failed" else photographs_key(job.config, chosen)


_LAST_EVENT: dict[Ending, EventKind] = {"failing": "stopped", "interrupted": "interrupted"}  # else done
# After so many failures in a row the set-up must be wrong, not the configurations.
MAX_CONSECUTIVE_FAILURES = 8
# Behind the budget the search's favourites fly in at most a tenth of it, two at once by what is then known.
VERIFY, AT_ONCE = 10, 2
ROUNDS = 20  # at most, in which values without effect are reset and the favourites fly
REFUSED = "configuration_refused"  # the reason of a trial whose values make no mission
# With fewer workers a proposal is made when its worker is free, knowing all that has ended; with as many or more a batch is made
# for all that are free, and for a `SHARE`th of the workers at least.
FROM_WORKERS, SHARE = 8, 4
MAX_BATCH = 256


def run_campaign(
    campaign: Campaign,
    executor: Executor,
    on_event: Callable[[CampaignEvent], None] | None = None,
    *,
    accept_changes: bool = False,
) -> CampaignSummary:
    """Run missions until the budget is used, Ctrl-C or SIGTERM; also resumes.

    Missions that were in flight when an earlier session ended are run again under their old trial numbers (or
    entered, if they had finished). The executor is left open; missions still in flight at an interruption are killed.
    The trial of an infrastructure failure (`Trial.infrastructure_failure`) stays open too.

    ``on_event`` is called in this thread. ``accept_changes``: go on where rocks or the missions' code changed since the last session.

    Raises `UserError`: the campaign is running elsewhere; rocks or the missions' code changed (`ReproducibilityCheck`); a
    mission met a user's mistake (its trial stays open, so a resume runs it again); the ledger cannot be written.
    """
    session = _Session(campaign, executor, on_event or (lambda event: None), accept_changes)
    with long_run(campaign.directory) as stop, campaign.ledger.exclusive():
        return session.run(stop)


class _Prepared(NamedTuple):
    trial: Trial
    job: MissionJob


@dataclasses.dataclass(eq=False)
class _Session:
    """One call of `run_campaign`: the `JobQueue` of its jobs."""

    campaign: Campaign
    executor: Executor
    on_event: Callable[[CampaignEvent], None]
    accept_changes: bool

    def __post_init__(self) -> None:
        campaign = self.campaign
        self._settings, self._ledger = campaign.settings, campaign.ledger
        self._began = time.monotonic()
        self._ask_s = 0.0
        self._finished = 0
        self._failed_in_row = list[Trial]()
        self._lost = list[Trial]()  # ended by the machine: their trials stay open
        self._to_retry = collections.deque[_Prepared]()
        self._in_flight: dict[str, Trial] = {}
        self._search_ended: tuple[Ending, str] = "budget", "the budget is used"
        self._taken: set[Any] = set()  # the photographs of all trials that have ended
        self._repeats = 0  # trials that took none of their own: they use no budget
        self._last = collections.deque[Proposal]()
        self._known = dict[Any, str]()
        finished = campaign.status().finished >= campaign.settings.budget
        self._reproducibility = ReproducibilityCheck(campaign, accept=self.accept_changes or finished)
        self._proposals = collections.deque[Proposal]()  # the rest of a batch

    def run(self, stop: Stop) -> CampaignSummary:
        self._stop = stop
        self._recover()
        run_jobs(self, self.executor, stop)
        for _ in range(ROUNDS):  # after one of them another configuration may be the best
            if stop.is_set() or self.cancelled or self._lost:
                break
            last = stop.computed(self._behind_the_search)
            self._last.extend(last or ())
            if not self._last:
                break
            run_jobs(self, self.executor, stop)
        if stop.is_set():
            waiting = f"{len(self._in_flight)} missions in flight will be run again by a resume"
            return self._end("interrupted", waiting)
        if self.cancelled:
            return self._end(
                "failing",
                f"{len(self._failed_in_row)} missions failed in a row, the last with {_reason(self._failed_in_row[-1])}; "
                "mend the cause, then resume",
            )
        if self._lost:
            return self._end(
                "failing",
                f"{len(self._lost)} missions were ended by the machine, the last with {_reason(self._lost[-1])}; they are "
                "not counted, and run again by a resume",
            )
        return self._end(*self._search_ended)

    def _behind_the_search(self) -> list[Proposal]:
        return simplified(self.campaign, self._known) or unflown(self.campaign, self._known)

    def _end(self, stopped: Ending, message: str) -> CampaignSummary:
        # Who interrupts waits for the prompt: no recommendation is made.
        best = None if stopped == "interrupted" else self.campaign.recommendation()
        event, said = _LAST_EVENT.get(stopped, "done"), "" if stopped == "budget" else message
        self._emit(event, recommendation=best, message=said)
        elapsed_s = time.monotonic() - self._began
        return CampaignSummary(stopped, message, elapsed_s, self._ask_s, self.campaign.status(), best)

    def _recover(self) -> None:
        """Enter missions that finished without being in the ledger; the others are run again."""
        trials = self._ledger.trials()
        for trial in trials:
            if trial.record.status:
                self._repeats_photographs(trial)
        for trial in trials:
            if trial.record.status:
                continue
            try:
                config = self._settings.problem.config(trial.values, trial.condition)
            except UserError as error:
                self._count(self._refuse(trial, error))
                continue
            job = self.campaign.job(trial, config)
            ended = load_trial(job)
            if (
                ended is None
                or not ended.is_final
                or self._reproducibility.is_another(trial, ended.record.rock_sha256)  # it was replaced since
            ):
                self._to_retry.append(_Prepared(trial, job))
            else:
                self._count(self._enter(trial, ended))

    @property
    def cancelled(self) -> bool:
        return len(self._failed_in_row) >= MAX_CONSECUTIVE_FAILURES

    def next_jobs(self, free: int) -> list[MissionJob]:
        """Return the next mission to launch, which is in the ledger."""
        while not self._stop.is_set():
            upcoming = self._to_retry.popleft() if self._to_retry else self._next_trial(free)
            if upcoming is None:
                break
            if isinstance(upcoming, _Prepared):
                self._in_flight[upcoming.job.id] = upcoming.trial
                return [upcoming.job]
            self._count(upcoming)  # refused by the configuration: a failure for which nothing ran
        return []

    def launched(self, job: MissionJob) -> None:
        self._emit("launched", self._in_flight[job.id])

    def ended(self, trials: Sequence[Trial]) -> None:
        """Enter the missions that have ended and count them: only what is on disk counts."""
        for ended in trials:
            trial = self._in_flight.pop(ended.record.job_id)
            if ended.infrastructure_failure:  # the trial stays open: neither counted nor learned from
                self._lost.append(ended)
                self._failed_in_row.append(ended)
                self._emit("lost", trial, message=f"{ended.reason}: {ended.record.message}")
            else:
                self._count(self._enter(trial, ended))

    def _next_trial(self, free: int) -> _Prepared | Trial | None:
        """Enter the next proposal and return its trial with its job; the trial alone where the configuration is refused.

        ``free``: workers without a mission.
        """
        trials, in_step = self._ledger.trials(), self._settings.in_step
        left = self._settings.budget + self._repeats - len(trials)
        started = time.monotonic()
        if self._last:
            proposal: Proposal | None = self._last.popleft()
        elif left <= 0 or (why := self.campaign.exhausted(trials)):
            self._search_ended = ("budget", "the budget is used") if left <= 0 else ("exhausted", why)
            return None
        else:
            known = len(trials) if in_step is None else max(0, len(trials) + 1 - in_step)
            if in_step is not None and not all(t.record.status for t in trials[:known]):
                return None  # its turn comes when they have ended
            if not self._proposals:
                count = 1
                if in_step is None and self.executor.capacity >= FROM_WORKERS:
                    count = min(max(free, self.executor.capacity // SHARE), MAX_BATCH, left)
                batch = self._stop.computed(lambda: self.campaign.propose(trials, known, count))
                self._proposals.extend(batch or ())
            proposal = self._proposals.popleft() if self._proposals else None
            self._ask_s += time.monotonic() - started
        if proposal is None:
            return None
        problem = self._settings.problem
        instance, replicate = next_block(problem.instances, problem.replicates, trials, proposal)
        enter = functools.partial(
            self._ledger.start, proposal, instance, replicate, self._reproducibility.code
        )
        try:
            config = self._settings.problem.config(proposal.values, instance.condition)
        except UserError as error:  # some values exclude one another
            return self._refuse(enter(), error)
        trial = enter(config.digest())
        return _Prepared(trial, self.campaign.job(trial, config))

    def _refuse(self, trial: Trial, why: UserError) -> Trial:
        """Enter a proposal without a configuration as infeasible: samplers learn from it, and nothing runs."""
        record = dataclasses.replace(trial.record, status="failed", message=str(why))
        return self._ledger.finish(trial.number, dataclasses.replace(trial, reason=REFUSED, record=record))

    def _enter(self, trial: Trial, ended: Trial) -> Trial:
        self._reproducibility.require(trial, ended.record.rock_sha256)
        return self._ledger.finish(trial.number, ended)

    def _repeats_photographs(self, trial: Trial) -> bool:
        """Count a trial that has ended; return whether it took the photographs of an earlier one, and so used no budget."""
        repeats = bool(trial.record.photographs) and trial.photographs_taken in self._taken
        self._taken.add(trial.photographs_taken)
        self._repeats += repeats
        self._finished += not repeats
        return repeats

    def _count(self, trial: Trial) -> None:
        if self._repeats_photographs(trial):
            self._emit("finished", trial, message="repeats the photographs of an earlier trial")
            return
        if trial.state == "failed":
            if trial.reason != REFUSED:
                self._failed_in_row.append(trial)
            self._emit("failed", trial, message=trial.record.message)
        else:
            self._failed_in_row.clear()
            self._emit("finished", trial, message=trial.record.message)

    def _emit(
        self,
        kind: EventKind,
        trial: Trial | None = None,
        *,
        recommendation: Recommendation | None = None,
        message: str = "",
    ) -> None:
        elapsed_s, budget = time.monotonic() - self._began, max(self._settings.budget, self._finished)
        self.on_event(CampaignEvent(kind, elapsed_s, self._finished, budget, trial, recommendation, message))


def _reason(failed: Trial) -> str:
    """Return ``'timeout' (after 60 s)``: why a mission failed, in code and in words."""
    message = failed.record.message
    return f"{failed.reason!r} ({message})" if message else f"{failed.reason!r}"


class ReproducibilityCheck:
    """Compares the code and the rocks of a session's missions with those of ``campaign`` before it.

    Every trial carries the digest of the code that runs it and, once it has ended, its rock's content hash. Where one differs
    from the last trial of its kind the session stops and asks, so that no ledger mixes two experiments unnoticed. ``accept``:
    changes since then are wanted.
    """

    def __init__(self, campaign: Campaign, *, accept: bool) -> None:
        self._directory, self._accept = campaign.directory, accept
        self._rocks: dict[str, tuple[str, int]] = {}
        self.code = campaign.settings.problem.code()
        if accept:
            return
        trials = campaign.trials()
        known = [t for t in trials if t.record.code]
        if known and known[-1].record.code != self.code:
            self._ask(f"the code of its missions changed after trial {known[-1].number}")
        for trial in trials:
            self._remember(trial, trial.record.rock_sha256)

    def require(self, trial: Trial, rock_sha256: str) -> None:
        """Raise `UserError` where the mission of ``trial`` met another rock than those before it under that name."""
        if self.is_another(trial, rock_sha256):
            before, number = self._rocks[trial.rock]
            self._ask(
                f"rock {trial.rock} is another one since trial {number} (content {before[:12]} then, {rock_sha256[:12]} now)"
            )
        self._remember(trial, rock_sha256)

    def is_another(self, trial: Trial, rock_sha256: str) -> bool:
        return (
            not self._accept
            and bool(rock_sha256)
            and self._rocks.get(trial.rock, (rock_sha256, 0))[0] != rock_sha256
        )

    def _remember(self, trial: Trial, sha256: str) -> None:
        if sha256:
            self._rocks[trial.rock] = (sha256, trial.number)

    def _ask(self, what: str) -> None:
        raise UserError(
            f"{what}: its ledger would mix two kinds of missions; restore what it was, or go on all the same with "
            f"`gatetune campaign resume {shlex.quote(str(self._directory))} --accept-changes`"
        )


# The showcase runs the default and the tuned mission once more and keeps all their files, for pages and pictures.


SHOWN = "shown"  # in a campaign's directory


def showcase_jobs(campaign: Campaign) -> list[MissionJob]:
    """Return both missions on the campaign's first rock, in ``RUN/shown/``; one where both are the same.

    The list is empty without a recommendation, and where missions leave nothing that a page shows.
    """
    s, best = campaign.settings, campaign.recommendation(save=False)
    if best is None or not mission_kind(s.fidelity).uses_catalogue:
        return []
    problem = s.problem
    instance = problem.instances[0]
    jobs: dict[str, MissionJob] = {}
    for name, values in (("default", best.default_values), (best.name, best.values)):
        config = problem.config(values, instance.condition)
        folder = campaign.directory / SHOWN / name
        job = MissionJob(f"{SHOWN}-{name}", config, instance.rock, 0, folder, "all", s.fidelity)
        jobs.setdefault(config.digest(), job)
    return list(jobs.values())


def run_showcase(campaign: Campaign, executor: Executor) -> None:
    """Run those of `showcase_jobs` that have not run yet; one that fails is left out of the pages."""
    with contextlib.suppress(UserError):
        run_jobs(JobList(showcase_jobs(campaign)), executor, Stop())


def was_run(job: MissionJob) -> bool:
    """Return whether the job's directory holds a finished mission of the job's configuration."""
    trial = load_trial(job)
    return trial is not None and trial.record.status != "failed"
