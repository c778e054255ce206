"""One cache with one rule. What a stage made is kept under a key, a digest of everything that decides it:

* the *kind* of thing;
* its *inputs*: pixels, poses, options, a rock's SHA-256;
* the source code that makes it, with all that this code imports, and the libraries' versions (`code_digest`).

An entry is stale when its key is no longer asked for, and never otherwise: there is no number to raise by hand.
`cached` is the rule in one call; without a store it only calls ``make``, so nothing is read or written. Stores are
handed from the mission down to the stages; no algorithm opens one.

Rocks that a user imported by name live beside the store (``nbv.rocks.catalogue``) and are not part of it.
"""

from nbv.cache.store import (
    Arrays,
    KnownOnly,
    Recent,
    Store,
    cache_key,
    cached,
    cached_json,
    code_digest,
    digest,
    home,
)

__all__ = [
    "Arrays",
    "KnownOnly",
    "Recent",
    "Store",
    "cache_key",
    "cached",
    "cached_json",
    "code_digest",
    "digest",
    "home",
]
