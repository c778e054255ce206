"""A fidelity that starts another program for every mission, as the Gazebo stack of the paper's authors would be started.

    export MISSION_PROGRAM="bash fly.sh"
    gatetune --plugin external_program.py campaign run --fidelity external-program --space gate --rock slab

The program gets a folder as its last argument, in which it finds ``request.json`` (configuration, rock, replicate), what the authors'
files can say of the configuration, and the rock as ``mesh.ply``. It leaves its dense cloud there as ``dense.ply``, in the frame of the
mesh, and what the mission cost as ``costs.json``, such as ``{"images": 26}``.
"""

import json
import os
import shlex
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from nbv.cache import Store
from nbv.config import MissionConfig
from nbv.errors import MissionFailure, UserError
from nbv.evaluation import evaluate_cloud
from nbv.plugins import register
from nbv.rocks import load_rock
from nbv.types import PointCloud
from tuner.export.photogrammetry_nbv import write_mission, write_scoring, write_text

LIMIT_S = 3000.0  # below --timeout-s, which ends the mission with whatever it has started


def fly(config: MissionConfig, rock: str, replicate: int, directory: Path, **_: Any) -> dict[str, Any]:
    """Run the program once and return the metrics of its cloud against the rock, with its costs."""
    if not (program := shlex.split(os.environ.get("MISSION_PROGRAM", ""))):
        raise UserError("no program flies; name one: export MISSION_PROGRAM='bash fly.sh'")
    folder, truth = directory / "program", load_rock(rock, store := Store())
    folder.mkdir(parents=True, exist_ok=True)
    trimesh.Trimesh(truth.vertices_m, truth.faces, process=False).export(folder / "mesh.ply")
    request = {"configuration": config.to_dict(), "rock": rock, "replicate": replicate}
    (folder / "request.json").write_text(json.dumps(request))
    for name, write in {"scoring.yaml": write_scoring, "unified_mission.yaml": write_mission}.items():
        try:
            (folder / name).write_text(write_text(write(config)[0], name))
        except UserError as error:  # such as a gate that they do not have: the search learns it
            raise MissionFailure("not_expressible", str(error)) from error
    try:
        subprocess.run([*program, folder], capture_output=True, text=True, timeout=LIMIT_S, check=True)
    except subprocess.TimeoutExpired as error:
        raise MissionFailure("timeout", f"{program[0]} took longer than {LIMIT_S:.0f} s") from error
    except subprocess.CalledProcessError as error:
        last = (error.stderr or error.stdout).strip().rpartition("\n")[2]
        raise MissionFailure("program_failed", f"{program[0]}: status {error.returncode}, {last}") from error
    points_m = np.asarray(trimesh.load(folder / "dense.ply", process=False).vertices, dtype=float)
    costs = json.loads((folder / "costs.json").read_text())
    return {**evaluate_cloud(PointCloud(points_m), truth, config, store).metrics, "costs": costs}


register("fidelities", "external-program", fly)
