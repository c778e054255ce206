"""A mission function that takes no time: a smooth known function, rock shifts, noise, accidents.

The first letters of a rock's name choose its behaviour: ``abort``, ``exit``, ``kill``, ``stop``, ``raise``, ``fail``,
``hang``, ``start`` (a process, and hang), ``late`` (a result, and hang), ``hog`` (all memory that it may have), ``full``, ``slow``,
``once-...`` (so at the first flight only); any other rock is plain.
"""

import hashlib
import math
import os
import resource
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np

from nbv.config import MissionConfig
from nbv.errors import MissionFailure
from nbv.mission.result import MissionResult
from nbv.plugins import register
from tuner.missions.registry import MissionKind

NOISE_SD = 0.03
BEST = (0.75, 0.3)  # gate.budget_fraction, and gate.d95_m from 0.01 to 1 on a logarithmic scale


def truth(config: MissionConfig) -> float:
    """Noiseless outcome without rock shift; 1 at ``BEST``, about 0.51 at the paper's thresholds."""
    x = config.gate.budget_fraction
    y = math.log(config.gate.d95_m / 0.01) / math.log(100.0)
    return math.exp(-4 * (x - BEST[0]) ** 2 - 4 * (y - BEST[1]) ** 2)


def draw(*key: object) -> np.random.Generator:
    digest = hashlib.sha256(repr(key).encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:8], "little"))


def rock_shift(rock: str) -> tuple[float, float]:
    """(offset, scale) of a rock."""
    rng = draw("rock", rock)
    return float(rng.uniform(-0.5, 0.5)), float(rng.uniform(0.7, 1.4))


def well_flown(
    config: MissionConfig, rock: str, replicate: int, metrics: dict[str, Any], images: float = 32.0
) -> MissionResult:
    """A mission without a trace that went well; whoever made it replaces what differs."""
    return MissionResult(
        status="ok",
        reason="",
        message="",
        condition=getattr(config, "condition", "ideal"),
        config_digest=config.digest(),
        rock=rock,
        replicate=replicate,
        metrics=metrics,
        trace=[],
        timings_s={"flight": 0.0},
        costs={"images": images, "flight_time_s": 100.0, "path_length_m": 50.0, "wall_s": 0.0},
    )


def fake_mission(
    config: MissionConfig, rock: str, replicate: int, directory: Path | None, *, keep: str = "summary"
) -> MissionResult:
    """A mission that takes no time; one line of the file FAKE_FLIGHTS, where the environment names one, when it ends."""
    if rock.startswith("once") and directory is not None and not (directory / "once.txt").exists():
        (directory / "once.txt").write_text("")  # the first flight of a rock such as once-kill is a bad one
        rock = rock.removeprefix("once-")
    if rock.startswith("kill"):
        os.kill(os.getpid(), signal.SIGKILL)
    if rock.startswith("stop"):
        os.kill(os.getpid(), signal.SIGSTOP)
    if rock.startswith("abort"):
        os.abort()
    if rock.startswith("raise"):
        raise RuntimeError("an exception nobody expected")
    if rock.startswith("fail"):
        raise MissionFailure("seed_model_failed", "no seed model")
    if rock.startswith("full"):
        raise OSError(28, "No space left on device")
    if rock.startswith("exit"):
        os._exit(3)
    if rock.startswith("start") and directory is not None:
        started = subprocess.Popen(["sleep", "600"])
        (directory / "started.txt").write_text(str(started.pid))
    if rock.startswith(("hang", "start")):
        time.sleep(600)
    if rock.startswith("hog"):
        resource.setrlimit(resource.RLIMIT_AS, (2**33, resource.RLIM_INFINITY))
        np.ones(2**31)  # 16 GiB
    if rock.startswith("slow"):
        time.sleep(0.25)
    offset, scale = rock_shift(rock)
    noise = NOISE_SD * float(draw("noise", rock, replicate, config.digest()).normal())
    score = offset + scale * (truth(config) + noise)
    if directory is not None:
        with (directory / "run.txt").open("a") as file:  # a line per flight: shows repeats
            file.write("run\n")
    if "FAKE_FLIGHTS" in os.environ:
        with Path(os.environ["FAKE_FLIGHTS"]).open("a") as file:
            file.write(f"{rock} {replicate} {config.digest()}\n")
    metrics = {
        "observable": {"f_score_48mm": score, "accuracy_48mm": score - 0.5},
        "whole": {"completeness_48mm": score},
    }
    result = well_flown(config, rock, replicate, metrics, float(config.photographs))
    if rock.startswith("late") and directory is not None:
        (directory / "mission.json").write_text(result.to_json())
        time.sleep(600)
    return result


OVER_ROCKS = MissionKind(fake_mission, targets="rocks")  # what it is given are rocks of the catalogue
register("fidelities", "fake", fake_mission)
register("fidelities", "fake-on-rocks", OVER_ROCKS)
