"""What an evaluation says of a campaign with a limit, and of one whose objective is a cost."""

from dataclasses import replace

import pytest
from made_evaluations import made_run

from tuner.comparison.of_campaign import ComparisonSpec
from tuner.comparison.run import EvaluationRun
from tuner.problem.objective import Objective
from tuner.report.comparison import ComparisonFacts

IMAGES = Objective("costs.images", "minimise")
F = Objective("observable.f_score_48mm")
FEWEST = ComparisonSpec(IMAGES, F, 98.0)


def run(tuned: float = 97.0, **changes: object) -> EvaluationRun:
    """Tuned with 26 photographs, the others with 32; ``observable`` F-scores are 3 higher than the levels."""
    levels = {"tuned": tuned, "hyb-h": 97.0, "random": 95.0}
    made = made_run(levels, **{"noise": 0.1, **changes})  # type: ignore[arg-type]
    records = [
        replace(r, measured_then={"metrics": r.metrics, "costs": {**r.costs, "images": 26.0}})
        if r.strategy == "tuned"
        else r
        for r in made.records
    ]
    return replace(made, records=records)


def said(tuned: float = 97.0, asked: ComparisonSpec = FEWEST, **changes: object) -> list[str]:
    return [line.text for line in ComparisonFacts(run(tuned, **changes), "hyb-h", asked).verdicts]


def test_photographs_are_exact_and_the_quality_has_the_interval() -> None:
    lines = said(asked=ComparisonSpec(IMAGES, F, 102.0))
    assert lines[0] == "Photographs: 26, and 32 for Hyb-H."
    assert (
        lines[1].startswith("Tuned is not worse than Hyb-H by more than 1.0 points")
        and "95 % interval" in lines[1]
    )
    assert "at least 102 %): met on 3 of 4 rocks (75 %, 95 % interval 30 to 95 %)" in lines[2]


@pytest.mark.parametrize(
    ("tuned", "begins"),
    [
        (90.0, "Tuned is worse than Hyb-H by more than 1.0 points"),
        (
            96.3,
            "Tuned is not worse than Hyb-H by more than 1.0 points",
        ),
        (99.0, "Tuned is better than Hyb-H"),
    ],
)
def test_the_margin_decides_what_is_said_of_quality(tuned: float, begins: str) -> None:
    assert said(tuned)[1].startswith(begins)


def test_worse_than_the_best_control_is_said() -> None:
    """The control beats it by 0.7 points, which the margin allows against the default and not here."""
    (line,) = [text for text in said(94.3) if "best control" in text]
    assert line.startswith("Tuned is worse than the best control with as many photographs (Random views)")
    assert "a loss of 0.7 points" in line
    (line,) = [
        text for text in said(97.0, ComparisonSpec(F)) if "best control" in text
    ]  # without a limit too
    assert line.startswith("Tuned is better than the best control")
