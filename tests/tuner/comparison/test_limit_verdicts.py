import dataclasses

import numpy as np
import pytest
from made_evaluations import made_facts, made_run

from tuner.comparison.verdict import Kind, Verdict
from tuner.problem.goal import Goal
from tuner.problem.objective import Objective

IMAGES = Objective("costs.images", "minimise")
F = Objective("observable.f_score_48mm")
FEWEST = Goal(IMAGES, F, 98.0)


def verdicts(tuned: float = 97.0, asked: Goal = FEWEST, **changes: object) -> list[Verdict]:
    """Of tuned with 26 photographs, others with 32; ``observable`` F-scores are 3 higher than the levels."""
    levels = {"tuned": tuned, "hyb-h": 97.0, "random": 95.0}
    made = made_run(levels, images={"tuned": 26.0}, **{"noise": 0.1, **changes})
    return made_facts(made, asked).verdicts


def test_photographs_and_the_quality_has_the_interval() -> None:
    count, quality, kept, _ = verdicts(asked=dataclasses.replace(FEWEST, limit=102.0))
    assert count.kind is Kind.BETTER and count.gain is not None
    assert (count.gain.low, count.gain.mean, count.gain.high) == (6.0, 6.0, 6.0)
    assert quality.kind is Kind.NOT_WORSE and quality.margin == 1.0
    assert quality.gain is not None and quality.gain.low is not None
    share = kept.gain
    assert kept.kind is Kind.PARTLY_KEPT and share is not None and (share.mean, share.rocks) == (75.0, 4)
    assert (share.low, share.high) == pytest.approx((30.06, 95.44), abs=0.01)


def test_photographs_are_measured_where_missions_end_early() -> None:
    made, rng = made_run({"tuned": 97.0, "hyb-h": 97.0}), np.random.default_rng(0)
    for trial in made.records:
        trial.costs["images"] = float(rng.integers(20, 45))
    count, quality, kept = made_facts(made, Goal(F, IMAGES, 32.0)).verdicts
    assert count.kind is Kind.NO_DIFFERENCE and count.gain is not None and count.gain.method == "rocks"
    assert quality.metric == F.metric and kept.gain is not None and kept.gain.method == "wilson"


@pytest.mark.parametrize(("tuned", "kind"), [(90.0, Kind.WORSE), (96.3, Kind.NOT_WORSE), (99.0, Kind.BETTER)])
def test_the_margin_decides_what_is_said_of_quality(tuned: float, kind: Kind) -> None:
    assert verdicts(tuned)[1].kind is kind


def test_worse_than_the_best_control_is_said() -> None:
    """The control beats it by 0.7 points, which the margin allows against the default and not here."""
    (found,) = [verdict for verdict in verdicts(94.3) if verdict.best_control]
    assert (found.kind, found.reference) == (Kind.WORSE, "random") and found.gain is not None
    assert found.gain.mean == pytest.approx(-0.7, abs=0.1)
    (found,) = [verdict for verdict in verdicts(97.0, Goal(F)) if verdict.best_control]
    assert found.kind is Kind.BETTER  # without a limit too


def test_a_control_is_not_the_best_because_it_failed_on_the_hardest_rock() -> None:
    failed = tuple(("random", "cobble", k) for k in range(3))
    levels = {"tuned": 96.0, "hyb-h": 90.0, "random": 94.8, "covis": 96.7}
    facts = made_facts(made_run(levels, noise=0.3, failed=failed))
    (found,) = [verdict for verdict in facts.verdicts if verdict.best_control]
    assert (found.kind, found.reference) == (Kind.WORSE, "covis")
    (row,) = [row for row in facts.summary.rows if row.metric.key == F.metric]
    assert row.best == ("covis",)  # though the mean of "random" is the largest
