"""Random numbers keyed by content, never by call order.

Two missions that photograph the same rock from the same viewpoint in the same replicate must draw the
same arrival error and the same sensor noise, whatever else they drew before. So every draw has a
generator of its own, seeded by *what is drawn*.
"""

from __future__ import annotations

import hashlib

import numpy as np


def keyed_rng(*parts: str | int) -> np.random.Generator:
    """A generator (PCG64) that depends on ``parts`` alone, e.g. ``keyed_rng("noise", sha, 3, "seed_07")``.

    The seed is the SHA-256 of the parts, each with its type and length, so that neither ``("ab", "c")``
    and ``("a", "bc")`` nor ``1`` and ``"1"`` collide. The order of the parts matters.

    `TypeError` where a part is neither a string nor an integer (floats have no canonical text).
    """
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, bool) or not isinstance(part, (str, int, np.integer)):
            raise TypeError(f"keyed_rng takes strings and integers, not {part!r}")
        kind = b"s" if isinstance(part, str) else b"i"
        text = (part if isinstance(part, str) else str(int(part))).encode()
        digest.update(kind + len(text).to_bytes(8, "big") + text)
    return np.random.default_rng(int.from_bytes(digest.digest(), "big"))
