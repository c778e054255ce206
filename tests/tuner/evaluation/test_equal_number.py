"""Controls fly as many photographs as the tuned configuration."""

from nbv.config import preset
from tuner.evaluation.baselines import (
    at_equal_number,
    baseline_configs,
    controls_at_equal_number,
    label,
    photographs,
    tuned_configs,
)

BASE = preset("campaign")


def test_every_control_has_the_tuned_number_beside_the_default_plan() -> None:
    tuned = BASE.with_values({"stop.adaptive_budget": 2, "pool.max_altitude_m": 1.5})
    number = photographs(tuned)
    found = at_equal_number(baseline_configs(["hyb-h", "random", "greedy-oracle"], BASE), tuned, "hyb-h")
    assert photographs(found.pop("hyb-h")) == photographs(BASE) != number
    assert list(found) == [f"{name}-{number}" for name in ("hyb-h", "random", "greedy-oracle")]
    assert {photographs(config) for config in found.values()} == {number}
    pool = tuned_configs(tuned, BASE)["random-tuned-pool"]
    assert (photographs(pool), pool.pool) == (number, tuned.pool)
    assert label(f"hyb-h-{number}") == f"Hyb-H, {number}"
    flown = {"tuned": tuned, "hyb-h": BASE, **found}
    assert controls_at_equal_number(flown) == (f"hyb-h-{number}", f"random-{number}")


def test_an_equal_number_changes_nothing() -> None:
    configs = baseline_configs(["hyb-h", "random"], BASE)
    tuned = BASE.with_values({"gate.budget_fraction": 0.1})
    assert at_equal_number(configs, tuned, "hyb-h") == configs
    assert controls_at_equal_number({"tuned": tuned, **configs}) == ("hyb-h", "random")
