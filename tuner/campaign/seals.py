"""What shows that a ledger was changed outside: two checksums per trial, and the missions' own directories.

A trial gets the first one when it is entered, over its number, parameters and attributes, and the second when it has ended, over
the first and all that was added. A record that was lost, doubled or changed no longer fits; records lost from the end show where
a mission's directory lies that the ledger does not know. Trials of before there were checksums have none.
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


def entry_seal(
    campaign_id: str, number: int, params: Mapping[str, Any], attributes: Mapping[str, Any]
) -> str:
    """Of a trial that is entered."""
    started = {k: v for k, v in attributes.items() if k not in (*_ENDING, ENTERED, ENDED)}
    return _seal(campaign_id, number, params, started)


def ending_seal(entered: str, value: float | None, attributes: Mapping[str, Any]) -> str:
    """Of a trial that has ended; ``value``: what the study was told."""
    return _seal(entered, value, {k: attributes.get(k) for k in _ENDING})


def require_trial(trial: FrozenTrial, campaign_id: str, ledger: str) -> None:
    """`UserError` where the trial is not as it was entered."""
    attributes = trial.user_attrs
    if not {ENTERED, ENDED} & set(attributes):
        return
    entered = entry_seal(campaign_id, trial.number, trial.params, attributes)
    sound = entered == attributes.get(ENTERED)
    if sound and trial.state.is_finished():
        sound = attributes.get(ENDED) == ending_seal(entered, trial.value, attributes)
    if not sound:
        raise UserError(
            f"trial {trial.number} of the ledger {ledger} is not what was entered: the ledger was changed or damaged; "
            "restore it from a copy"
        )


def require_all_there(count: Callable[[], int], directory: Path, ledger: str) -> None:
    """`UserError` where ``directory`` holds a mission that is not among the ledger's trials, ``count()`` in number."""
    found = [p.name for p in (directory / "missions").glob("[0-9]*_*")]
    trials = count()  # after the listing: the campaign may be running
    lost = sorted(name for name in found if (n := name.partition("_")[0]).isdigit() and int(n) >= trials)
    if lost:
        raise UserError(
            f"the ledger {ledger} has {trials} trials and knows nothing of missions/{lost[0]}: its end was lost; "
            "restore it from a copy, or move the missions it does not know away"
        )


def _seal(*parts: Any) -> str:
    return checksum_of(_plain(parts))


def _plain(value: Any) -> Any:
    """``value`` as every storage gives it back: whole numbers may come back as floats, tuples as lists."""
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
