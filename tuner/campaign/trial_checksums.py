"""Two checksums per trial, and the missions' own directories, show that a ledger was changed outside.

A trial gets the first one when it is entered, over its number, parameters and attributes, and the second when it has ended, over
the first and all that was added. A record that was lost, doubled or changed no longer fits. Records lost from the end show, too:
they leave a mission's directory that the ledger does not know. Trials older than these checksums have none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from optuna.trial import FrozenTrial

from nbv.checksums import checksum_of
from nbv.errors import UserError

ENTERED, ENDED = "seal_entered", "seal_ended"
_ENDING = (
    "status",
    "reason",
    "message",
    "metrics",
    "costs",
    "timings_s",
    "wall_s",
    "feasible",
    "rock_sha256",
)


def entry_checksum(
    campaign_id: str, number: int, params: Mapping[str, Any], attributes: Mapping[str, Any]
) -> str:
    """Return the checksum of a trial at its start.

    Parameters
    ----------
    campaign_id, number
        The campaign's identity and the trial's number in it.
    params
        Tuned values by parameter path.
    attributes
        The trial's user attributes; those that are written at its end are left out.
    """
    started = {k: v for k, v in attributes.items() if k not in (*_ENDING, ENTERED, ENDED)}
    return _checksum(campaign_id, number, params, started)


def ending_checksum(entered: str, value: float | None, attributes: Mapping[str, Any]) -> str:
    """Return the checksum of a trial that has ended, over its first one, the study's ``value`` and what was added."""
    return _checksum(entered, value, {k: attributes.get(k) for k in _ENDING})


def require_trial(trial: FrozenTrial, campaign_id: str, ledger: str) -> None:
    """Raise `UserError` where the trial is not as it was entered."""
    attributes = trial.user_attrs
    if not {ENTERED, ENDED} & set(attributes):
        return
    entered = entry_checksum(campaign_id, trial.number, trial.params, attributes)
    sound = entered == attributes.get(ENTERED)
    if sound and trial.state.is_finished():
        sound = attributes.get(ENDED) == ending_checksum(entered, trial.value, attributes)
    if not sound:
        raise UserError(
            f"trial {trial.number} of the ledger {ledger} is not what was entered: the ledger was changed or damaged; "
            "restore it from a copy"
        )


def require_all_there(count: Callable[[], int], directory: Path, ledger: str) -> None:
    """Raise `UserError` where ``directory`` holds a mission that is not among the ledger's ``count()`` trials."""
    found = [p.name for p in (directory / "missions").glob("[0-9]*_*")]
    trials = count()  # after the listing: the campaign may be running
    unknown = sorted(name for name in found if (n := name.partition("_")[0]).isdigit() and int(n) >= trials)
    if unknown:
        raise UserError(
            f"the ledger {ledger} has {trials} trials and knows nothing of missions/{unknown[0]}: its end was lost; "
            "restore it from a copy, or move the missions it does not know away"
        )


def _checksum(*parts: Any) -> str:
    return checksum_of(_plain(parts))


def _plain(value: Any) -> Any:
    """Return ``value`` as every storage gives it back: whole numbers may come back as floats, tuples as lists."""
    kind = type(value)
    if (
        kind is str or kind is float or kind is bool or value is None
    ):  # most are: asking a `Mapping` takes longer
        return value
    if kind is dict or isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(item) for item in value]
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value
