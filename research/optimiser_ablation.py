"""What parts of the optimiser are worth, on a synthetic campaign with a known answer.

The problem is the tests' fake mission: a smooth function of the gate's two thresholds (best value 1, paper's
thresholds about 0.45, standard deviation over the space 0.31), four rocks with their own offset and scale, two
replicates per rock, noise per mission, and an offset per (rock, replicate) block that all configurations share.

The Gaussian process with and without block offsets. Prints Markdown. Run from the repository root::

    OMP_NUM_THREADS=1 python -m research.optimiser_ablation
"""

from __future__ import annotations

import argparse
import functools
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests/support"))

import synthetic

from nbv.types import Floats
from tuner.problem.objective import Objective
from tuner.problem.observations import Observation, next_block
from tuner.recommendation.choose import recommend
from tuner.recommendation.inputs import CampaignData, Goal
from tuner.samplers.gp import GPSampler
from tuner.surrogate.settings import SurrogateSettings

REPLICATES = 2
NOISE_SD = 0.15


@dataclass(frozen=True)
class Outcome:
    """How one campaign ended."""

    value: float  # noiseless value of the recommended configuration, 1 is perfect
    covered: bool  # whether the 95 % interval of the improvement holds the true one
    width: float  # of that interval
    loo_coverage: float


@functools.cache
def play(seed: int, budget: int, block_sd: float, blocks: bool) -> tuple[Observation, ...]:
    """The missions of one campaign, one at a time."""
    rocks = synthetic.ROCKS
    sampler = GPSampler(synthetic.sampler_settings(seed), model=SurrogateSettings(blocks=blocks))
    rng = np.random.default_rng(seed)
    history: list[Observation] = []
    for number in range(budget):
        proposal = sampler.ask(history, [])
        (rock, _), replicate = next_block(rocks, REPLICATES, history, proposal)
        history.append(
            synthetic.observe(number, proposal.values, rock, NOISE_SD, rng, replicate, block_sd, seed)
        )
    return tuple(history)


def campaign(seed: int, budget: int, block_sd: float, *, blocks: bool = True) -> Outcome:
    """How a campaign ends."""
    history = play(seed, budget, block_sd, blocks)
    settings = SurrogateSettings(blocks=blocks)
    default = synthetic.DEFAULT
    data = CampaignData(
        synthetic.SPACE, history, synthetic.ROCKS, default, replicates=REPLICATES, settings=settings
    )
    result = recommend(data, Goal(Objective()))
    assert result is not None
    truth = synthetic.true_rock_mean(result.values) - synthetic.true_rock_mean(default)
    low, high = result.improvement_interval_95
    return Outcome(
        synthetic.true_value(result.values),
        low <= truth <= high,
        high - low,
        result.leave_one_out["coverage_95"],
    )


def paired_interval(differences: Floats) -> tuple[float, float, float]:
    """``(mean, low, high)``: 95 % bootstrap interval of the mean paired difference."""
    rng = np.random.default_rng(0)
    means = rng.choice(differences, (10_000, len(differences))).mean(axis=1)
    low, high = np.percentile(means, [2.5, 97.5])
    return float(differences.mean()), float(low), float(high)


def row(name: str, block_sd: float, outcomes: Sequence[Outcome], reference: Sequence[Outcome] | None) -> str:
    """One line of the table."""
    values = np.array([o.value for o in outcomes])
    difference = "reference"
    if reference is not None:
        mean, low, high = paired_interval(values - np.array([o.value for o in reference]))
        difference = f"{mean:+.3f} ({low:+.3f} to {high:+.3f})"
    return (
        f"| {block_sd:g} | {name} | {values.mean():.3f} | {values.min():.3f} | {difference} | "
        f"{sum(o.covered for o in outcomes)} of {len(outcomes)} | {np.mean([o.width for o in outcomes]):.3f} | "
        f"{100 * np.mean([o.loo_coverage for o in outcomes]):.0f} |"
    )


def main() -> None:
    """Parse, play, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--budget", type=int, default=24)
    parser.add_argument("--block-sd", type=float, nargs="+", default=[0.0, 0.3, 0.6])
    arguments = parser.parse_args()
    variants = {"without block offsets": {"blocks": False}, "with block offsets": {"blocks": True}}
    began = time.process_time()
    print(
        "| block sd | variant | value | worst | paired difference (95 %) | improvement interval holds truth "
        "| its width | LOO coverage % |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for block_sd in arguments.block_sd:
        reference: list[Outcome] | None = None
        for name, options in variants.items():
            outcomes = [
                campaign(seed, arguments.budget, block_sd, **options) for seed in range(arguments.seeds)
            ]
            print(row(name, block_sd, outcomes, reference), flush=True)
            reference = reference or outcomes
    print(f"\n{time.process_time() - began:.0f} CPU seconds")


if __name__ == "__main__":
    main()
