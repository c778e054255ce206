import csv
import html
import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from made_evaluations import made_trial
from photographed_ball import spread, write_set

from nbv.config import preset
from nbv.errors import UserError
from nbv.geometric.geometric_fidelity import run_curve_mission
from tuner.commands.console import output
from tuner.comparison.curves import (
    BASE,
    Series,
    Suite,
    all_series,
    at_number,
    at_share,
    comparison_plan,
    drawn_targets,
    leaves_room,
    outcome,
)
from tuner.comparison.plan import EvaluationPlan
from tuner.comparison.statistics import Verdict
from tuner.problem.baselines import baseline
from tuner.problem.instances import Instance
from tuner.report.curves import answer_table, verdict_lines, write_curves

MEASURED = Path(__file__).parents[3] / "docs/results/data/where_planning_pays_believed.csv"
ROCK = "boulder-20000"


@pytest.mark.slow
def test_the_curves_are_those_that_research_measured():
    with MEASURED.open() as file:
        asked = {"rock": ROCK, "arm": "rings at 10° and 35°", "value": "f_score"}
        (known,) = (row for row in csv.DictReader(file) if asked.items() <= row.items())
    config = baseline("orbit-two").orbit(Suite((Instance(ROCK),)).base, 24)
    f_score = run_curve_mission(config, ROCK).metrics["curve"][0][1]
    assert f_score == pytest.approx(float(known["24"]), abs=6e-4)


@pytest.mark.slow
def test_a_comparison_leaves_its_files_and_runs_nothing_twice(gatetune, tmp_path, monkeypatch):
    monkeypatch.setattr(output, "width", 80)
    strategies = ("random", "random-stopped", "greedy-oracle", "orbit-two", "orbit-by-height")
    asked = [part for name in strategies for part in ("--strategy", name)]
    asked += shlex.split("--targets 2 --numbers 12,16,20 --share 0.5 --score 90 --workers 1 --out")
    asked += [tmp_path / "run"]
    out = gatetune.ok("compare", *asked)
    told = json.loads((tmp_path / "run/curves.json").read_text())
    assert told["reference"] == "orbit-by-height" and told["suite"].startswith("custom-")
    lines = out.splitlines()
    head = next(i for i, line in enumerate(lines) if line.startswith("strategy "))
    named = [line.split()[0] for line in lines[head + 1 :][: len(strategies)]]
    assert named == list(strategies) and max(map(len, lines)) <= 80, "one line for each, unwrapped"
    assert told["ground_truth"] == ["greedy-oracle"]
    assert [f["strategy"] for f in told["findings"]] == list(strategies)
    page = (tmp_path / "run/report.html").read_text().replace("\u00a0", " ")
    assert "greedy-oracle †" in page and told["provenance"]["revision"] in page
    assert all(html.escape(said) in page for said in told["verdict"])
    assert (tmp_path / "run/curves.png").stat().st_size > 10_000
    rows = list(csv.DictReader((tmp_path / "run/targets.csv").open()))
    missions = sorted((tmp_path / "run/missions").rglob("mission.json"))
    assert len(missions) == 2 * (2 + 3), "planned strategies once, an orbit once for each number"
    trace = next(m for m in missions if "greedy-oracle" in str(m) and ROCK in str(m))
    last = json.loads(trace.read_text())["metrics"]["curve"][-1]
    own = [r for r in rows if (r["strategy"], r["target"]) == ("greedy-oracle", ROCK)]
    assert float(own[-1]["f_score_percent"]) == pytest.approx(last[1], abs=1e-4) and last[0] == 20
    missions[0].unlink()  # as after a kill
    before = {m: m.stat().st_mtime_ns for m in missions[1:]}
    gatetune.ok("compare", *asked)
    assert missions[0].is_file() and before == {m: m.stat().st_mtime_ns for m in missions[1:]}
    assert "holds another evaluation" in gatetune.refused("compare", *asked, "--strategy", "covis")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("--numbers 24,12", "numbers of photographs must rise, as in 12:48:2"),
        ("--numbers 6:20:2", "below the 12 seeds"),
        ("--strategy orbit-stopped", "orbit-stopped: only a planned strategy"),
        ("--strategy random-stopped --rock slab --fidelity photogrammetric", "only a planned strategy"),
        ("--strategy no-such", "unknown strategy 'no-such'.* or named with gatetune --plugin"),
        ("--fidelity photographs", "cannot run fidelity photographs"),
        ("--against covis", "is not among the strategies"),
        ("--share 2", "share 2 must be in"),
        ("--set gate.kind=random", "gate.kind is decided by --strategy and --numbers"),
        ("--set seed.lowest_deg=-30 --rock slab", "lowest ring of seeds meets the ground"),
        ("--rock slab --set pool.radius_m=0.5", "slab reaches .* m from its middle"),
    ],
)
def test_mistakes_are_one_line_and_leave_nothing(arguments, said, gatetune, tmp_path):
    assert re.search(said, gatetune.refused("compare", *arguments.split(), "--out", tmp_path / "run"))
    assert not (tmp_path / "run").exists()


def series(name, photographs, scores):
    count = np.array(photographs, dtype=float)
    return Series(name, np.repeat(count[:, None], len(scores[0]), 1), np.array(scores, dtype=float))


def suite_of(count, numbers=(10, 20, 30)):
    return Suite(drawn_targets(count), numbers, values={**BASE, "seeds": 10})


RING = series("ring", (10, 20, 30), [[50] * 8, [99, 99, 50, 50] * 2, [99, 99, 99, 50] * 2])
MINE = series("mine", (10, 20, 30), [[50, 50, 50, 99] * 2, [99] * 8, [99] * 8])
NEVER = series("never", (10, 20, 30), [[0] * 8] * 3)


def test_what_is_needed_at_equal_share_and_what_is_had_at_equal_number():
    ring, mine, never = at_share([RING, MINE, NEVER], RING, 0.75, 98.0)
    assert (ring.needed, mine.needed, mine.ratio.mean, never.needed) == (30.0, 20.0, 20 / 30, None)
    assert mine.ratio.low <= mine.ratio.mean <= mine.ratio.high <= 1.0 and mine.ratio.method == "bootstrap"
    assert (ring.ratio.low, ring.ratio.high) == (1.0, 1.0), "paired with itself nothing varies"
    assert (ring.kind, never.kind, never.reached) == (Verdict.NO_DIFFERENCE, Verdict.NOT_PAIRED, 0.0)
    of_mine, of_ring = at_share([RING, MINE], MINE, 0.75, 98.0)[0], at_number([RING, MINE], MINE, 15, 98.0)[0]
    assert of_mine.ratio.low >= 1.0 and of_ring.kind is Verdict.WORSE
    ring, mine = at_number([RING, MINE], RING, 15, 98.0)
    assert mine.f_score.mean == pytest.approx((62.25 + 99) / 2) and mine.share == 0.625
    assert (mine.kind, ring.kind, ring.gain.mean) == (Verdict.BETTER, Verdict.NO_DIFFERENCE, 0.0)


def test_fewer_and_more_are_claimed_only_of_what_was_tried_with_fewer():
    late = series("late", (10, 20, 30), [[50] * 8, [50] * 8, [99] * 8])
    soon = series("soon", (10, 20, 30), [[50] * 8, [99] * 8, [99] * 8])
    first = series("first", (15, 20, 30), [[99] * 8] * 3)
    at_once = series("at once", (18, 20, 30), [[99] * 8] * 3)
    every, less, more, same = (
        (late, soon, first, at_once),
        Verdict.BETTER,
        Verdict.WORSE,
        Verdict.NO_DIFFERENCE,
    )
    kinds = [[f.kind for f in at_share(every, base, 0.75, 98.0)] for base in every]
    assert kinds[:2] == [[same, less, less, less], [more, same, less, less]]
    assert kinds[2] == kinds[3] == [more, more, same, same]
    assert [f.fewest for f in at_share(every, late, 0.75, 98.0)] == [False, False, True, True]


# Of three targets: as asked, or mean scores.
@pytest.mark.parametrize(("reached", "share"), [(3, 0.75), (2, 0.0)])
def test_a_share_that_the_reference_never_has_is_replaced_by_scores(reached, share):
    ring = series("ring", (10, 20, 30), [[50] * 3, [50] * 3, [99] * reached + [50] * (3 - reached)])
    found = outcome(suite_of(3), [ring, series("mine", (10, 20, 30), [[50] * 3, [99] * 3, [99] * 3])], "ring")
    assert (found.share, found.number) == (share, 30)
    assert found.findings[1].kind is (Verdict.NO_INTERVAL if share else Verdict.NOT_PAIRED), (
        "three are too few"
    )
    table = answer_table(suite_of(3), found)
    assert table.columns[1] == ("photographs" if share else "F-score, %")


def test_a_strategy_says_nothing_of_numbers_that_it_never_takes():
    ring = series("ring", (18, 20, 30), [[99, 99, 99, 50] * 2, [99, 99, 99, 50] * 2, [99] * 8])
    mine = series("mine", (12, 20, 30), [[50, 99, 50, 50] * 2, [99] * 8, [99] * 8])
    (alone,) = at_number([ring, mine], ring, 16, 98.0)
    assert (alone.strategy, alone.kind, alone.gain) == ("mine", Verdict.NOT_PAIRED, None)
    missed = series("set", (17.5, 20, 29.4), [[99] * 8] * 3)  # a photograph set without some of the seeds
    assert [s.strategy for s in at_number([ring, missed], ring, 30, 98.0)] == ["ring", "set"]


@pytest.mark.parametrize(("above", "gain"), [(0.4, False), (7.0, True)])
def test_the_oracle_tells_what_planners_could_gain_over_the_best_plain_plan(above, gain):
    of = {"hyb-h": 99.0, "random": 90.0, "orbit": 91.0, "greedy-oracle": 91.0 + above}
    found = outcome(suite_of(8), [series(n, (10, 20, 30), [[v] * 8] * 3) for n, v in of.items()], "orbit")
    assert (found.plain, leaves_room(found.ceiling)) == ("orbit", gain)
    assert found.ceiling.mean == pytest.approx(above)
    assert f"{above:.1f} points" in verdict_lines(suite_of(8), found)[-1]
    assert outcome(suite_of(8), [RING, MINE], "ring").ceiling is None


def ended(rock, curve, replicate=0):
    return made_trial("covis", rock, replicate, measured={"metrics": {"curve": curve}})


def test_levels_that_take_the_same_photographs_are_one_setting():
    suite = Suite((Instance("slab"), Instance("boulder")), numbers=(12, 14))
    trials = [ended("slab", [[12, 90, 90.6]]), ended("boulder", [[12, 90, 99.0]])]
    (found,) = all_series(suite, ["covis-stopped"], trials)
    assert found.photographs.tolist() == [[12, 12], [14, 12], [14, 14]]


def test_each_mission_stops_by_its_own_prediction():
    suite = Suite((Instance("slab"),), numbers=(12, 14), replicates=2)
    trials = [ended("slab", [[12, 97, 99.5]]), ended("slab", [[12, 80, 89.0], [14, 84, 89.5]], 1)]
    (found,) = all_series(suite, ["covis-stopped"], trials)
    assert (found.photographs.tolist(), found.scores.tolist()) == ([[13.0]], [[90.5]])


def test_what_failed_or_has_no_model_yet_scores_0_and_is_said(tmp_path):
    suite = Suite((Instance("slab"), Instance("boulder"), Instance("arch")), numbers=(12, 16, 20, 24))
    first = {"slab": 12, "boulder": 22}
    trials = [ended(r, [[n, 90.0 + n / 10, 95.0] for n in range(k, 25)]) for r, k in first.items()]
    trials.append(
        made_trial("covis", "arch", 0, reason="plugin_failed", status="failed", message="no such map")
    )
    (found,) = all_series(suite, ["covis"], trials)
    assert found.scores.tolist() == [[91.2, 0.0, 0.0], [91.6, 0.0, 0.0], [92.0, 0.0, 0.0], [92.4, 92.4, 0.0]]
    document = write_curves(suite, [found], outcome(suite, [found], "covis"), tmp_path)
    assert {(row["failed"], row["score_0"]) for row in document["standings"]} == {(1, 2), (1, 1)}
    assert "covis on arch: no such map" in html.unescape((tmp_path / "report.html").read_text())


def test_rocks_run_under_the_conditions_asked_for(gatetune, tmp_path):
    asked = shlex.split("--strategy orbit --numbers 16 --workers 1 --score 60 --out")
    asked += [tmp_path / "all", "--rock", "slab", "--condition", "ideal", "--condition", "indoors"]
    gatetune.ok("compare", *asked)
    assert EvaluationPlan.load(tmp_path / "all").instances == (Instance("slab"), Instance("slab", "indoors"))
    rows = list(csv.DictReader((tmp_path / "all/targets.csv").open()))
    scores = {row["target"]: float(row["f_score_percent"]) for row in rows}
    assert 60.0 < scores["slab, indoors"] != scores["slab"] > 60.0, "it has another sun"


def test_over_photographs_every_number_is_a_mission(gatetune, tmp_path, monkeypatch):
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path / "home"))
    write_set("ball", spread(40), rendered=True)
    asked = shlex.split("--strategy random --strategy orbit-by-height --rock ball --numbers 12,14 --score 50")
    asked += ["--set", "dense.max_size_px=240", "--set", "sparse.max_pairs=6"]
    out = gatetune.ok("compare", *asked, "--workers", 1, "--out", tmp_path / "run")
    names = sorted(place.name for place in (tmp_path / "run/missions").iterdir())
    assert names == ["orbit-two-12", "orbit-two-14", "random-12", "random-14"]
    rows = list(csv.DictReader((tmp_path / "run/targets.csv").open()))
    for number, row in zip((12, 14), [row for row in rows if row["strategy"] == "random"], strict=True):
        told = json.loads((tmp_path / f"run/missions/random-{number}/00_ball_r0/mission.json").read_text())
        # A seed without a photograph is not taken.
        assert told["costs"]["images"] == float(row["photographs"])
        f_score = told["metrics"]["observable"]["f_score_48mm"]
        assert float(row["f_score_percent"]) == pytest.approx(f_score, abs=1e-4)
    assert "F-score, %" in out, "one target is too few for an interval"
    said = gatetune.refused("compare", *asked, "--condition", "indoors", "--out", tmp_path / "refused")
    assert re.search(r"photographs missions take no notice.*scene.ambient.*condition indo", said)
    assert not (tmp_path / "refused").exists()


def test_a_recommendation_is_measured_as_all_others_are():
    """It was tuned with six agreeing views; beside strategies with three it would lose by its yardstick."""
    suite = Suite((Instance(ROCK),), numbers=(24, 28))
    values = {"dense.agreeing_views": 6, "gate.d95_m": 0.4, "pool.max_altitude_m": 1.5}
    tuned = preset("campaign").with_values(values)
    with pytest.raises(UserError, match="tuned begins with 24 seeds, which --numbers must allow: 22 are too"):
        comparison_plan(Suite((Instance(ROCK),), numbers=(12, 22)), {"tuned": tuned})
    plan = comparison_plan(suite, {"tuned": tuned, "random": None}).strategies
    assert plan["tuned"].gate == tuned.gate and plan["tuned"].pool == tuned.pool
    for section in ("dense", "sparse", "evaluation", "target", "telemetry"):
        assert getattr(plan["tuned"], section) == getattr(plan["random"], section)
