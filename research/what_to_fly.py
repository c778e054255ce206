"""Campaigns in space ``plan_and_gate`` by geometric missions: does the model find more than random search, is advice ever beaten?

    OMP_NUM_THREADS=1 python -m research.what_to_fly designs     # eight seeds, GP designs and priors against random search
    OMP_NUM_THREADS=1 python -m research.what_to_fly designs --shapes  # the same on shapes with pockets
    OMP_NUM_THREADS=1 python -m research.what_to_fly dropped     # eight seeds, the space without some of its parameters
    OMP_NUM_THREADS=1 python -m research.what_to_fly campaigns   # 16 campaigns, their advice on targets that they have not seen
    OMP_NUM_THREADS=1 python -m research.what_to_fly parameters  # what each parameter decides, by 200 random configurations

The truth of a configuration is its mean over four replicates that no campaign runs. Geometric missions, 20 photographs, `ideal`.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from tuner.campaign.rock_problem import plain_plans

from nbv.rocks.families import HELD_OUT_FROM
from nbv.types import Floats
from tuner.campaign.settings import CampaignSettings
from tuner.campaign.settings_file import merged_settings, resolved_settings
from tuner.missions.registry import kind_on
from tuner.problem.baselines import ORBITS
from tuner.problem.instances import Instance
from tuner.problem.intervals import mean_interval
from tuner.problem.observations import Observation, distinct_configurations, next_block
from tuner.recommendation.choose import recommend
from tuner.recommendation.recommendation import Recommendation
from tuner.samplers.base import ask_many, initial_proposal
from tuner.samplers.gp import GPSampler
from tuner.samplers.registry import make_sampler
from tuner.surrogate.model import InstanceMeanGP

METRIC = "observable.f_score_48mm"
ROCKS = ("slab", "vesicular", "cavern"), ("boulder", "waist", "breccia")
SHAPES = ("machine-1", "limbs-1", "handle-1"), ("machine-2", "limbs-2", "plates-2")
UNSEEN_ROCKS = ("arch", "fin", "horn", "bowl", "stack")
FRESH, TRUTH_REPLICATES = 100, 4
_known: dict[tuple[str, str, int], float | None] = {}


class SobolDesign(GPSampler):
    """A design that does not know the plain plans."""

    def _design_point(self, number: int, history: Sequence[Observation]) -> Any:
        return initial_proposal(self.settings, number + self.settings.first - 1, self.name)


WEIGHTS = tuple(
    f"{scorer}.weights.{part}" for scorer in ("covis", "b_aware") for part in ("nov", "move", "ang")
)
DROPPED: dict[str, tuple[str, ...]] = {
    "all 15 parameters": (),
    "without B-aware's weights of novelty and angle": ("b_aware.weights.nov", "b_aware.weights.ang"),
    "without all six weights": WEIGHTS,
    "without weights and gate": (*WEIGHTS, "gate.budget_fraction", "gate.d95_m"),
}
VARIANTS: dict[
    str, tuple[str, bool, Callable[[Any], Any]]
] = {  # sampler, whether plain plans are arms, changes of it
    "gp": ("gp", True, lambda sampler: sampler),
    "gp, sparse prior and trend": (
        "gp",
        True,
        lambda sampler: dataclasses.replace(sampler, sparse=True),
    ),
    "gp, Sobol design": ("gp", True, lambda sampler: SobolDesign(sampler.settings)),
    "random": ("random", True, lambda sampler: sampler),
    "gp, no arms": ("gp", False, lambda sampler: sampler),
    "random, no arms": ("random", False, lambda sampler: sampler),
}


def settings(
    rocks: Sequence[str], sampler: str = "gp", seed: int = 0, budget: int = 40, space: str = "plan_and_gate"
) -> CampaignSettings:
    """Those of ``make tune``, in geometric missions."""
    asked = {"fidelity": "geometric", "conditions": ["ideal"], "rocks": list(rocks), "space": space}
    own = {"budget": budget, "sampler": sampler, "seed": seed, "compare_on": []}
    return resolved_settings(merged_settings(None, {**asked, **own}, quick=True), "research")


def outcome(s: CampaignSettings, values: Mapping[str, Any], rock: str, replicate: int) -> float | None:
    """F-score of one mission; None where it failed."""
    config = s.problem.config(values)
    key = config.digest(), rock, replicate
    if key not in _known:
        result = kind_on(rock, "geometric")(config, rock, replicate, None)
        _known[key] = None if result.status == "failed" else result.metric(METRIC)
    return _known[key]


def truths(s: CampaignSettings, values: Mapping[str, Any], rocks: Sequence[str]) -> dict[str, list[float]]:
    """F-scores by rock in fresh replicates; 0 where a mission failed."""
    replicates = range(FRESH, FRESH + TRUTH_REPLICATES)
    return {rock: [outcome(s, values, rock, k) or 0.0 for k in replicates] for rock in rocks}


def mean(values: Mapping[str, Sequence[float]]) -> float:
    """The mean over rocks."""
    return float(np.mean([np.mean(own) for own in values.values()]))


def campaign(
    s: CampaignSettings, change: Callable[[Any], Any] = lambda sampler: sampler
) -> list[Observation]:
    """All missions of a campaign, one after the other."""
    asked, history = s.search, list[Observation]()
    sampler = change(make_sampler(s.sampler, asked))
    for number in range(s.budget):
        (proposal,) = ask_many(sampler, asked, history, [], 1)
        instance, k = next_block(s.problem.instances, s.problem.replicates, history, proposal)
        y = outcome(s, proposal.values, instance.rock, k)
        reason = "" if y is not None else "failed"
        history.append(Observation(number, proposal.values, instance.rock, k, y, y, reason))
    return history


def recommended(s: CampaignSettings, history: Sequence[Observation]) -> Recommendation:
    """By the product's rule."""
    best = recommend(s.problem, s.goal, history, only_verified=s.sampler == "gp")
    assert best is not None
    return best


def designs(seeds: int, rocks: Sequence[str]) -> None:
    """The best configuration that a search found, plain plans left out, by its model's mean."""
    found: dict[str, list[float]] = {}
    for name, (sampler, arms, change) in VARIANTS.items():
        for seed in range(seeds):
            s = settings(rocks, sampler, seed, 40 if arms else 30)
            found.setdefault(name, []).append(best_found(s, arms, change))
        print_gains(found, "random")


def dropped(seeds: int, rocks: Sequence[str]) -> None:
    """The same by the product's sampler in spaces that hold some parameters at the default."""
    found: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, left_out in DROPPED.items():
            data = yaml.safe_load(Path("search_spaces/plan_and_gate.yaml").read_text())
            for own in (data["parameters"], *data["begin"]):
                for key in left_out:
                    own.pop(key, None)
            path = Path(folder) / f"without_{len(left_out)}.yaml"
            path.write_text(yaml.safe_dump(data, sort_keys=False))
            for seed in range(seeds):
                s = settings(rocks, seed=seed, space=str(path))
                found.setdefault(name, []).append(best_found(s))
            print_gains(found, next(iter(DROPPED)))


def best_found(
    s: CampaignSettings, arms: bool = True, change: Callable[[Any], Any] = lambda sampler: sampler
) -> float:
    """True F-score of the best configuration that one campaign found beside the plain plans."""
    plain = [dict(values) for values in s.problem.arms.values()]
    if not arms:
        only_default = {"hyb-h": s.problem.default}
        s.__dict__["problem"] = dataclasses.replace(s.problem, arms=only_default)
    history = campaign(s, change)
    model = InstanceMeanGP(s.space, history, s.problem.instances)
    own = [v for v in distinct_configurations(s.space, model.observations) if v not in plain]
    return mean(truths(s, own[int(model.posterior(own).mean.argmax())], s.rocks))


def print_gains(found: Mapping[str, Sequence[float]], against: str) -> None:
    """The newest row: mean and worst seed, and the paired difference from ``against`` where that has run."""
    name, values = list(found.items())[-1]
    text = f"| {name} | {np.mean(values):.2f} (worst {min(values):.2f}) |"
    rows = found.items() if name == against else [(name, values)]
    for row, scores in rows if against in found else []:
        gains = mean_interval({str(k): [a - b] for k, (a, b) in enumerate(zip(scores, found[against]))})
        if row != against and gains is not None:
            text += f" {row} minus {against} {gains.mean:+.2f} [{gains.low:+.2f}, {gains.high:+.2f}] |"
    print(text, flush=True)


def campaigns(seeds: int) -> None:
    """What campaigns advise, against the best plain plan on the same unseen targets."""
    print(
        "| trained on | seed | advice | unseen: minus best plain plan | minus Hyb-H | best plain plan |\n|---|---|---|---:|---:|---|"
    )
    beaten = 0
    for rocks in (*ROCKS, *SHAPES):
        unseen = UNSEEN_ROCKS
        if rocks in SHAPES:
            unseen = tuple(
                f"{rock.partition('-')[0]}-{HELD_OUT_FROM + k}" for rock in rocks for k in range(2)
            )
        for seed in range(seeds):
            s = settings(rocks, seed=seed)
            best = recommended(s, campaign(s))
            plans = {**s.problem.arms, **plain_plans(s.problem.space, s.problem.base, ORBITS)}
            plain = {name: truths(s, values, unseen) for name, values in plans.items()}
            top, own = max(plain, key=lambda name: mean(plain[name])), truths(s, best.values, unseen)
            gain = mean_interval({r: [a - b for a, b in zip(own[r], plain[top][r])] for r in unseen})
            default = mean_interval({r: [a - b for a, b in zip(own[r], plain["hyb-h"][r])] for r in unseen})
            assert gain is not None and default is not None and gain.high is not None
            beaten += gain.high < 0
            advice = (
                best.plain
                or f"tuned, {best.values['seed.count']} seeds at {best.values['seed.lowest_deg']:.0f}°"
            )
            shown = [f"{i.mean:+.2f} [{i.low:+.2f}, {i.high:+.2f}]" for i in (gain, default)]
            print(f"| {', '.join(rocks)} | {seed} | {advice} | {shown[0]} | {shown[1]} | {top} |", flush=True)
    print(f"\nbeaten by a plain plan by more than the interval: {beaten} of {seeds * 4}")


def parameters(count: int) -> None:
    """Of random configurations with planned views: the share of the variance that each parameter explains alone, in thirds."""
    s = settings(ROCKS[0])
    rng = np.random.default_rng(0)
    unit: list[Floats] = [rng.random(s.space.dimension) for _ in range(count)]
    values = [s.space.from_unit(u) for u in unit]
    scores = np.array(
        [np.mean([outcome(s, v, i.rock, 0) or 0.0 for i in map(Instance, s.rocks)]) for v in values]
    )
    print(
        f"| parameter | explains of the variance (sd {scores.std():.2f} points) | best third minus worst |\n|---|---:|---:|"
    )
    rows = []
    for p in s.space.parameters:
        groups = [p.to_unit(v[p.path]) for v in values]
        third = np.minimum((3 * np.array(groups)).astype(int), 2)
        means = {k: scores[third == k].mean() for k in set(third.tolist())}
        explained = (
            sum((third == k).mean() * (m - scores.mean()) ** 2 for k, m in means.items()) / scores.var()
        )
        rows.append(
            (
                explained,
                f"| `{p.path}` | {100 * explained:.0f} % | {max(means.values()) - min(means.values()):.2f} |",
            )
        )
    print("\n".join(text for _, text in sorted(rows, reverse=True)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["designs", "dropped", "campaigns", "parameters"])
    parser.add_argument("--shapes", action="store_true", help="on shapes with pockets in place of rocks")
    parser.add_argument("--count", type=int)
    asked = parser.parse_args()
    if asked.what == "designs":
        designs(asked.count or 8, (SHAPES if asked.shapes else ROCKS)[0])
    elif asked.what == "dropped":
        dropped(asked.count or 8, (SHAPES if asked.shapes else ROCKS)[0])
    elif asked.what == "campaigns":
        campaigns(asked.count or 4)
    else:
        parameters(asked.count or 200)
