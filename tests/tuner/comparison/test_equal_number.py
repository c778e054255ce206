from pathlib import Path

import numpy as np
import pytest
from photographed_ball import write_set
from scene_helpers import around

from nbv.config import IDEAL_CONDITION, load_condition, preset
from tuner.campaign.mission_problem import where_photographed
from tuner.problem.baselines import (
    BASELINES,
    ORBITS,
    at_equal_number,
    baseline_configs,
    ending_at,
    orbits_at_number,
)
from tuner.problem.space_files import load_search_space
from tuner.report.figures import plan_figure
from tuner.report.words import plan_words

BASE = preset("campaign")


def test_every_control_has_the_tuned_number_beside_the_default_plan() -> None:
    tuned = BASE.with_values({"photographs": 26, "pool.max_altitude_m": 1.5})
    number = tuned.photographs
    found = at_equal_number(baseline_configs(["hyb-h", "random", "greedy-oracle"], BASE), tuned, "hyb-h")
    assert found.pop("hyb-h").photographs == BASE.photographs != number
    assert list(found) == [f"{name}-{number}" for name in ("hyb-h", "random", "greedy-oracle")]
    assert {config.photographs for config in found.values()} == {number}


def test_an_orbit_flies_the_whole_number() -> None:
    """62 % at 10 degrees and the rest at 35, nothing planned, whatever the tuned plan's own seeds are."""
    tuned = BASE.with_values({"photographs": 26, "seed.radius_m": 4.4})
    found = at_equal_number(baseline_configs(["hyb-h", "orbit", "orbit-two"], BASE), tuned, "hyb-h")
    assert list(found) == ["hyb-h", "hyb-h-26", "orbit-26", "orbit-two-26"]
    one, two = found["orbit-26"], found["orbit-two-26"]
    assert [(c.seeds, c.planned_views) for c in (one, two)] == [(26, 0)] * 2
    assert one.seed_rings == ((10.0, 26),) and two.seed_rings == ((10.0, 16), (35.0, 10))
    assert two.seed.radius_m == 3.5
    assert plan_words(two) == "16 photographs at 10° and 10 at 35°"
    above, beside = plan_figure(two).axes
    assert len(above.lines[1].get_xdata()) == 26 and not len(above.lines[0].get_xdata()), "seeds, no pool"
    assert len({round(up, 3) for up in beside.lines[1].get_ydata()}) == 2, "two rings, two heights"


@pytest.mark.parametrize(("number", "shared_out"), [(8, (6, 2)), (20, (15, 5))])
@pytest.mark.parametrize("space", ["photographs", "gate_weights_and_pool"])
def test_beside_a_tuned_orbit_planners_keep_their_share(space: str, number: int, shared_out) -> None:
    """Of a default that flies a turn, and of the paper's rings."""
    base = BASE.with_values(load_search_space(space).base)
    tuned = BASELINES["orbit"].orbit(base, number)
    found = at_equal_number(baseline_configs(["hyb-h", "covis"], base), tuned, "hyb-h")
    equal = found[f"hyb-h-{number}"]
    assert (equal.seeds, equal.planned_views) == shared_out
    assert equal.seed.layout == "rings" and equal.seed.radius_m == 4.0, "the paper's rings at any number"


def test_baselines_have_the_mean_number_of_a_plan_that_may_end_early() -> None:
    adaptive = BASE.with_values(
        {
            "photographs": 45,
            "seeds": 15,
            "seed.layout": "turn",
            "stop.criterion": "both",
            "stop.knn_threshold_m": 0.1,
        }
    )
    assert adaptive.stop.may_end_early
    counted = ending_at(adaptive, 21)
    assert (counted.photographs, counted.stop.may_end_early) == (21, False)
    found = at_equal_number(baseline_configs(["hyb-h", "random", "orbit"], BASE), counted, "hyb-h")
    assert list(found) == ["hyb-h", "hyb-h-21", "random-21", "orbit-21"]
    assert all(c.photographs == 21 and not c.stop.may_end_early for n, c in found.items() if n != "hyb-h")


def test_an_orbit_is_recentred_where_the_target_must_be_found() -> None:
    instances = (IDEAL_CONDITION, load_condition("field"))
    names = [f"{name}-32" for name in ORBITS]
    assert list(orbits_at_number(BASE, instances[:1])) == names
    found = orbits_at_number(BASE, instances)
    assert [c.seed.recentre_after for c in found.values()] == [0, 0, 0, 0, 16, 16]


def test_orbits_over_photographs_fly_where_these_were_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path))
    tuned = BASE.with_values({"photographs": 24, "seeds": 16, "seed.layout": "turn"})
    elevations_deg = np.repeat([30.0, 36.0, 42.0, 48.0], 5)
    write_set("ball", around(np.linspace(0.0, 342.0, 20), elevations_deg), rendered=False)
    found, notes = where_photographed(orbits_at_number(tuned, ()) | {"tuned": tuned}, ["ball"])
    number = tuned.photographs
    ring, two = found[f"orbit-middle-{number}"].seed, found[f"orbit-two-{number}"].seed
    assert (ring.lowest_deg, ring.span_deg) == (pytest.approx(39.0, abs=0.1), 0.0)
    assert (two.lowest_deg, two.upper_deg) == (pytest.approx(34.5, abs=0.1), pytest.approx(43.5, abs=0.1))
    assert list(found) == [f"orbit-middle-{number}", f"orbit-two-{number}", "tuned"]
    assert found["tuned"] is tuned and "39° (the median)" in notes[0]
    assert where_photographed(found, ["slab"]) == (found, ())
