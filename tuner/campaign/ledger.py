"""The campaign's one ledger: an Optuna study in which every trial is one mission.

It holds what was asked for, where that stands, and the objectives' values; what a mission measured besides is in its
``mission.json``. Parameters of a trial are the tuned ones only; rock, condition, replicate and the reason for the proposal are
user attributes, so that Optuna's importances and dashboards see what was tuned and nothing else. A trial is written once as
running and told once, with the attribute ``end``; finished trials are never changed. A failed mission is a trial in
state FAIL, without a value. A limit on the second objective is the trial's constraint, as Optuna has them: ``study.best_trial`` is
the best single mission that kept it, on one rock. The missions' directories show that the end of a ledger was lost.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import optuna
from optuna.distributions import (
    BaseDistribution,
    CategoricalDistribution,
    FloatDistribution,
    IntDistribution,
)
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend, JournalFileSymlinkLock
from optuna.trial import FrozenTrial, TrialState, create_trial

from nbv.errors import UserError
from tuner.missions.job import Record, Trial
from tuner.problem.goal import Goal
from tuner.problem.instances import Instance
from tuner.problem.observations import Proposal
from tuner.problem.search_space import Problem, SearchSpace

# The file of a campaign's ledger: the journal of an Optuna study in its run directory.


JOURNAL_FILE = "study.journal"


class _JournalLock(JournalFileSymlinkLock):
    """Optuna's, which says of any disk that fails that a lock was lost."""

    def __init__(self, path: str) -> None:
        super().__init__(path)
        self._path = Path(f"{path}.lock")

    def release(self) -> None:
        """Remove the lock; ``OSError`` where the file system does not let go of it. A resume removes it then."""
        self._path.unlink(missing_ok=True)


def open_journal(directory: Path, *, must_exist: bool = False, heal: bool = True) -> JournalStorage:
    """Open the journal of the campaign in ``directory``.

    ``must_exist``: whether the file has to be there already. ``heal``: whether to cut off a last line that is torn.

    Raises `UserError`: the file is missing, damaged, or cannot be read.
    """
    path = directory / JOURNAL_FILE
    if must_exist and not path.is_file():
        raise UserError(f"the ledger {path} is missing; restore it, or start a new campaign elsewhere")
    try:
        if heal and path.exists():
            _mend_end(path)
            # Nobody writes now: a lock file here was left by a killed process.
            path.with_name(path.name + ".lock").unlink(missing_ok=True)
        return JournalStorage(JournalFileBackend(str(path), _JournalLock(str(path))))
    except UserError:
        raise
    except OSError as error:
        raise UserError(f"cannot open the ledger {path}: {error.strerror}; make it writable") from error
    except Exception as error:  # Optuna's own of lines that are torn, lost, doubled or changed
        why = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise UserError(f"the ledger {path} is damaged ({why}); restore it from a copy") from error


def _mend_end(path: Path) -> None:
    """Cut off a last line that a killed process or a full disk left torn; ``ValueError`` where the one before is damaged, too.

    Optuna skips such a line when reading, but would write the next record behind it.
    """
    content = path.read_bytes()
    begin = content.rfind(b"\n", 0, -1) + 1
    last = content[begin:]
    if last and not _is_record(last):
        if begin and not _is_record(content[content.rfind(b"\n", 0, begin - 1) + 1 : begin]):
            raise ValueError("more than its last line")
        os.truncate(path, begin)


def _is_record(line: bytes) -> bool:
    try:
        return line.endswith(b"\n") and isinstance(json.loads(line), dict)
    except ValueError:
        return False


_CAMPAIGN_ID = "campaign_id"
_END = "end"  # a trial's attribute: how the mission ended
_ENDING = ("status", "message", "rock_sha256", "photographs", "switched")  # of it, as in `Record`


class Ledger:
    """Opens (or creates) the study of one campaign.

    ``name``: the campaign's. ``campaign_id`` tells the study from another campaign's of that name. ``read_only``: leave the files
    of a campaign that may be running alone.

    Raises `UserError`: the journal cannot be read, or holds another campaign's study or none.
    """

    def __init__(
        self,
        directory: Path,
        name: str,
        problem: Problem,
        goal: Goal,
        campaign_id: str,
        *,
        read_only: bool = False,
    ) -> None:
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self._directory, self._goal = directory, goal
        self._distributions = distributions(problem.space)
        self._instances = frozenset(problem.instances)
        self._known: dict[int, tuple[FrozenTrial, Trial]] = {}
        self._alone = False  # no other process may write now, so `_known` is complete
        self._shown = shown = str(directory / JOURNAL_FILE)
        # Before its first mission a campaign may not have a ledger yet or, if it was killed, half of one.
        begun = read_only or (directory / "missions").exists()
        storage = open_journal(directory, must_exist=begun, heal=not read_only)
        direction = "maximize" if goal.objective.direction == "maximise" else "minimize"
        try:
            if begun:
                self._study = optuna.load_study(study_name=name, storage=storage)
            else:
                self._study = optuna.create_study(
                    study_name=name, storage=storage, direction=direction, load_if_exists=True
                )
                if _CAMPAIGN_ID not in self._study.user_attrs and not self._study.get_trials():
                    self._study.set_user_attr(_CAMPAIGN_ID, campaign_id)
        except KeyError as error:
            raise UserError(
                f"{shown} holds no study {name!r}; the ledger was moved or never made: "
                "restore it, or start a new campaign"
            ) from error
        if self._study.user_attrs.get(_CAMPAIGN_ID) != campaign_id:
            raise UserError(
                f"the study {name!r} in {shown} belongs to another campaign; restore the ledger of this one"
            )
        # Of a ledger that lost its end the run directory holds missions that are not among its own.
        names = sorted(p.name for p in (self._directory / "missions").glob("[0-9]*_*"))
        count = len(self.trials())  # after the listing: the campaign may be running
        unknown = [name for name in names if (n := name.partition("_")[0]).isdigit() and int(n) >= count]
        if unknown:
            raise UserError(
                f"the ledger {self._shown} has {count} trials and knows nothing of missions/{unknown[0]}: its end was lost; "
                "restore it from a copy, or move the missions it does not know away"
            )

    @contextlib.contextmanager
    def exclusive(self) -> Iterator[None]:
        """Read trials from memory while this process, which holds the run directory's lock, is the only one that writes."""
        self.trials()
        self._alone = True
        try:
            yield
        finally:
            self._alone = False

    def start(
        self,
        proposal: Proposal,
        instance: Instance,
        replicate: int,
        code: str,
        config_digest: str = "",
    ) -> Trial:
        """Enter a mission that is about to run, in one write.

        ``code``: the digest of the code that runs it (`tuner.campaign.session.ReproducibilityCheck`). ``config_digest``:
        empty where the proposal is no configuration.
        """
        number = len(self.trials())
        entry: dict[str, Any] = {
            "rock": instance.rock,
            "condition": instance.condition,
            "replicate": replicate,
            "config_digest": config_digest,
            "why": proposal.metadata,
            "code": code,
        }
        params = {
            name: kind.to_external_repr(float(kind.to_internal_repr(proposal.values[name])))
            for name, kind in self._distributions.items()
        }
        trial = create_trial(
            state=TrialState.RUNNING, params=params, distributions=self._distributions, user_attrs=entry
        )

        self._study.add_trial(trial)
        entered = self._trial(self._study.get_trials(deepcopy=False)[-1])
        if entered.number != number or (entered.instance, entered.replicate) != (instance, replicate):
            raise UserError("another process writes to this campaign's study; let only one run at a time")
        return entered

    def finish(self, number: int, ended: Trial) -> Trial:
        """Enter how a mission ended, once per mission, with the objectives' values."""
        self.trials()
        frozen, _ = self._known[number]
        if frozen.state.is_finished():
            raise ValueError(f"trial {number} is finished already")
        objective, second, limit = self._goal.objective, self._goal.second, self._goal.limit
        measurements = ended.measurements
        value, why_not = objective.value_or_reason(ended.record.status, measurements)
        also = None if value is None or second is None else second.measure(measurements)
        end: dict[str, Any] = {name: getattr(ended.record, name) for name in _ENDING}
        end |= {"wall_s": round(ended.record.wall_s, 3), "second": also}
        end["reason"] = ended.reason or (why_not if value is None else "")
        told = optuna.trial.Trial(self._study, number)  # a journal of one study counts its trials from 0
        if told.number != number:
            raise UserError(
                f"the ledger {self._shown} holds the trials of another study, too; restore it from a copy"
            )
        # The attributes before the state: finished trials are frozen, and what a kill leaves of an end is entered again.
        if value is not None and second is not None and limit is not None:
            told.set_constraint(second.metric, math.inf if also is None else second.sign * (limit - also))
        told.set_user_attr(_END, end)
        self._study.tell(number, value, TrialState.FAIL if value is None else TrialState.COMPLETE)
        return self._trial(self._study.get_trials(deepcopy=False)[number])

    def trials(self) -> list[Trial]:
        if self._alone:
            return [trial for _, trial in self._known.values()]
        return [self._trial(row) for row in self._study.get_trials(deepcopy=False)]

    def _trial(self, row: FrozenTrial) -> Trial:
        """Return a row of the study; finished ones never change, so theirs are kept."""
        known = self._known.get(row.number)
        if known is None or (known[0] is not row and not known[1].record.status):
            row.distributions = self._distributions  # the same of all: kept once
            known = self._known[row.number] = (row, self._read(row))
        return known[1]

    def _read(self, row: FrozenTrial) -> Trial:
        entry, finished = row.user_attrs, row.state.is_finished()
        if row.state not in (TrialState.RUNNING, TrialState.COMPLETE, TrialState.FAIL) or "rock" not in entry:
            raise UserError(
                f"trial {row.number} of this campaign's study was not entered by gatetune; "
                "do not add trials to it by hand"
            )
        value = row.value if row.state == TrialState.COMPLETE else None
        end = dict(entry.get(_END) or {}) if finished else {}
        try:
            instance, replicate = Instance(entry["rock"], entry["condition"]), int(entry["replicate"])
            if instance not in self._instances:
                raise KeyError
            second, limited = end.pop("second", None), self._goal.second
            reason = end.pop("reason", "")
            folder = f"{row.number:04d}_{instance.file_name}_r{replicate}"
            return Trial(
                number=row.number,
                values=row.params,
                rock=instance.rock,
                condition=instance.condition,
                replicate=replicate,
                raw=value,
                outcome=self._goal.objective.oriented(value),
                second=None if limited is None else limited.oriented(second),
                reason=reason,
                record=Record(
                    metadata=entry["why"],
                    code=entry.get("code", ""),
                    config_digest=entry.get("config_digest", ""),
                    directory=self._directory / "missions" / folder,
                    started=row.datetime_start,
                    finished=row.datetime_complete,
                    **end,
                ),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise UserError(
                f"trial {row.number} of the ledger {self._shown} is not what was entered: the ledger was changed or damaged; "
                "restore it from a copy"
            ) from error


def distributions(space: SearchSpace) -> dict[str, BaseDistribution]:
    """Return Optuna distributions by path, of the same sets as the parameters."""
    found = dict[str, BaseDistribution]()
    for p in space.parameters:
        if p.kind == "categorical":
            found[p.path] = CategoricalDistribution(p.choices)
        elif p.kind == "int":
            found[p.path] = IntDistribution(int(p.low), int(p.high), log=p.scale == "log")
        else:
            found[p.path] = FloatDistribution(p.low, p.high, log=p.scale == "log")
    return found
