"""How often does `make tune` find its best gate? Campaigns of many seeds on an emulator of its missions.

    python -m research.emulated_campaigns docs/results/data/plan_and_gate_trials.csv --seeds 16
    python -m research.emulated_campaigns trials.csv --collect runs/tune runs/tune-1     # the emulator's data, from campaigns
    python -m research.emulated_campaigns trials.csv --geometric     # how geometric missions rank these, target by target

The emulator is a forest of extremely randomised trees (Geurts et al. 2006) over the trials of real campaigns: a target's mean and
what seeds, ring and weights add to it. Weights of a scorer that chooses no view have no effect in it, nor have thresholds beyond the
share of views that they leave to each scorer. Every mission has an error of its own, drawn by its configuration. With ``--inside``
the repairing scorer's best weights lie inside their ranges, at 0.1, in place of at their ends. A row of the table
is a seed; it says what the recommendations gain over the default by the emulator's means, and in how many seeds that is at least
`FOUND` of the best that any campaign was recommended.
"""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import spearmanr
from sklearn.ensemble import ExtraTreesRegressor

from nbv.geometric import run_geometric_mission
from research import read_rows, write_rows
from tuner.campaign.campaign import Campaign
from tuner.campaign.session import AT_ONCE, VERIFY
from tuner.campaign.settings_file import QUICK, resolved_settings
from tuner.problem.observations import Observation, next_block
from tuner.recommendation.choose import recommend
from tuner.samplers import base as samplers

ROCKS: list[str] = QUICK["rocks"]
NUMBER: int = QUICK["overrides"]["photographs"]
D95_M = (0.22, 0.40)  # between which d95 lies in flight
TERMS = ("nov", "move", "ang")
NEVER = -3.0  # logarithm of a weight that is not asked
ERROR = 0.7  # of the standard deviation out of bag: the rest is the forest's own
FOUND = 0.85


def moved_inside(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values whose repairing weights are those of the mission that is emulated: 0.01 for 0.1, more for smaller and larger ones."""
    weights = {f"b_aware.weights.{term}": values[f"b_aware.weights.{term}"] for term in TERMS}
    return {**values, **{path: 10 ** (-2 + 1.7 * abs(np.log10(w) + 1)) for path, w in weights.items()}}


def features(values: Mapping[str, Any], rock: str) -> list[float]:
    """What of a configuration has an effect, and the target."""
    seeds = min(values["seeds"], NUMBER)
    planned, turn = NUMBER - seeds, values["seed.layout"] == "turn"
    low_m, high_m = D95_M
    never_switches = float(np.clip((high_m - values["gate.d95_m"]) / (high_m - low_m), 0, 1))
    until = float(np.clip((values["gate.budget_fraction"] * NUMBER - seeds) / max(planned, 1), 0, 1))
    repairs = never_switches + (1 - never_switches) * until  # share of the planned views
    predicts = repairs * (values["gate.geometry_scorer"] == "predicted") * (planned > 0)

    def weights(scorer: str, *, asked: bool) -> list[float]:
        return [float(np.log10(values[f"{scorer}.weights.{t}"])) if asked else NEVER for t in TERMS]

    repairing = weights("b_aware", asked=repairs > 0.05 and planned > 0)
    return [
        ROCKS.index(rock),
        seeds,
        turn,
        values["seed.lowest_deg"] if turn else 0.0,
        values["seed.radius_m"] if turn else 4.0,
        repairs if planned else -1.0,
        predicts,
        values["pool.max_elevation_deg"] if planned else 0.0,
        *repairing,
        *weights("covis", asked=repairs < 0.95 and planned > 0),
        *(-predicts * weight for weight in repairing),
        planned,
    ]


class Emulator:
    """The outcome of a mission of `make tune`, from (values, target, outcome) of real ones."""

    def __init__(
        self, trials: Sequence[tuple[Mapping[str, Any], str, float]], *, inside: bool = False
    ) -> None:
        self._inside = inside
        x = np.array([features(values, rock) for values, rock, _ in trials])
        y = np.array([outcome for *_, outcome in trials])
        _, distinct = np.unique(np.round(x, 4), axis=0, return_index=True)  # repeated photographs
        x, y = x[distinct], y[distinct]
        self._means = {k: float(y[x[:, 0] == k].mean()) for k in range(len(ROCKS))}
        residual = y - [self._means[int(k)] for k in x[:, 0]]
        self._forest = ExtraTreesRegressor(
            400, min_samples_leaf=2, max_features=0.7, random_state=0, bootstrap=True, oob_score=True
        ).fit(x, residual)
        self.trials, self.r2 = len(y), float(self._forest.oob_score_)
        self._sd = ERROR * float(np.std(residual - self._forest.oob_prediction_))

    def outcome(self, values: Mapping[str, Any], rock: str, *, error: bool = True) -> float:
        x = np.array(features(moved_inside(values) if self._inside else values, rock))
        y = self._means[int(x[0])] + float(self._forest.predict(x[None])[0])
        if error:
            key = hashlib.sha256(repr(np.round(x, 2).tolist()).encode()).digest()
            y += self._sd * np.random.default_rng(list(key)).standard_normal()
        return min(y, 100.0)

    def mean(self, values: Mapping[str, Any]) -> float:
        return float(np.mean([self.outcome(values, rock, error=False) for rock in ROCKS]))


def campaign(emulator: Emulator, seed: int, missions: int) -> dict[str, float]:
    """What each recommendation of a campaign gains over the default, by the emulator's means; two missions at a time."""
    tree = {**QUICK, "name": "emulated", "compare_on": [], "seed": seed, "budget": missions}
    s = resolved_settings(tree, "emulated")
    sampler, problem = samplers.make_sampler("gp", s.search), s.problem
    history, running = list[Observation](), list[Observation]()

    def flown(o: Observation) -> Observation:
        y = emulator.outcome(o.values, o.rock)
        return replace(o, outcome=y, second=y)

    while len(history) < s.budget:
        while len(running) < 2 and len(history) + len(running) < s.budget:
            proposal, number = sampler.ask(history, running), len(history) + len(running)
            at, k = next_block(problem.instances, problem.replicates, [*history, *running], proposal)
            running.append(Observation(number, proposal.values, at.rock, k, condition=at.condition))
        history.append(flown(running.pop(0)))
    while left := s.budget + s.budget // VERIFY - len(history):  # as `tuner.campaign.session`
        best = recommend(problem, s.goal, history, only_verified=False).values()
        ran = {(tuple(o.values.items()), o.instance) for o in history}
        blocks = {(tuple(b.values.items()), at): b.values for b in best for at in problem.instances}
        if not (missing := [(v, at) for (key, at), v in blocks.items() if (key, at) not in ran]):
            break
        for v, at in missing[: min(AT_ONCE, left)]:
            history.append(flown(Observation(len(history), v, at.rock, 0, condition=at.condition)))
    default, found = emulator.mean(problem.default), recommend(problem, s.goal, history)
    targets = {n: len({o.rock for o in history if o.values == b.values}) for n, b in found.items()}
    gains = {n: emulator.mean(b.values) - default for n, b in found.items()}
    print(
        f"seed {seed}: { ({n: round(gain, 2) for n, gain in gains.items()}) }, on so many targets: {targets}",
        flush=True,
    )
    return gains


def collect(runs: Sequence[str], file: Path) -> None:
    """Write the trials of real campaigns of `make tune`."""
    rows = [
        {"run": run, "rock": t.rock, "f_score": f"{t.raw:.4f}", **t.values}
        for run in runs
        for t in Campaign.open(run, read_only=True).trials()
        if t.raw is not None and t.record.status
    ]
    write_rows(file, list(rows[0]), rows)


def read(file: Path) -> list[tuple[dict[str, Any], str, float]]:
    texts = ("seed.layout", "gate.geometry_scorer")
    return [
        (
            {
                path: text if path in texts else int(text) if path == "seeds" else float(text)
                for path, text in row.items()
                if path not in ("run", "rock", "f_score")
            },
            row["rock"],
            float(row["f_score"]),
        )
        for row in read_rows(file)
    ]


def rank_without_photographs(trials: Sequence[tuple[dict[str, Any], str, float]]) -> None:
    """Print the rank correlation of geometric missions with distinct real ones by target; one that fails is an error."""
    s = resolved_settings({**QUICK, "name": "emulated", "compare_on": []}, "emulated")
    for rock in ROCKS:
        distinct = {tuple(values.items()): y for values, target, y in trials if target == rock}
        configs = [s.problem.config(dict(values), s.conditions[0].name) for values in distinct]
        scores = [run_geometric_mission(config, rock).metric("observable.f_score_48mm") for config in configs]
        print(f"{rock}: {len(scores)} missions, {spearmanr(scores, list(distinct.values()))[0]:.2f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("file", type=Path)
    parser.add_argument("--collect", nargs="*", default=[])
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--missions", type=int, default=64)
    parser.add_argument("--geometric", action="store_true", help="rank correlation of geometric missions")
    parser.add_argument("--inside", action="store_true", help="best weights inside their ranges")
    asked = parser.parse_args()
    if asked.collect:
        collect(asked.collect, asked.file)
        return
    if asked.geometric:
        rank_without_photographs(read(asked.file))
        return
    emulator = Emulator(read(asked.file), inside=asked.inside)
    print(f"{emulator.trials} distinct missions, R2 out of bag {emulator.r2:.2f}")
    each = np.array([[*campaign(emulator, k, asked.missions).values()] for k in range(asked.seeds)])
    best, means, least = FOUND * each.max(), each.mean(axis=0), each.min(axis=0)
    print(f"|tuned gate, mean gain|least|tuned planner|least|gate found (≥ {best:.1f})|")
    print("|-:|-:|-:|-:|-:|")
    cells = [f"{x:.1f}" for pair in zip(means, least) for x in pair]
    print("|".join(["", *cells, f"{int((each[:, 0] >= best).sum())} of {len(each)}", ""]))


if __name__ == "__main__":
    main()
