"""Does the landscape of earlier missions help as a feature of the surrogate? 24 missions on four synthetic rocks after 96 on four others.

OMP_NUM_THREADS=1 python -m research.earlier_feature
"""

from __future__ import annotations

import numpy as np

from research.optimiser_comparison import common_recommendation
from research.optimiser_problems import FourRocks
from research.optimiser_strategies import SecondCampaign
from tuner.problem.blocks import next_block
from tuner.problem.observations import Observation, Proposal
from tuner.samplers.design import sobol_point
from tuner.samplers.earlier_missions import EarlierMissions

MISSIONS, BEFORE, SEEDS, LOOKS = 24, 96, 8, (12, 24)


class Plain(EarlierMissions):
    """They lead the design, and the surrogate does not see them."""

    feature = None


def earlier(seed: int) -> EarlierMissions:
    """A Sobol sequence on rocks with other shifts, offsets and scales."""
    problem, history = FourRocks(seed + 1000), list[Observation]()
    for i in range(BEFORE):
        values, rock, k = sobol_point(problem.space, seed, i), problem.rocks[i % 4], i // 4 % 2
        y = problem.fly(values, rock, k).value
        history.append(Observation(i, values, f"e{rock}", k, y, y))
    return EarlierMissions(problem.space, tuple(f"e{rock}" for rock in problem.rocks), tuple(history))


def truths(seed: int, before: EarlierMissions) -> list[float]:
    """The noiseless value of the recommendation after each of LOOKS."""
    problem, found = FourRocks(seed, budget=MISSIONS), list[float]()
    strategy = SecondCampaign(problem, seed, before)
    for i in range(MISSIONS):
        q = strategy.ask()
        proposal = Proposal(q.values, {}, q.rock, q.replicate)
        (rock, _), k = next_block(problem.rocks, 2, strategy.history, proposal)
        y = problem.fly(q.values, rock, k).value
        strategy.tell(Observation(i, q.values, rock, k, y, y, sampler_state=q.sampler_state))
        if i + 1 in LOOKS:
            values, *_ = common_recommendation(problem, strategy.history, seed, strategy, ours=True)
            found.append(problem.truth(values))
    return found


def main() -> None:
    """One CSV row a seed, then paired differences with bootstrap intervals."""
    rows = []
    print("seed,missions,with,without")
    for seed in range(SEEDS):
        before = earlier(seed)
        plain = Plain(before.space, before.rocks, before.observations)
        rows.append((truths(seed, before), truths(seed, plain)))
        for n, a, b in zip(LOOKS, *rows[-1]):
            print(f"{seed},{n},{a:.4f},{b:.4f}", flush=True)
    rng = np.random.default_rng(0)
    for i, n in enumerate(LOOKS):
        d = np.array([a[i] - b[i] for a, b in rows])
        low, high = np.percentile(rng.choice(d, (10_000, SEEDS)).mean(1), [2.5, 97.5])
        print(f"# {n} missions, with minus without: {d.mean():+.3f} [{low:+.3f}, {high:+.3f}]")


if __name__ == "__main__":
    main()
