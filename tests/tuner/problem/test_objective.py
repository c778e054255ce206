"""The objective and the standardisation per rock."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nbv.errors import UserError
from tuner.problem.objective import Objective, direction_of
from tuner.problem.standardise import RockStandardiser


def test_failed_and_missing_are_infeasible_degraded_counts() -> None:
    objective = Objective("observable.f_score_48mm")
    metrics = {"observable": {"f_score_48mm": 61.5, "list": [1]}}
    assert objective.outcome("ok", metrics) == (61.5, "")
    assert objective.outcome("degraded", metrics)[0] == 61.5
    assert objective.outcome("failed", metrics)[0] is None
    assert objective.outcome("ok", {})[0] is None
    assert objective.outcome("ok", {"observable": {"f_score_48mm": math.nan}})[0] is None
    assert objective.outcome("ok", {"observable": {"f_score_48mm": None}})[0] is None
    assert Objective("observable.list").outcome("ok", metrics)[0] is None
    assert Objective(direction="minimise").sign == -1
    assert direction_of("observable.accuracy_48mm") == "maximise"
    with pytest.raises(UserError, match="unknown direction"):
        Objective(direction="up")  # type: ignore[arg-type]


def test_standardisation_recovers_rock_offsets_and_scales() -> None:
    rng = np.random.default_rng(0)
    rocks = [name for name in "abc" for _ in range(400)]
    offset, scale = {"a": 10.0, "b": 50.0, "c": 90.0}, {"a": 1.0, "b": 2.0, "c": 4.0}
    y = np.array([offset[r] + scale[r] * rng.normal() for r in rocks])
    standardiser = RockStandardiser.fit(rocks, y)
    for name in "abc":
        assert standardiser.centre(name) == pytest.approx(offset[name], abs=0.5)
        assert standardiser.scale(name) == pytest.approx(scale[name], rel=0.1)
    z = standardiser.standardise(rocks, y)
    for name in "abc":
        group = z[np.array(rocks) == name]
        assert abs(group.mean()) < 0.05 and group.std() == pytest.approx(1, rel=0.1)


def test_scales_within_blocks_ignore_what_blocks_share() -> None:
    rng = np.random.default_rng(0)
    rocks = [name for name in "ab" for _ in range(400)]
    blocks = [(rock, i % 2) for i, rock in enumerate(rocks)]
    y = np.array([rng.normal() + (20 if block == ("a", 1) else 0) for block in blocks])
    assert RockStandardiser.fit(rocks, y).scale("a") > 9
    within = RockStandardiser.fit(rocks, y, blocks=blocks)
    assert within.scale("a") == pytest.approx(1, rel=0.1) and within.scale("b") == pytest.approx(1, rel=0.1)


@given(
    st.lists(st.tuples(st.sampled_from("abc"), st.floats(-1e6, 1e6)), min_size=0, max_size=12),
)
def test_standardisation_stays_finite(pairs: list[tuple[str, float]]) -> None:
    rocks, y = [r for r, _ in pairs], [v for _, v in pairs]
    standardiser = RockStandardiser.fit(rocks, y)
    z = standardiser.standardise(rocks, y)
    assert np.all(np.isfinite(z))
    back = [standardiser.centre(r) + standardiser.scale(r) * v for r, v in zip(rocks, z)]
    np.testing.assert_allclose(back, y, rtol=1e-6, atol=1e-6)
    assert all(standardiser.scale(r) > 0 for r in "abcz") and math.isfinite(standardiser.centre("z"))
