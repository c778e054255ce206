"""Reading from the store what was made before, making and keeping it otherwise."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from nbv.cache.addressing import address
from nbv.cache.layout import Arrays, Check, holds
from nbv.cache.store import Store


def remember(
    store: Store | None,
    kind: str,
    make: Callable[[], Arrays],
    *,
    is_sound: Check,
    code: str,
    inputs: Sequence[Any],
) -> Arrays:
    """What ``make`` gives, from the store if it is there.

    Parameters
    ----------
    store
        ``None``: nothing is read or written.
    kind
        What it is, for ``gatetune cache info``.
    make
        Makes it; what it raises is raised, and nothing is kept.
    is_sound
        Whether an entry is of this kind, such as `nbv.cache.holds`; another one is made anew.
    code
        The module or package that makes it (``nbv.cache.addressing.code_digest``).
    inputs
        Everything else that decides it, each as `nbv.cache.digest` takes it.
    """
    if store is None:
        return make()
    key = address(code, *inputs)
    entry = store.get(kind, key, is_sound)
    if entry is None:
        entry = make()
        store.put(kind, key, entry)
    return entry


def remember_json(
    store: Store | None,
    kind: str,
    make: Callable[[], Any],
    *,
    is_sound: Callable[[Any], bool],
    code: str,
    inputs: Sequence[Any],
) -> Any:
    """`remember` for a JSON value; ``is_sound``: whether a stored one is what it is kept as."""

    def packed() -> Arrays:
        return {"json": np.frombuffer(json.dumps(make()).encode(), np.uint8)}

    def check(arrays: Arrays) -> bool:
        try:
            return holds({"json": "u _"})(arrays) and is_sound(_value(arrays))
        except (ValueError, RecursionError):
            return False

    return _value(remember(store, kind, packed, is_sound=check, code=code, inputs=inputs))


def _value(arrays: Arrays) -> Any:
    return json.loads(arrays["json"].tobytes())
