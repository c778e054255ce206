"""One session of a campaign: ask, fly, tell, until the budget is used or somebody interrupts."""

from __future__ import annotations

import collections
import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Literal

from nbv.errors import UserError
from tuner.campaign.campaign import Campaign
from tuner.campaign.events import CampaignEvent, CampaignSummary, EventKind
from tuner.campaign.ledger import TrialRecord
from tuner.campaign.prefetch import FROM_WORKERS, ProposalPrefetch
from tuner.campaign.reproducibility_check import ReproducibilityCheck
from tuner.campaign.storage import DATABASE_ERRORS
from tuner.missions.executors import Executor
from tuner.missions.external.trust import trust
from tuner.missions.job import MissionJob, MissionOutcome, collect_outcome
from tuner.missions.long_runs import Stop, exclusive, stop_signals
from tuner.problem.blocks import next_block
from tuner.problem.objective import dotted
from tuner.problem.observations import Proposal
from tuner.problem.search_space import Configuration
from tuner.recommendation.recommendation import Recommendation

# So many failures in a row mean that something is wrong with the set-up, not with the configurations.
MAX_CONSECUTIVE_FAILURES = 8
_POLL_S = 0.5
_TOGETHER = 32  # missions entered in one write at most: the first of them waits for the others


def fly_campaign(
    campaign: Campaign,
    executor: Executor,
    on_event: Callable[[CampaignEvent], None] | None = None,
    *,
    recommend_every: int = 0,
    accept_changes: bool = False,
) -> CampaignSummary:
    """Fly missions until the budget is used, Ctrl-C or SIGTERM; also resumes.

    Missions that were in flight when an earlier session ended are flown again under their old trial numbers (or
    entered, if they had finished). The executor is left open; missions still in flight at an interruption are killed.
    A stop waits for no proposal or recommendation, and a second Ctrl-C interrupts at once. The trial of an infrastructure
    failure (`MissionOutcome.infrastructure_failure`) stays open too.

    Parameters
    ----------
    campaign
        The campaign to go on with.
    executor
        Flies the missions, at most its ``capacity`` at a time.
    on_event
        Is called with everything that happens, in this thread.
    recommend_every
        Emit a "recommendation" event (and save it, brief) after every so many finished missions; 0: only at the end.
    accept_changes
        Go on where rocks or the missions' code changed since the last session.

    Raises
    ------
    UserError
        The campaign is running elsewhere; rocks or the missions' code changed (`tuner.campaign.reproducibility_check`); a
        mission met a user's mistake (its trial stays open, so a resume flies it again); the ledger cannot be written.
    """
    session = _Session(campaign, executor, on_event or (lambda event: None), recommend_every, accept_changes)
    try:
        with exclusive(campaign.directory), campaign.ledger.exclusive(), stop_signals() as stop:
            try:
                return session.fly(stop)
            finally:
                executor.cancel_all()
                session.prefetch.close()
    except DATABASE_ERRORS as error:
        cause = str(error.__cause__ or error).strip().partition("\n")[0]
        raise UserError(
            f"the ledger's database does not answer ({cause}); mend it, then resume: finished missions are kept"
        ) from error
    except OSError as error:
        raise UserError(
            f"cannot write to {campaign.directory}: {error.strerror or error}; make room, then resume"
        ) from error


class _Session:
    """One call of `fly_campaign`."""

    def __init__(
        self,
        campaign: Campaign,
        executor: Executor,
        on_event: Callable[[CampaignEvent], None],
        recommend_every: int,
        accept_changes: bool,
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
        self._last_failure = ""
        self._infrastructure_failures, self._last_infrastructure_failure = 0, ""  # their trials stay open
        self._in_flight: dict[str, TrialRecord] = {}
        self._configs: dict[int, Configuration] = {}  # of trials entered and not launched yet
        finished, mission = campaign.status().finished >= campaign.settings.budget, campaign.settings.mission
        self._reproducibility = ReproducibilityCheck(
            campaign.directory,
            campaign.settings.fidelity,
            campaign.trials(),
            accept=accept_changes or finished,
            program="" if mission is None else mission.program,
        )
        if mission is not None and not finished:
            trust(campaign.identity, mission)
        self.prefetch = ProposalPrefetch(campaign)

    def fly(self, stop: Stop) -> CampaignSummary:
        self._stop, self._ledger.pause = stop, stop.wait
        to_retry = self._recover()
        while True:
            if stop.is_set():
                self._executor.cancel_all()
                message = f"{len(self._in_flight)} missions in flight will be flown again by a resume"
                self._emit("interrupted", message=message)
                return self._summary("interrupted", message)
            if self._failures_in_row >= MAX_CONSECUTIVE_FAILURES:
                self._executor.cancel_all()
                message = (
                    f"{self._failures_in_row} missions failed in a row, the last with {self._last_failure}; "
                    "mend the cause, then resume"
                )
                self._emit("stopped", message=message)
                return self._summary("failing", message)
            while batch := self._next_trials(to_retry, stop):
                for trial in batch:
                    self._launch(trial)
            if not self._in_flight and self.prefetch.thinking:
                self.prefetch.wait(_POLL_S)
                continue
            if not self._in_flight and not stop.is_set():
                if self._infrastructure_failures:
                    message = (
                        f"{self._infrastructure_failures} missions were ended by the machine, the last with "
                        f"{self._last_infrastructure_failure}; they are not counted, and flown again by a resume"
                    )
                    self._emit("stopped", message=message)
                    return self._summary("failing", message)
                summary = self._summary("budget", "the budget is used")
                self._emit("done", recommendation=summary.recommendation)
                return summary
            free = self.prefetch.thinking and len(self._in_flight) < self._executor.capacity
            self._land(self._executor.wait_any(_POLL_S / 10 if free else _POLL_S))

    def _recover(self) -> collections.deque[TrialRecord]:
        """Enter missions that finished without being in the ledger; return those to fly again."""
        trials = self._ledger.trials()
        self._finished = sum(t.state != "running" for t in trials)
        to_retry: collections.deque[TrialRecord] = collections.deque()
        for trial in trials:
            if trial.state == "running":
                outcome = collect_outcome(self._job(trial))
                if (
                    outcome is not None
                    and outcome.reason != "user_error"
                    and not self._is_void(trial, outcome)
                ):
                    self._count(self._enter(trial, self._with_asked_parameters(trial, outcome)))
                else:
                    to_retry.append(trial)
        self._reproducibility.begin()
        return to_retry

    def _is_void(self, trial: TrialRecord, outcome: MissionOutcome) -> bool:
        """Whether the outcome does not count: an infrastructure failure, or a mesh that has been replaced since."""
        return outcome.infrastructure_failure or self._reproducibility.is_another(trial, outcome.rock_sha256)

    def _next_trials(self, to_retry: collections.deque[TrialRecord], stop: Stop) -> list[TrialRecord]:
        """Return the next missions to launch, entered in one write: several where proposals are prefetched."""
        batch: list[TrialRecord] = []
        with self._ledger.together():
            while len(batch) < (_TOGETHER if self._prefetches else 1) and not stop.is_set():
                if len(self._in_flight) + len(batch) >= self._executor.capacity:
                    break
                trial = to_retry.popleft() if to_retry else self._next_trial()
                if trial is None:
                    break
                batch.append(trial)
        return batch

    @property
    def _prefetches(self) -> bool:
        return self._settings.in_step is None and self._executor.capacity >= FROM_WORKERS

    def _next_trial(self) -> TrialRecord | None:
        trials = self._ledger.trials()
        if len(trials) >= self._settings.budget:
            return None
        known = trials
        if self._prefetches:
            started = time.monotonic()
            ready = self.prefetch.next(trials, self._executor.capacity)
            return None if ready is None else self._start(trials, ready, time.monotonic() - started)
        if self._settings.in_step is not None:
            known = trials[: max(0, len(trials) + 1 - self._settings.in_step)]
            if any(t.state == "running" for t in known):
                return None  # its turn comes when they have ended
        started = time.monotonic()
        proposal = self._stop.computed(lambda: self._campaign.propose(trials, len(known)))
        if proposal is None:
            return None
        ask_s = time.monotonic() - started
        self._ask_s += ask_s
        return self._start(trials, proposal, ask_s)

    def _start(self, trials: Sequence[TrialRecord], proposal: Proposal, ask_s: float) -> TrialRecord:
        world, replicate = next_block(self._settings.worlds, self._settings.blocks, trials, proposal)
        config = self._settings.config(proposal.values, world.condition)
        trial = self._ledger.start(
            proposal, world, replicate, config.digest(), self._settings.seed, self._reproducibility.code
        )
        self._configs[trial.number] = config
        self._emit("proposed", trial, ask_s=ask_s)
        return trial

    def _job(self, trial: TrialRecord, config: Configuration | None = None) -> MissionJob:
        return MissionJob(
            id=f"{trial.number:04d}",
            config=config or self._settings.config(trial.values, trial.condition),
            rock=self._settings.rock_flown(trial.rock, trial.replicate),
            replicate=trial.replicate,
            directory=self._campaign.directory / trial.directory,
            keep=self._settings.keep,
            fidelity=self._settings.fidelity,
        )

    def _launch(self, trial: TrialRecord) -> None:
        job = self._job(trial, self._configs.pop(trial.number, None))
        self._executor.submit(job)
        self._in_flight[job.id] = trial
        self._emit("launched", trial)

    def _land(self, outcomes: Sequence[MissionOutcome]) -> None:
        """Enter all outcomes that have arrived, then count them: only what is on disk counts."""
        with self._ledger.together():
            records = [record for outcome in outcomes if (record := self._finish(outcome)) is not None]
        for record in records:
            self._count(record)

    def _finish(self, outcome: MissionOutcome) -> TrialRecord | None:
        trial = self._in_flight.pop(outcome.job_id)
        if outcome.reason == "user_error":
            # Every other mission would meet it too: stop, and leave the trial open for the resume.
            raise UserError(outcome.message)
        if outcome.infrastructure_failure:  # the trial stays open: neither counted nor learned from
            self._infrastructure_failures += 1
            self._note_failure(outcome.reason, outcome.message)
            self._last_infrastructure_failure = self._last_failure
            self._emit("lost", trial, message=f"{outcome.reason}: {outcome.message}")
            return None
        outcome = self._with_asked_parameters(trial, outcome)
        self._require_metric(outcome)
        return self._enter(trial, outcome)

    def _with_asked_parameters(self, trial: TrialRecord, outcome: MissionOutcome) -> MissionOutcome:
        """The outcome with those parameters of a mission file among its costs that an objective names and it left out."""
        s = self._settings
        if s.mission is None or outcome.status == "failed":
            return outcome
        names = [o.metric.removeprefix("costs.") for o in (s.objective, s.second) if o is not None]
        numbers = {p.path for p in s.space.parameters if p.kind != "categorical"}
        asked = {name: float(trial.values[name]) for name in names if name in numbers}
        return dataclasses.replace(outcome, costs={**asked, **outcome.costs})

    def _note_failure(self, reason: str, message: str) -> None:
        self._failures_in_row += 1
        self._last_failure = f"{reason!r} ({message})" if message else repr(reason)

    def _require_metric(self, outcome: MissionOutcome) -> None:
        """Raise `UserError` where the first missions of a mission file end well without the objective's metric."""
        mission, measured = self._settings.mission, {**outcome.metrics, "costs": outcome.costs}
        asked = [o for o in (self._settings.objective, self._settings.second) if o is not None]
        missing = [o.metric for o in asked if o.measure(measured) is None]
        if mission is None or outcome.status == "failed" or not missing:
            return
        if not any(t.state == "complete" for t in self._ledger.trials()):
            there = ", ".join(dotted(measured)) or "none"
            raise UserError(
                f"{mission.path}: a mission ended without metric {missing[0]!r}, which it is tuned for; it has {there}"
            )

    def _enter(self, trial: TrialRecord, outcome: MissionOutcome) -> TrialRecord:
        self._reproducibility.require(trial, outcome.rock_sha256)
        return self._ledger.finish(trial.number, outcome)

    def _count(self, record: TrialRecord) -> None:
        self._finished += 1
        if record.state == "failed":
            self._note_failure(record.reason, record.message)
        else:
            self._failures_in_row = 0
        self._emit("failed" if record.state == "failed" else "finished", record, message=record.message)
        last = self._finished >= self._settings.budget  # whose recommendation the summary has
        if self._recommend_every and self._finished % self._recommend_every == 0 and not last:
            recommendation = self._stop.computed(lambda: self._campaign.recommendation(brief=True))
            if recommendation is not None:
                self._emit("recommendation", recommendation=recommendation)

    def _summary(self, stopped: Literal["budget", "interrupted", "failing"], message: str) -> CampaignSummary:
        return CampaignSummary(
            stopped,
            message,
            time.monotonic() - self._began,
            self._ask_s,
            self._campaign.status(),
            # What is known is enough for who waits for the prompt.
            None if stopped == "interrupted" else self._campaign.recommendation(),
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
