"""The optimiser comparison's own parts: known optima, fair problems, accounting, and the summary's arithmetic."""

import json
from pathlib import Path

import numpy as np
import pytest

from research import optimiser_comparison
from research import optimiser_problems as problems
from research import optimiser_summary as summary

HARTMANN_AT = [0.20169, 0.150011, 0.476874, 0.275332, 0.311652, 0.6573]


@pytest.mark.parametrize("name", ["hartmann6:0.1", "ackley10:0.1", "levy10:0.5"])
def test_optimum_is_where_and_what_it_should_be(name: str) -> None:
    problem = problems.make_problem(name, 3, Path("unused"))
    at = np.random.default_rng([3, 3]).uniform(0.25, 0.75, 10)  # of Ackley and Levy
    if name.startswith("hartmann6"):
        at[:6] = HARTMANN_AT
    assert problem.truth(problem.space.from_unit(at)) == pytest.approx(problem.best, abs=1e-3)
    rng = np.random.default_rng(0)
    truths = [problem.truth(problem.space.from_unit(u)) for u in rng.random((400, 10))]
    assert max(truths) < problem.best and np.std(truths) == pytest.approx(1, abs=0.25)


def test_a_run_is_written_skipped_and_summarised(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    job = ("four-rocks:0", "sobol", 0, tmp_path, problems.ROCKS, 10)
    optimiser_comparison.run_one(job)
    path = optimiser_comparison.result_file(tmp_path, "four-rocks:0", "sobol", 0)
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    assert [r["kind"] for r in rows].count("mission") == 10 and optimiser_comparison.complete(path)
    assert rows[-2]["kind"] == "checkpoint" and rows[-2]["cost"] == 10
    assert {r["rock"] for r in rows if r["kind"] == "mission"} == {"r0", "r1", "r2", "r3"}
    run = summary.read(path)
    assert run is not None and run.truths[-1] == pytest.approx(rows[-2]["truth"], abs=1e-6)
    # The same outcomes averaged in another order are the same value.
    path.write_text(path.read_text().replace(str(rows[-2]["truth"]), str(rows[-2]["truth"] + 1e-10)))
    again = summary.read(path)
    assert again is not None and again.truths.tolist() == run.truths.tolist()
    assert run.reached(run.truths.max()) <= 10 and run.reached(99.0) == float("inf")
    path.write_text("\n".join(path.read_text().splitlines()[:-1]))
    assert summary.read(path) is None and not optimiser_comparison.complete(path)


def test_paired_difference_and_cost_ratio() -> None:
    def run(strategy: str, seed: int, truths: list[float]) -> summary.Run:
        costs = np.array([2.0, 4.0, 8.0])
        return summary.Run("p", strategy, seed, 8.0, None, costs, np.array(truths), np.zeros(1))

    table = {
        "gp": {s: run("gp", s, [0.5, 0.9 + 0.01 * s, 1.0]) for s in range(4)},
        "tpe": {s: run("tpe", s, [0.1, 0.4, 0.8]) for s in range(4)},
    }
    lines = summary.rows(table, "gp")
    assert lines[0].startswith("| gp |") and "+0.200 (+0.200 to +0.200) | 0.50 |" in lines[1]
    table["lucky"] = {0: run("lucky", 0, [2.0, 2.0, 2.0])}  # one seed does not make it the best peer
    table["cmaes"] = {s: run("cmaes", s, [0.1, 0.4, 1.5 if s else 1.4]) for s in range(3)}
    (line,) = summary.against_best_peer({"p": table}, "gp")
    assert line.startswith("| p | tpe | 4 | +0.200 (+0.200 to +0.200) | 0.50 |") and line.endswith(
        "| cmaes |"
    )
