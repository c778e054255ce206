"""Checksums within the program's documents: whether somebody changed one since it was written."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from nbv.errors import UserError

CHECKSUM = "checksum"  # the document's key; its value is the checksum of all the rest


def with_checksum(tree: Mapping[str, Any]) -> dict[str, Any]:
    """``tree``, of JSON's kinds of values, with a checksum of the rest under `CHECKSUM`."""
    plain = json.loads(json.dumps({key: value for key, value in tree.items() if key != CHECKSUM}))
    return {**plain, CHECKSUM: checksum_of(plain)}


def require_checksum(tree: Any, source: str, *, always: bool = False) -> None:
    """`UserError` where ``tree`` has a checksum and it is not that of the rest; older documents have none.

    ``always``: also where it has none. YAML that was cut off is YAML still.
    """
    if always and CHECKSUM not in tree:
        raise UserError(f"{source} was cut off: its checksum is missing; restore it")
    if isinstance(tree, dict) and CHECKSUM in tree:
        rest = {key: value for key, value in tree.items() if key != CHECKSUM}
        if checksum_of(rest) != tree[CHECKSUM]:
            raise UserError(f"{source} was changed since it was written (its checksum differs); restore it")


def checksum_of(tree: Any) -> str:
    return hashlib.sha256(json.dumps(tree, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
