"""A configuration's digest: what results are found by again."""

from __future__ import annotations

import hashlib
import json

from nbv.config import MissionConfig, preset


def test_a_field_that_came_later_changes_nothing_until_it_is_used() -> None:
    config = preset("campaign")
    tree = config.to_dict()
    for name in ("main_term", "matchable_views"):
        del tree["b_aware"][name]
    text = json.dumps(tree, sort_keys=True, separators=(",", ":"))
    assert config.digest() == hashlib.sha256(text.encode()).hexdigest()[:16]
    changed = {config.with_values({p: v}).digest() for p, v in (
        ("b_aware.main_term", "matchable"), ("b_aware.matchable_views", 5), ("b_aware.theta_low_deg", 4.0),
        ("pool.max_altitude_m", 1.5))}  # fmt: skip
    assert len(changed | {config.digest(), MissionConfig().digest()}) == 6
