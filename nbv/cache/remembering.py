"""Reading from the store what was made before, making and keeping it otherwise."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from nbv.cache.addressing import address
from nbv.cache.store import Arrays, Store


def remember(
    store: Store | None,
    kind: str,
    make: Callable[[], Arrays],
    *,
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
    code
        The module or package that makes it (``nbv.cache.addressing.code_digest``).
    inputs
        Everything else that decides it, each as `nbv.cache.digest` takes it.
    """
    if store is None:
        return make()
    key = address(code, *inputs)
    entry = store.get(kind, key)
    if entry is None:
        entry = make()
        store.put(kind, key, entry)
    return entry


def remember_json(
    store: Store | None,
    kind: str,
    make: Callable[[], Any],
    *,
    code: str,
    inputs: Sequence[Any],
) -> Any:
    """`remember` for a JSON value.

    Parameters
    ----------
    store, kind, make, code, inputs
        As in `remember`.
    """

    def packed() -> Arrays:
        return {"json": np.frombuffer(json.dumps(make()).encode(), np.uint8)}

    return json.loads(remember(store, kind, packed, code=code, inputs=inputs)["json"].tobytes())
