import pytest

from nbv.errors import UserError
from tuner.problem.goal import Objective, parse_goal

PHOTOGRAPHS = Objective("costs.images", "minimise")


def test_the_text_says_metric_cost_and_limit_and_is_said_back() -> None:
    assert parse_goal("f_score").second is None
    cheap = parse_goal("completeness@energy<=9")
    assert cheap.second == Objective("costs.energy_wh", "minimise") and cheap.limit == 9.0
    best = parse_goal("observable.f_score_16mm@photographs<=21")
    assert (best.objective.metric, best.second, best.limit) == ("observable.f_score_16mm", PHOTOGRAPHS, 21.0)
    least = parse_goal("photographs@f_score >= 97.5")
    assert least.objective == PHOTOGRAPHS and least.second == Objective() and least.limit == 97.5
    assert str(least) == "photographs@f_score>=97.5"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("photographs@P(f_score>=98)>=0.95", "is not understood"),
        ("f_score@photographs>=21", "costs.images is minimised; write <="),
        ("photographs@f_score<=97", "is maximised; write >="),
        ("f_score@f_score>=9", "the same metric twice"),
        ("f_score@photographs<=1e", "'1e' is not a number"),
        ("f_score at 21", "is not understood; write f_score, f_score@photographs<=21"),
        ("f_score@photographs", "is not understood; write f_score, f_score@photographs<=21"),
        ("f_score@costs.beauty<=1", "no cost 'costs.beauty'; there are costs.images"),
        ("f_score@beauty<=1", "more or less of 'beauty' is better"),
    ],
)
def test_what_is_no_objective_is_said_in_one_line(text: str, says: str) -> None:
    with pytest.raises(UserError, match=says) as error:
        parse_goal(text)
    assert "\n" not in str(error.value)
