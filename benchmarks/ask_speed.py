"""How long a sampler takes to ask: 200 observations, 8 parameters, 6 rocks, one core.

    OMP_NUM_THREADS=1 python benchmarks/ask_speed.py

The space is ``gate_and_weights``; outcomes are a smooth function of it with an offset and scale per rock, and noise.
All samplers but SMAC are given the same 200 random configurations, rocks and two replicates in turn. SMAC races the
configurations it was told of before it proposes a new one, so it flies its 200 missions itself and only asks that
give a new configuration are timed (the others take some hundredths of a second).

Each ask is told one more observation than the one before; one ask to warm up is not counted. CPU seconds, those
of a peer's own process included, because other programs disturb wall-clock times; ratios are to our GP in this run.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np  # noqa: E402

from nbv.config import preset  # noqa: E402
from nbv.errors import UserError  # noqa: E402
from tuner.problem.blocks import next_block  # noqa: E402
from tuner.problem.observations import Observation, Proposal  # noqa: E402
from tuner.problem.search_space import load_search_space  # noqa: E402
from tuner.samplers.base import Sampler, SamplerSettings  # noqa: E402
from tuner.samplers.peers import OWN_DESIGN, available_peers  # noqa: E402
from tuner.samplers.registry import SAMPLER_NAMES, make_sampler  # noqa: E402

SPACE = load_search_space("gate_and_weights")
ROCKS = tuple(f"rock-{i}" for i in range(6))
REPLICATES = 2
NOISE_SD = 0.3
_WEIGHTS = np.random.default_rng(1).normal(size=SPACE.dimension)
_CENTRE = np.random.default_rng(2).uniform(0.2, 0.8, SPACE.dimension)


def observe(
    number: int, proposal: Proposal, history: list[Observation], rng: np.random.Generator
) -> Observation:
    """Fly ``proposal``."""
    (rock, _), replicate = next_block(ROCKS, REPLICATES, history, proposal)
    u = SPACE.to_unit(proposal.values)
    i = ROCKS.index(rock)
    smooth = float(-3 * ((u - _CENTRE) ** 2).sum() + np.sin(3 * u @ _WEIGHTS))
    y = 50 + 5 * i + (1 + 0.1 * i) * (smooth + NOISE_SD * rng.normal())
    return Observation(number, proposal.values, rock, replicate, y, y)


def history_of(name: str, sampler: Sampler, count: int) -> list[Observation]:
    """``count`` observations: random configurations, or the sampler's own where it races."""
    rng = np.random.default_rng(0)
    history: list[Observation] = []
    for i in range(count):
        if name in OWN_DESIGN:
            proposal = sampler.ask(history, [])
        else:
            proposal = Proposal(SPACE.from_unit(rng.random(SPACE.dimension)), {})
        history.append(observe(i, proposal, history, rng))
    return history


def measure(name: str, count: int, repeats: int) -> list[float]:
    """CPU seconds of ``repeats`` asks."""
    default = SPACE.default(preset("campaign"))
    sampler = make_sampler(
        name, SamplerSettings(SPACE, default, ROCKS, 0, 2 * (SPACE.dimension + 1), REPLICATES)
    )
    history = history_of(name, sampler, count)
    rng = np.random.default_rng(1)
    taken: list[float] = []
    warm = False
    while len(taken) < repeats:
        began = time.process_time()
        proposal = sampler.ask(history, [])
        seconds = time.process_time() - began + float(proposal.why.get("peer_cpu_s", 0.0))
        known = any(o.values == proposal.values for o in history)
        if warm and not (known and name in OWN_DESIGN):
            taken.append(seconds)
        warm = True
        history.append(observe(len(history), proposal, history, rng))
    return taken


def main() -> None:
    """Measure and print a Markdown table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    everything = [*SAMPLER_NAMES, *available_peers()]
    parser.add_argument(
        "--sampler", nargs="+", default=everything, metavar="NAME", help=", ".join(everything)
    )
    parser.add_argument("--observations", type=int, default=200)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    print(
        f"{arguments.observations} observations, {SPACE.dimension} parameters, {len(ROCKS)} rocks, one thread\n"
    )
    print("| sampler | median ask, CPU s | smallest | largest | ratio to gp |\n|---|---|---|---|---|")
    reference: float | None = None
    for name in arguments.sampler:
        try:
            taken = measure(name, arguments.observations, arguments.repeats)
        except UserError as error:
            print(f"| {name} | {error} | | | |")
            continue
        median = statistics.median(taken)
        reference = median if name == "gp" else reference
        ratio = "" if reference is None else f"{median / reference:.2f}"
        print(f"| {name} | {median:.3f} | {min(taken):.3f} | {max(taken):.3f} | {ratio} |", flush=True)


if __name__ == "__main__":
    main()
