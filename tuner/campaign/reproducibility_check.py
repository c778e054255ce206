"""A resumed campaign must run the missions that it began with: the same code of the missions, the same rocks.

Every trial carries the digest of the code that runs it and, once it has ended, its rock's content hash. Where one differs
from the last trial of its kind the session stops and asks, so that no ledger mixes two experiments unnoticed.
"""

from __future__ import annotations

from nbv.errors import UserError
from tuner.campaign.campaign import Campaign
from tuner.missions.job import Trial
from tuner.problem.instances import family_of

ACCEPT = "--accept-changes"


class ReproducibilityCheck:
    """Compares a session's missions with those of ``campaign`` before it; ``accept``: changes since then are wanted."""

    def __init__(self, campaign: Campaign, *, accept: bool) -> None:
        self._directory, self._accept = campaign.directory, accept
        self._rocks: dict[str, tuple[str, int]] = {}
        problem = campaign.settings.problem
        self.code = problem.code()
        if accept:
            return
        trials = campaign.trials()
        known = [t for t in trials if t.code]
        if known and known[-1].code != self.code:
            self._ask(f"the {problem.code_word} of its missions changed after trial {known[-1].number}")
        for trial in trials:
            self._remember(trial, trial.rock_sha256)

    def require(self, trial: Trial, rock_sha256: str) -> None:
        """Raise `UserError` where the mission of ``trial`` met another rock than those before it under that name."""
        if self.is_another(trial, rock_sha256):
            before, number = self._rocks[_name(trial)]
            self._ask(
                f"rock {_name(trial)} is another one since trial {number} (content {before[:12]} then, {rock_sha256[:12]} now)"
            )
        self._remember(trial, rock_sha256)

    def begin(self) -> None:
        """Forget the rocks of earlier sessions where changes are wanted; called before the first mission runs."""
        if self._accept:
            self._rocks.clear()

    def is_another(self, trial: Trial, rock_sha256: str) -> bool:
        """Return whether `require` would refuse."""
        return bool(rock_sha256) and self._rocks.get(_name(trial), (rock_sha256, 0))[0] != rock_sha256

    def _remember(self, trial: Trial, sha256: str) -> None:
        if sha256:
            self._rocks[_name(trial)] = (sha256, trial.number)

    def _ask(self, what: str) -> None:
        raise UserError(
            f"{what}: its ledger would mix two kinds of missions; restore what it was, or go on all the same with "
            f"`gatetune campaign resume {self._directory} {ACCEPT}`"
        )


def _name(trial: Trial) -> str:
    """Return the name of the rock; of a family every replicate is another rock."""
    return f"{trial.rock}, rock {trial.replicate}" if family_of(trial.rock) else trial.rock
