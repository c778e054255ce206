"""How campaigns grow with workers: the product's own coordinator, ledger and executor, missions replaced by waits.

    OMP_NUM_THREADS=1 python -m research.scaling busy --workers 8 64 512 [--seconds 20] --out FILE.csv
    OMP_NUM_THREADS=1 python -m research.scaling dask [--missions 40] [--seconds 5] --out FILE.csv
    OMP_NUM_THREADS=1 python -m research.scaling value [--workers 64 2] [--problem four-rocks:0.3] [--missions 256] [--seeds 10] --out FILE.csv
    OMP_NUM_THREADS=1 python -m research.scaling growth [--missions 12000] --out FILE.csv

``busy``: a campaign of sampler gp (``gate_and_weights``, six rocks) on a real Dask scheduler, of whose workers every thread is a
slot. A slot waits in proportion to the photographs of measured missions (``field_missions.csv``), ``--seconds`` in the mean, and
answers with a synthetic score. The share is of all slots, from when all have run to when the last mission is launched: the
slots' own times.
``dask``: the same campaign, two workers, by local processes and by a local Dask cluster, in turns; wall and CPU seconds. Its
missions are geometric, or take ``--seconds`` in which they compute nothing.
``value``: how good the recommendation is with 64 missions in flight against 2, on Hartmann-6 in 10 dimensions on four rocks; batches
as a campaign with so many workers makes them, looked at from half of the missions on; ``geometric`` on the low-fidelity simulator.
``growth``: memory and disk for a mission, from a third of a campaign to its end. Of the coordinator with missions that take no
time and have 40 metrics more, so that a campaign of days passes in minutes; then of everything with real geometric missions, a
twentieth as many.
"""

from __future__ import annotations

import argparse
import csv
import gc
import heapq
import json
import os
import resource
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
ROOT = Path(__file__).resolve().parent.parent

import numpy as np  # noqa: E402
from distributed import Client, LocalCluster  # noqa: E402

from nbv.mission.result import MissionResult  # noqa: E402
from nbv.mission.run_directory import RESULT  # noqa: E402
from tuner.campaign.begin import begin_campaign  # noqa: E402
from tuner.campaign.events import CampaignEvent  # noqa: E402
from tuner.campaign.session import (  # noqa: E402
    MAX_BATCH,
    SHARE,
    run_campaign,
)
from tuner.campaign.settings import CampaignSettings  # noqa: E402
from tuner.missions.cluster import worker  # noqa: E402
from tuner.missions.cluster.executor import DaskExecutor  # noqa: E402
from tuner.missions.executors import LocalProcessExecutor  # noqa: E402
from tuner.missions.job import MissionJob, Trial  # noqa: E402
from tuner.problem.observations import Observation  # noqa: E402
from tuner.problem.search_space import builtin  # noqa: E402
from tuner.problem.space_files import load_search_space  # noqa: E402
from tuner.samplers.base import (  # noqa: E402
    SamplerSettings,
    ask_many,
    in_flight,
    make_sampler,
)
from tuner.surrogate.model import InstanceMeanGP  # noqa: E402

ROCKS = ("boulder", "slab", "waist", "vesicular", "cavern", "breccia")
PROCESSES = 4  # of workers; their threads are the slots
MARKS = (0.5, 0.625, 0.75, 0.875, 1.0)  # of a campaign's missions, where its recommendation is looked at


def measured(mean_s: float) -> list[float]:
    """Durations in proportion to the photographs of measured missions."""
    with (ROOT / "docs/results/data/field_missions.csv").open() as file:
        images = [float(row["images"]) for row in csv.DictReader(file)]
    return [mean_s * count / statistics.mean(images) for count in images]


class Waits:
    """What workers do instead of running missions."""

    def __init__(self, durations: list[float]) -> None:
        self.durations = durations

    def __call__(self, order: dict[str, Any], rock: bytes | None) -> dict[str, Any]:
        job, begin = MissionJob.from_dict(order["job"]), time.time()
        rng = np.random.default_rng(int(job.id))
        time.sleep(rng.choice(self.durations))
        gate = builtin(job.config).gate
        score = 80 - 20 * (gate.budget_fraction - 0.4) ** 2 + rng.normal()
        end = time.time()
        result = MissionResult(
            status="ok",
            reason="",
            message="",
            config_digest=job.config.digest(),
            rock=job.rock,
            replicate=job.replicate,
            metrics={"observable": {"f_score_48mm": score}},
            trace=[],
            timings_s={},
            costs={"flight_time_s": 300.0, "begin": begin, "end": end},
        )
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, RESULT).write_text(result.to_json())
            files = worker.pack(Path(folder))
        return {"reason": "", "message": "", "wall_s": end - begin, "files": files}


def busy(workers: int, seconds: float, rounds: int) -> dict[str, Any]:
    """One row."""
    waits, missions = Waits(measured(seconds)), max(rounds * workers, 64)
    worker.run = waits  # type: ignore[assignment]
    space = load_search_space("gate_and_weights")
    with tempfile.TemporaryDirectory() as home:
        settings = CampaignSettings(
            name="scaling", space=space, rocks=ROCKS, budget=missions, fidelity="geometric"
        )
        campaign = begin_campaign(Path(home) / "run", settings)
        count = min(PROCESSES, workers)
        cluster = LocalCluster(
            n_workers=count,
            threads_per_worker=workers // count,
            host="127.0.0.1",
            dashboard_address=None,
            silence_logs=50,
        )
        began = time.process_time()
        with DaskExecutor(Client(cluster, set_as_default=False)) as executor:
            summary = run_campaign(campaign, executor)
        used = time.process_time() - began
        times = sorted((t.costs["begin"], t.costs["end"]) for t in campaign.trials())
    first, last = times[workers - 1][0], times[-1][0]
    inside = sum(max(0.0, min(end, last) - max(begin, first)) for begin, end in times)
    return {
        "what": "busy",
        "workers": workers,
        "missions": missions,
        "share": round(inside / (workers * (last - first)), 3),
        "missions_per_s": round(sum(first < b <= last for b, _ in times) / (last - first), 2),
        "first_round_s": round(first - times[0][0], 1),
        "coordinator_cpu_ms": round(1000 * used / missions, 1),
        "elapsed_s": round(summary.elapsed_s, 1),
        "memory_gb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 2),
    }


def against_local(missions: int, repeats: int, seconds: float | None) -> list[dict[str, Any]]:
    """Rows of both executors, in turns."""
    space, rows = load_search_space("gate_and_weights"), []
    fidelity = "geometric" if seconds is None else "research.faults_mission:run_missions"
    os.environ |= {
        "FAULTS_SECONDS": str(seconds),
        "FAULTS_RECORD": os.devnull,
        "PYTHONPATH": str(ROOT),
    }
    for repeat in range(repeats):
        for name in ("local", "dask") if repeat % 2 else ("dask", "local"):
            with tempfile.TemporaryDirectory() as home:
                settings = CampaignSettings(
                    name="two",
                    space=space,
                    rocks=ROCKS[:3],
                    budget=missions,
                    fidelity=fidelity,
                    sampler="sobol",
                )
                campaign = begin_campaign(Path(home) / "run", settings)
                if name == "local":
                    executor: Any = LocalProcessExecutor(2, preload=(fidelity,))
                else:
                    cluster = LocalCluster(
                        2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, silence_logs=50
                    )
                    executor = DaskExecutor(Client(cluster, set_as_default=False))
                with executor:
                    run_campaign(campaign, executor)  # begins with whatever imports take
                ends = sorted(t.finished for t in campaign.trials() if t.finished)
                warm = (ends[-1] - ends[len(ends) // 4]).total_seconds()
                wall = sum(t.wall_s for t in campaign.trials()[len(ends) // 4 :])
                rows.append(
                    {
                        "what": name,
                        "seconds": seconds,
                        "seed": repeat,
                        "missions": missions,
                        "warm_s": round(warm, 2),
                        "wall_s": round(wall, 2),
                    }
                )
                print(rows[-1], flush=True)
    return rows


class Instant:
    """An executor whose missions take no time."""

    capacity = 2

    def __init__(self) -> None:
        self._jobs: list[MissionJob] = []

    def submit(self, job: MissionJob) -> None:
        """Run."""
        self._jobs.append(job)

    def wait_any(self, timeout_s: float) -> list[Trial]:
        """All."""
        jobs, self._jobs = self._jobs, []
        return [self._outcome(job) for job in jobs]

    def cancel_all(self) -> None:
        """Nothing runs."""
        self._jobs = []

    def _outcome(self, job: MissionJob) -> Trial:
        rng = np.random.default_rng(int(job.id))
        more = {f"metric_{i}": float(v) for i, v in enumerate(rng.uniform(size=40))}
        metrics = {"observable": {"f_score_48mm": float(rng.normal(80, 5))}, "more": more}
        costs, timings = {"flight_time_s": 300.0, "images": 20.0}, {"begin": 0.0, "end": 1.0}
        measured = {"metrics": metrics, "costs": costs, "timings_s": timings}
        return job.trial(status="ok", measured_then=measured, wall_s=1.0)


def kilobytes(process: int) -> int:
    """Memory, with what it shares: the share of a server that forks depends on how many missions run."""
    lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("Rss:"))


def growth(executor: Any, missions: int) -> dict[str, Any]:
    """One row: kB for a mission after the first third."""
    marks: dict[int, list[int]] = {}
    with tempfile.TemporaryDirectory() as home:
        settings = CampaignSettings(
            name="growth",
            space=load_search_space("gate_and_weights"),
            rocks=ROCKS[:3],
            budget=missions,
            fidelity="geometric",
            sampler="sobol",
        )
        campaign = begin_campaign(Path(home) / "run", settings)

        def note(event: CampaignEvent) -> None:
            if event.kind == "finished" and event.finished in (missions // 3, missions):
                gc.collect()
                server = getattr(executor, "_server", None)
                disk = sum(f.stat().st_blocks for f in Path(home).rglob("*")) // 2
                evaluated = [kilobytes(os.getpid()), 0 if server is None else kilobytes(server.pid), disk]
                marks[event.finished] = evaluated

        run_campaign(campaign, executor, note)
    first, last = marks[missions // 3], marks[missions]
    each = [round((b - a) / (missions - missions // 3), 2) for a, b in zip(first, last)]
    return {
        "what": f"growth, {type(executor).__name__}",
        "missions": missions,
        "memory_gb": round(last[0] / 2**20, 3),
        "coordinator_kb": each[0],
        "server_kb": each[1],
        "disk_kb": each[2],
    }


def value(name: str, width: int, missions: int, seed: int) -> list[dict[str, Any]]:
    """Rows: the truth of what is best by the posterior mean, at `MARKS` of ``missions``, ``width`` in flight."""
    from research.optimiser_problems import make_problem

    problem = make_problem(name, seed, Path(tempfile.gettempdir()) / "scaling_value")
    settings = SamplerSettings(
        problem.space, problem.default, problem.rocks, seed, 20, problem.replicates, budget=None
    )
    sampler, rng = make_sampler("gp", settings), np.random.default_rng(seed)
    history: list[Observation] = []
    running: dict[int, tuple[float, Observation]] = {}
    queue: list[tuple[float, int]] = []
    number, clock = 0, 0.0
    marks: dict[int, dict[str, Any]] = {int(share * missions): {} for share in MARKS}
    while len(history) < missions:
        free = min(width - len(running), missions - number)
        if free >= (1 if width < 8 else min(width // SHARE, MAX_BATCH)) or (free and not running):
            pending = [p for _, p in running.values()]
            for proposal in ask_many(sampler, settings, history, pending, free):
                mission = in_flight(settings, history, [p for _, p in running.values()], proposal)
                end = clock + float(rng.lognormal(0.0, 0.3))
                running[number] = (end, mission)
                heapq.heappush(queue, (end, number))
                number += 1
        clock, ended = heapq.heappop(queue)
        p = running.pop(ended)[1]
        y = problem.run(dict(p.values), p.rock, p.replicate).value
        history.append(Observation(ended, p.values, p.rock, p.replicate, y, y))
        if len(history) in marks:
            model = InstanceMeanGP(problem.space, history, problem.rocks)
            evaluated = [dict(o.values) for o in history]
            found = problem.truth(evaluated[model.best_first(evaluated)[0]])
            marks[len(history)] = {
                "what": f"value, {name}",
                "workers": width,
                "missions": len(history),
                "seed": seed,
                "value": round(found, 4),
            }
    return list(marks.values())


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("part", choices=("busy", "dask", "value", "growth"))
    parser.add_argument("--workers", type=int, nargs="+")
    parser.add_argument("--problem", default="four-rocks:0.3")
    parser.add_argument("--seconds", type=float)
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--missions", type=int)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []

    def keep(row: dict[str, Any]) -> None:
        rows.append(row)
        print(json.dumps(row), flush=True)
        with options.out.open("w", newline="") as file:
            writer = csv.DictWriter(file, list(dict.fromkeys(key for r in rows for key in r)))
            writer.writeheader()
            writer.writerows(rows)

    if options.part == "busy":
        for workers in options.workers or (8, 64, 512):
            keep(busy(workers, options.seconds or 20.0, options.rounds))
    elif options.part == "dask":
        for row in against_local(options.missions or 40, options.seeds, options.seconds):
            keep(row)
    elif options.part == "growth":
        missions = options.missions or 12_000
        keep(growth(Instant(), missions))
        with LocalProcessExecutor(2, preload=("geometric",)) as executor:
            keep(growth(executor, missions // 20))
    else:
        for seed in range(options.seeds):
            for width in options.workers or (64, 2):
                for row in value(options.problem, width, options.missions or 256, seed):
                    keep(row)


if __name__ == "__main__":
    main()
