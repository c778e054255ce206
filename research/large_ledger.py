"""A ledger of 10,000 missions: seconds and memory of status, resume and ask; and what the small model costs against the exact one.

    OMP_NUM_THREADS=1 python -m research.large_ledger [--missions 10000] [--seeds 10] [--out FILE.csv]

Space ``gate_and_weights``, three rocks, two replicates; outcomes are a smooth function with an offset per rock and noise,
flown as a search flies them: a third anywhere, the others near the optimum. ``model`` rows compare, at 1,000 missions, the exact
process with the small one (`tuner.surrogate.fit`), which sees a part of them; errors are against the noiseless function,
in standard deviations of a mission's noise; regret is that of the best posterior mean among all that was flown.
"""

from __future__ import annotations

import argparse
import csv
import os
import resource
import subprocess
import sys
import tempfile
import time
import unittest.mock
from pathlib import Path
from typing import Any

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import numpy as np  # noqa: E402

from nbv.mission.result import MissionResult  # noqa: E402
from tuner.campaign.begin import begin_campaign  # noqa: E402
from tuner.campaign.campaign import Campaign  # noqa: E402
from tuner.campaign.settings import CampaignSettings  # noqa: E402
from tuner.missions.job import MissionJob, load_trial  # noqa: E402
from tuner.problem.instances import Instance  # noqa: E402
from tuner.problem.observations import Observation, Proposal  # noqa: E402
from tuner.problem.space_files import load_search_space  # noqa: E402
from tuner.surrogate import fit  # noqa: E402
from tuner.surrogate.model import InstanceMeanGP  # noqa: E402

SPACE = load_search_space("gate_and_weights")
ROCKS = ("boulder", "slab", "waist")
NOISE_SD = 1.0


class Landscape:
    """A quadratic with a ripple, its optimum anywhere."""

    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self.centre = self._rng.uniform(0.2, 0.8, SPACE.dimension)
        self._slopes = self._rng.normal(size=SPACE.dimension)

    def __call__(self, unit: np.ndarray) -> float:
        """Noiseless outcome on the mean rock at a (d,) unit position."""
        away = unit - self.centre
        return float(80 - 20 * (away**2).sum() + 2 * np.sin(6 * away @ self._slopes))

    def position(self, number: int) -> np.ndarray:
        """(d,) where a search flies mission ``number``."""
        if number < 40 or self._rng.random() < 1 / 3:
            return self._rng.uniform(size=SPACE.dimension)
        return np.clip(self.centre + 0.15 * self._rng.normal(size=SPACE.dimension), 0, 1)

    def missions(self, count: int) -> list[Observation]:
        """``count`` finished missions."""
        found = []
        for i in range(count):
            values = SPACE.from_unit(self.position(i))
            y = self(SPACE.to_unit(values)) + 2 * (i % 3) + NOISE_SD * self._rng.normal()
            found.append(Observation(i, values, ROCKS[i % 3], (i // 3) % 2, y, y))
        return found


def small_against_exact(seeds: int, count: int) -> list[dict[str, Any]]:
    """Rows of both models per seed."""
    rows = []
    for seed in range(seeds):
        landscape = Landscape(seed)
        missions = landscape.missions(count)
        fresh = [SPACE.from_unit(landscape.position(count)) for _ in range(500)]
        for name, limit in (("exact", count), ("small", fit.EXACT_MISSIONS)):
            before, fit.EXACT_MISSIONS = fit.EXACT_MISSIONS, limit
            started = time.process_time()
            model = InstanceMeanGP(SPACE, missions, ROCKS)
            took = time.process_time() - started
            fit.EXACT_MISSIONS = before
            evaluated = [o.values for o in missions]
            truth = np.array([landscape(SPACE.to_unit(v)) for v in evaluated])
            best = truth[model.best_first(evaluated)[0]]
            belief = model.posterior(fresh)
            error = belief.mean - 2 - np.array([landscape(SPACE.to_unit(v)) for v in fresh])
            rows.append(
                {
                    "what": f"model, {name}",
                    "seed": seed,
                    "missions": count,
                    "fit_cpu_s": round(took, 2),
                    "rmse": round(float(np.sqrt((error**2).mean())) / NOISE_SD, 4),
                    "inside_95": round(float((np.abs(error) < 1.96 * belief.sd).mean()), 3),
                    "regret": round(float(truth.max() - best) / NOISE_SD, 4),
                }
            )
            print(rows[-1], flush=True)
    return rows


def make_ledger(directory: Path, count: int) -> None:
    """A finished campaign of ``count`` missions, each with its ``mission.json``."""
    settings = CampaignSettings(name="large", space=SPACE, rocks=ROCKS, budget=count, fidelity="geometric")
    ledger = begin_campaign(directory, settings).ledger
    extra = {f"metric_{i}": float(i) for i in range(40)}
    config = settings.base_config()
    with unittest.mock.patch("os.fsync"):  # nothing to lose
        for o in Landscape(0).missions(count):
            proposal = Proposal(dict(o.values), {"sampler": "gp"})
            trial = ledger.start(proposal, Instance(o.rock, "ideal"), o.replicate, "", config.digest())
            trial.path.mkdir(parents=True)
            result = MissionResult(
                "ok",
                "",
                "",
                config.digest(),
                o.rock,
                o.replicate,
                metrics={"observable": {"f_score_48mm": o.outcome}, "more": extra},
                trace=[],
                timings_s={},
                costs={"flight_time_s": 300.0, "wall_s": 4.0},
            )
            (trial.path / "mission.json").write_text(result.to_json())
            ended = load_trial(MissionJob(str(trial.number), config, o.rock, o.replicate, trial.path))
            assert ended is not None
            ledger.finish(trial.number, ended)


def command(name: str, directory: Path, what: str) -> dict[str, Any]:
    """Seconds and the largest memory so far of a command on the run directory."""
    started = time.monotonic()
    program = [sys.executable, "-m", "tuner.cli", "campaign", name, str(directory)]
    subprocess.run(program, check=True, stdout=subprocess.DEVNULL)
    seconds = time.monotonic() - started
    memory = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20
    return {"what": what, "seconds": round(seconds, 1), "memory_gb": round(memory, 2)}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--missions", type=int, default=10_000)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as home:
        directory = Path(home) / "large"
        make_ledger(directory, options.missions)
        campaign = Campaign.open(directory, read_only=True)
        trials = campaign.trials()
        started = time.monotonic()
        campaign.propose(trials, len(trials))
        seconds = round(time.monotonic() - started, 1)
        memory = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 2)
        rows: list[dict[str, Any]] = [{"what": "ask", "seconds": seconds, "memory_gb": memory}]
        campaign.recommendation()  # as a session leaves it
        (directory / "report.html").touch()
        rows.append(command("status", directory, "status"))
        for what in ("flies the two shown missions", "all shown before"):
            rows.append(command("resume", directory, f"resume, {what}"))
    for row in rows:
        row["missions"] = options.missions
        print(row, flush=True)
    rows += small_against_exact(options.seeds, 1000)
    if options.out:
        fields = list(dict.fromkeys(key for row in rows for key in row))
        with options.out.open("w", newline="") as file:
            writer = csv.DictWriter(file, fields)
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
