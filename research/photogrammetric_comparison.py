"""Samplers against each other on real missions: campaigns judged on fresh replicates.

    OMP_NUM_THREADS=1 python -m research.photogrammetric_comparison --seeds 3 --sampler gp optuna-gp gp+shipped:16

``gp@geometric`` flies nothing but geometric missions until it is judged, ``gp+shipped`` learns from what comes with the program (``--learn-from shipped``),
``gp+earlier`` from the campaign in ``--earlier``; ``:16`` is another budget than ``--budget``.
Every (sampler, seed) is a campaign of its own in ``--out``, begun at the paper's values, recommended by the same rule
(the product's: best posterior mean among what was flown). The recommendations then fly on the same training rocks
with replicates that no campaign has seen; a seed's value is the mean over them. Held-out rocks are not used. Finished
missions are not flown again. ``--after 16 24`` also judges what would have been recommended after so many missions of
the samplers named by ``--looked-into`` (default: the first one).
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy import stats

from nbv.config import MissionConfig
from nbv.errors import UserError
from tuner.campaign.begin import begin_campaign
from tuner.campaign.campaign import Campaign
from tuner.campaign.rock_choice import QUICK_ROCKS, refuse_held_out
from tuner.campaign.session import fly_campaign
from tuner.campaign.settings import CampaignSettings
from tuner.campaign.settings_file import SETTINGS_FILE
from tuner.campaign.shipped import SHIPPED
from tuner.commands.console import rock_arguments
from tuner.evaluation.comparison import values_of
from tuner.evaluation.flying import run_evaluation
from tuner.evaluation.plan import EvaluationPlan
from tuner.missions.executors import LocalProcessExecutor
from tuner.missions.registry import DEFAULT_FIDELITY, registered
from tuner.problem.objective import Objective
from tuner.problem.space_files import load_search_space

REPLICATES = 2  # of a campaign; the judges begin after them


def campaign(arguments: argparse.Namespace, rocks: tuple[str, ...], sampler: str, seed: int) -> Campaign:
    """Flown to its end."""
    name, _, own_budget = sampler.partition(":")
    name, _, fidelity = name.partition("@")
    name, _, before = name.partition("+")
    budget = int(own_budget or arguments.budget)
    directory = arguments.out / directory_name(sampler, seed)
    if (directory / SETTINGS_FILE).is_file():
        found = Campaign.open(directory)
    else:
        space = load_search_space(arguments.space)
        found = begin_campaign(
            directory,
            CampaignSettings(
                name=directory.name,
                space=space,
                rocks=rocks,
                budget=budget,
                replicates=REPLICATES,
                seed=seed,
                sampler=name,
                fidelity=registered(fidelity or DEFAULT_FIDELITY),
                learn_from={"earlier": (arguments.earlier.format(seed=seed),), "shipped": (SHIPPED,)}.get(
                    before, ()
                ),
            ),
        )
    if found.status().finished < budget:
        with LocalProcessExecutor(arguments.workers) as executor:
            fly_campaign(found, executor)
    if found.status().finished < budget:
        raise SystemExit(f"{directory} was interrupted; the same command goes on")
    return found


def directory_name(sampler: str, seed: int) -> str:
    """Of one campaign."""
    return f"{re.sub('[+@:]', '-', sampler)}-{seed}"


def name_after(sampler: str, seed: int, missions: int) -> str:
    """Of the recommendation after the first ``missions`` of a campaign."""
    return f"{directory_name(sampler, seed)}-after-{missions}"


def recommended_after(found: Campaign, missions: int) -> MissionConfig:
    """What the campaign would have recommended after its first ``missions``."""
    result = found.recommend_from([o for o in found.history() if o.number < missions])
    if result is None:
        raise SystemExit(f"{found.directory}: none of the first {missions} missions succeeded")
    return found.settings.config(result.values)


def interval_text(values: Sequence[float]) -> str:
    """Mean with its 95 % t-interval."""
    mean = float(np.mean(values))
    if len(values) < 2:
        return f"{mean:+.2f}"
    half = float(stats.t.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / np.sqrt(len(values)))
    return f"{mean:+.2f} [{mean - half:+.2f}, {mean + half:+.2f}]"


def main() -> None:
    """Fly, judge, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sampler", nargs="+", default=["gp", "tpe", "optuna-gp", "random"])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--budget", type=int, default=48)
    parser.add_argument("--space", default="gate_weights_and_pool")
    parser.add_argument("--rock", action="append", help="training rock; default: those of make tune")
    parser.add_argument("--judges", type=int, default=4, help="fresh replicates per rock")
    parser.add_argument("--after", nargs="+", type=int, default=[], help="missions")
    parser.add_argument("--looked-into", nargs="+", help="samplers")
    parser.add_argument("--earlier", default="", help="a campaign's run directory, with {seed} in its name")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("runs/samplers"))
    arguments = parser.parse_args()
    looked_into = arguments.looked_into or arguments.sampler[:1]
    try:
        rocks = tuple(rock_arguments(arguments.rock or QUICK_ROCKS))
        refuse_held_out(rocks)
        configs = {}
        for seed in range(arguments.seeds):
            for sampler in arguments.sampler:
                flown = campaign(arguments, rocks, sampler, seed)
                configs[directory_name(sampler, seed)] = flown.recommended_config()
                if sampler in looked_into:
                    for missions in arguments.after:
                        configs[name_after(sampler, seed, missions)] = recommended_after(flown, missions)
                configs.setdefault("default", flown.settings.config(flown.settings.default_values()))
                print(f"{sampler} {seed} flown", flush=True)
    except UserError as error:
        parser.error(str(error))
    records = []
    with LocalProcessExecutor(arguments.workers) as executor:
        for name, config in configs.items():
            plan = EvaluationPlan({name: config}, rocks, arguments.judges, REPLICATES)
            records += run_evaluation(plan, arguments.out / "judges" / name, executor).records

    metric = Objective().metric

    def value(name: str) -> float:
        """Mean over the rocks' means."""
        found = values_of(records, name, metric)
        return float(np.mean([np.mean([v for (r, _), v in found.items() if r == rock]) for rock in rocks]))

    ours = [value(directory_name(arguments.sampler[0], seed)) for seed in range(arguments.seeds)]
    print(
        f"| sampler | {metric}, seeds | mean | over the paper's values | {arguments.sampler[0]} minus this |"
    )
    print("|---|---|---:|---:|---:|")
    for sampler in arguments.sampler:
        own = [value(directory_name(sampler, seed)) for seed in range(arguments.seeds)]
        gains = [v - value("default") for v in own]
        against = (
            "–" if sampler == arguments.sampler[0] else interval_text([a - b for a, b in zip(ours, own)])
        )
        seeds = ", ".join(f"{v:.2f}" for v in own)
        print(f"| {sampler} | {seeds} | {np.mean(own):.2f} | {interval_text(gains)} | {against} |")
    print(f"| paper's values | {value('default'):.2f} | | | |")
    if not arguments.after:
        return
    finals = {s: [value(directory_name(s, k)) for k in range(arguments.seeds)] for s in arguments.sampler}
    print(
        "\n| sampler | after missions | seeds | mean | "
        + " | ".join(f"minus {s}'s last" for s in arguments.sampler)
        + " |"
    )
    print("|---|---:|---|---:|" + "---:|" * len(arguments.sampler))
    for sampler in looked_into:
        for missions in arguments.after:
            own = [value(name_after(sampler, seed, missions)) for seed in range(arguments.seeds)]
            behind = [interval_text([a - b for a, b in zip(own, last)]) for last in finals.values()]
            seeds = ", ".join(f"{v:.2f}" for v in own)
            print(f"| {sampler} | {missions} | {seeds} | {np.mean(own):.2f} | {' | '.join(behind)} |")


if __name__ == "__main__":
    main()
