"""``gatetune compare``: curves equal those that research measured, tables, resume, and mistakes in one line."""

import csv
import html
import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from photographed_ball import spread, write_set
from typer.testing import CliRunner

from nbv import plugins
from nbv.config import preset
from nbv.errors import UserError
from nbv.geometric.curve import run_curve_mission
from tuner.cli import app
from tuner.evaluation.curves import (
    BASE,
    SUITES,
    Series,
    Suite,
    all_series,
    at_number,
    at_share,
    comparison_plan,
    share_compared,
    verdict,
    what_scores_0,
)
from tuner.missions.job import Trial
from tuner.problem.baselines import baseline, ending_at

MEASURED = Path(__file__).parents[3] / "docs/results/data/where_planning_pays_believed.csv"
ROCK = "boulder-20000"


def compare(*arguments):
    result = CliRunner().invoke(app, ["compare", *map(str, arguments)])
    if isinstance(result.exception, UserError):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.slow
@pytest.mark.parametrize(
    ("strategy", "arm", "numbers"),
    [
        ("predicted", "adaptive", range(12, 29)),
        ("orbit", "one ring at 10°", (16, 28)),
        ("orbit-two", "rings at 10° and 35°", (22, 24)),
    ],
)
def test_the_curves_are_those_that_research_measured(strategy, arm, numbers):
    with MEASURED.open() as file:
        known = next(
            r for r in csv.DictReader(file) if (r["rock"], r["arm"], r["value"]) == (ROCK, arm, "f_score")
        )
    base = Suite((ROCK,)).base
    if strategy == "predicted":
        config = ending_at(baseline(strategy).config(base), max(numbers))
        found = {n: score for n, score, _ in run_curve_mission(config, ROCK).metrics["curve"]}
    else:
        found = {
            n: run_curve_mission(baseline(strategy).orbit(base, n), ROCK).metrics["curve"][0][1]
            for n in numbers
        }
    for n in numbers:
        assert found[n] == pytest.approx(float(known[str(n)]), abs=6e-4)


@pytest.mark.slow
def test_a_comparison_leaves_its_files_and_runs_nothing_twice(tmp_path):
    strategies = ("random", "random-stopped", "greedy-oracle", "orbit-two", "orbit-by-height")
    asked = [part for name in strategies for part in ("--strategy", name)]
    asked += [
        *shlex.split("--targets 2 --numbers 12,16,20 --share 0.5 --score 90 --workers 1 --out"),
        tmp_path / "run",
    ]
    out = compare(*asked)
    told = json.loads((tmp_path / "run/comparison.json").read_text())
    assert told["verdict"].split()[0] == "orbit-by-height" and told["suite"].startswith("custom-")
    lines = out.splitlines()
    head = next(i for i, line in enumerate(lines) if line.startswith("strategy "))
    named = [line.split()[0] for line in lines[head + 1 :][: len(strategies)]]
    assert named == list(strategies) and max(map(len, lines)) <= 80, "one line for each, unwrapped"
    assert told["ground_truth"] == ["greedy-oracle"] and [f["name"] for f in told["at_share"]] == list(
        strategies
    )
    page = (tmp_path / "run/report.html").read_text()
    assert (
        "greedy-oracle †" in page
        and told["provenance"]["revision"] in page
        and told["verdict"].partition(". ")[0] in page
    )
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
    compare(*asked)
    assert missions[0].is_file() and before == {m: m.stat().st_mtime_ns for m in missions[1:]}
    with pytest.raises(UserError, match="holds another evaluation"):
        compare(*asked, "--strategy", "covis")


PICKY = """
import numpy as np
from nbv.config import Weights
from nbv.plugins import register
from nbv.scorers import Scorer

def picky(terms, pool, config):
    return np.full(len(pool), np.nan) if config.target_m[2] < 1.1 else 1.0 - pool.positions_m[:, 2] / 4.0

register("scorers", "picky", Scorer("picky", picky, weights=lambda config: Weights()))
"""


@pytest.mark.slow
def test_a_planner_that_fails_on_one_target_is_a_failed_mission_there(tmp_path, monkeypatch):
    monkeypatch.setattr(plugins, "_registered", {})
    monkeypatch.setattr(plugins, "_used", {})
    (tmp_path / "picky_planner.py").write_text(PICKY)
    asked = shlex.split("--strategy picky --strategy orbit --numbers 14,18 --targets 2 --score 90")
    asked += ["--workers", 1, "--out", tmp_path / "run"]
    planner = str(tmp_path / "picky_planner.py")
    run = CliRunner().invoke(app, ["--plugin", planner, "compare", *map(str, asked)])
    assert run.exit_code == 0, run.output
    said = " ".join(run.output.split())
    assert (
        "picky: 1 mission failed (plugin_failed) on slab-20000; picky on slab-20000: scorer 'picky'" in said
    )
    failed = [
        m
        for m in (tmp_path / "run/missions/picky").iterdir()
        if "plugin_failed" in (m / "mission.json").read_text()
    ]
    told = json.loads((tmp_path / "run/comparison.json").read_text())
    assert [mission.name for mission in failed] == ["01_slab-20000_r0"]
    assert {(r["failed"], r["score_0"]) for r in told["at_number"] if r["strategy"] == "picky"} == {(1, 1)}
    assert told["score_0"][0] in html.unescape((tmp_path / "run/report.html").read_text())
    curve = [r for r in csv.DictReader((tmp_path / "run/curves.csv").open()) if r["strategy"] == "picky"]
    assert curve[-1]["score_0"] == "1"
    rows = list(csv.DictReader((tmp_path / "run/targets.csv").open()))
    last = {r["target"]: float(r["f_score_percent"]) for r in rows if r["strategy"] == "picky"}
    assert [target for target, score in last.items() if score == 0.0] == ["slab-20000"], "no other scores 0"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--numbers", "24,12"], "numbers of photographs must rise"),
        (["--numbers", "12:8:2"], "numbers of photographs must rise, as in 12:48:2"),
        (["--numbers", "many"], "must be FIRST:LAST:STEP"),
        (["--numbers", "6:20:2"], "below the 12 seeds"),
        (["--strategy", "orbit-stopped"], "orbit-stopped: only a planned strategy"),
        (
            ["--strategy", "random-stopped", "--rock", "slab", "--fidelity", "photogrammetric"],
            "only a planned strategy",
        ),
        (["--strategy", "no-such"], "unknown strategy 'no-such'.* or named with gatetune --plugin"),
        (["--family", "cube"], "there is no family 'cube' of rocks; choose from boulder, .*, mesa"),
        (["--fidelity", "external"], "cannot run fidelity external"),
        (["--fidelity", "no-such"], "unknown fidelity 'no-such'"),
        (["--campaign", "no-such"], "no-such holds no campaign"),
        (["--suite", "rocks-9"], "there is no suite 'rocks-9'"),
        (["--suite", "rocks-1", "--targets", "12"], r"not those of the suite rocks-1 \(targets\)"),
        (["--strategy", "orbit-by-hight"], "did you mean orbit-by-height"),
        (["--against", "covis"], "is not among the strategies"),
        (["--share", "2"], "share 2 must be in"),
        (["--rock", "slab", "--set", "pool.radius_m=0.5"], "slab reaches .* m from its middle"),
        (["--targets", "1", "--set", "pool.radius_m=0.5"], "boulder-20000 reaches .* m from its middle"),
    ],
)
def test_mistakes_are_one_line_and_leave_nothing(arguments, said, tmp_path):
    with pytest.raises(UserError, match=said) as error:
        compare(*arguments, "--out", tmp_path / "run")
    assert "\n" not in str(error.value) and not (tmp_path / "run").exists()


def series(name, photographs, scores):
    count = np.array(photographs, dtype=float)
    return Series(name, np.repeat(count[:, None], len(scores[0]), 1), np.array(scores, dtype=float))


def test_what_is_needed_at_equal_share_and_what_is_had_at_equal_number():
    ring = series("ring", (10, 20, 30), [[50, 50, 50, 50] * 2, [99, 99, 50, 50] * 2, [99, 99, 99, 50] * 2])
    mine = series("mine", (10, 20, 30), [[50, 50, 50, 99] * 2, [99, 99, 99, 99] * 2, [99, 99, 99, 99] * 2])
    never = series("never", (10, 20, 30), [[0, 0, 0, 0] * 2] * 3)
    found = {f.name: f for f in at_share([ring, mine, never], ring, 0.75, 98.0)}
    ratio, low, high = found["mine"].ratio
    assert (found["ring"].needed, found["mine"].needed, ratio) == (30.0, 20.0, 20 / 30)
    assert low <= ratio <= high <= 1.0
    assert found["ring"].ratio == (1.0, 1.0, 1.0), "paired with itself nothing varies"
    said = " ".join(verdict(list(found.values()), "ring", 0.75, 0.75, 98.0))
    assert said.startswith(
        "ring needs 30.0 photographs for 75 % of the targets to reach an F-score of 98 %. "
    )
    assert "mine needs 0.67 [" in said and "] times as many photographs as ring: " in said
    assert said.endswith("never never does so: it brings at most 0 % of them there.")
    (said,) = verdict(list(found.values()), "never", 0.75, 0.0, 98.0)
    assert "nothing can be compared with it" in said
    rows = {row["strategy"]: row for row in at_number([ring, mine], ring, 15, 98.0)}
    assert rows["mine"]["f_score"][0] == pytest.approx((62.25 + 99) / 2) and rows["mine"]["share"] == 0.625
    assert rows["ring"]["gain"] == (0.0, 0.0, 0.0)


def test_a_share_that_the_reference_never_has_is_replaced_by_one_that_it_has():
    ring = series("ring", (10, 20, 30), [[50, 50, 50], [99, 50, 50], [99, 99, 50]])
    mine = series("mine", (10, 20, 30), [[50, 50, 50], [99, 99, 50], [99, 99, 99]])
    share = share_compared(ring, 0.75, 98.0)
    assert share == 0.65 and share_compared(mine, 0.75, 98.0) == 0.75
    said = " ".join(verdict(at_share([ring, mine], ring, share, 98.0), "ring", 0.75, share, 98.0))
    assert said.startswith(
        "ring brings at most 67 % of the targets to an F-score of 98 %, not the 75 % asked for; 65 % are compared instead. "
        "ring needs 30.0 photographs for 65 %"
    )
    assert "mine needs 0.67 times as many photographs as ring: too few targets for an interval." in said


def test_a_strategy_says_nothing_of_numbers_that_it_never_takes():
    ring = series("ring", (18, 20, 30), [[99, 99, 99, 50] * 2, [99, 99, 99, 50] * 2, [99] * 8])
    mine = series("mine", (12, 20, 30), [[50, 99, 50, 50] * 2, [99] * 8, [99] * 8])
    rows = at_number([ring, mine], ring, 16, 98.0)
    assert [(row["strategy"], row["gain"]) for row in rows] == [("mine", (None, None, None))]
    findings = at_share([ring, mine], ring, 0.75, 98.0)
    said = verdict(findings, "ring", 0.75, 0.75, 98.0)
    assert said[0].startswith("ring needs at most 18.0 photographs") and "not tried with fewer" in said[1]
    assert said[2].startswith("mine needs 1.11 [") and not said[2].endswith(": fewer.")


def test_what_has_no_model_yet_scores_0_and_is_said():
    suite = Suite(("slab", "boulder"), numbers=(12, 16, 20, 24))

    def ended(rock, begins):
        curve = [[n, 90.0 + n / 10, 95.0] for n in range(begins, 25)]
        return Trial(
            rock=rock,
            replicate=0,
            strategy="covis",
            status="ok",
            measured_then={"metrics": {"curve": curve}},
        )

    (found,) = all_series(suite, ["covis"], [ended("slab", 12), ended("boulder", 22)])
    assert found.scores.tolist() == [[91.2, 0.0], [91.6, 0.0], [92.0, 0.0], [92.4, 92.4]]
    said = what_scores_0([found], suite.targets)
    assert said == ["covis: no model yet with 12 to 20 photographs on boulder."]


def test_a_suite_is_named_by_all_its_settings():
    suite = SUITES["rocks-1"]
    assert suite.name == "rocks-1" and len(suite.targets) == 60
    changed = Suite(suite.targets, values={**BASE, "pool.radius_m": 3.0})
    assert changed.name.startswith("custom-") and changed.name != Suite(suite.targets, score=97.0).name
    plan = comparison_plan(suite, dict.fromkeys(("covis", "orbit-two", "orbit-by-height")))
    assert plan.missions == 60 * (1 + 19)
    rendered = Suite(("slab",), (16, 24), fidelity="photogrammetric")
    assert list(comparison_plan(rendered, {"covis": None}).strategies) == ["covis-16", "covis-24"]


def test_over_photographs_every_number_is_a_mission_and_the_height_is_that_of_the_set(tmp_path, monkeypatch):
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path / "home"))
    write_set("ball", spread(40), rendered=True)
    asked = shlex.split("--strategy random --strategy orbit-by-height --rock ball --numbers 12,14 --score 50")
    out = compare(*asked, "--workers", 1, "--out", tmp_path / "run")
    names = sorted(place.name for place in (tmp_path / "run/missions").iterdir())
    assert names == ["orbit-two-12", "orbit-two-14", "random-12", "random-14"]
    rows = list(csv.DictReader((tmp_path / "run/targets.csv").open()))
    for number, row in zip((12, 14), [row for row in rows if row["strategy"] == "random"], strict=True):
        told = json.loads((tmp_path / f"run/missions/random-{number}/00_ball_r0/mission.json").read_text())
        assert told["costs"]["images"] == float(row["photographs"]), (
            "a seed without a photograph is not taken"
        )
        f_score = told["metrics"]["observable"]["f_score_48mm"]
        assert float(row["f_score_percent"]) == pytest.approx(f_score, abs=1e-4)
    assert "too few targets for an interval" in out


def test_a_recommendation_is_measured_as_all_others_are():
    """It was tuned with six agreeing views; beside strategies with three it would lose by its yardstick."""
    suite = Suite((ROCK,), numbers=(24, 28))
    tuned = preset("campaign").with_values(
        {"dense.agreeing_views": 6, "gate.d95_m": 0.4, "pool.max_altitude_m": 1.5}
    )
    with pytest.raises(
        UserError, match="tuned begins with 24 seeds, which --numbers must allow: 22 are too few"
    ):
        comparison_plan(Suite((ROCK,), numbers=(12, 22)), {"tuned": tuned})
    plan = comparison_plan(suite, {"tuned": tuned, "random": None}).strategies
    assert plan["tuned"].gate == tuned.gate and plan["tuned"].pool == tuned.pool
    for section in ("dense", "sparse", "evaluation", "target", "telemetry"):
        assert getattr(plan["tuned"], section) == getattr(plan["random"], section)
