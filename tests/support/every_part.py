"""A distribution that is installed in a folder: a tiny part of each group of plug-ins."""

from pathlib import Path

PARTS = '''
"""A part of each group."""

import numpy as np

from nbv.config import Weights
from nbv.dense.stereo import sgbm_depth_maps
from nbv.evaluation.registry import Metric
from nbv.gates import Gate
from nbv.geometric.geometric_fidelity import GeometricFidelity
from nbv.rocks import sdf
from nbv.scene.raycast import RaycastRenderer
from nbv.scorers import Scorer
from nbv.types import GateDecision
from tuner.samplers.base import PlainSampler

LOW = Scorer("low", lambda terms, pool, config: 1.0 - pool.positions_m[:, 2] / 4.0, weights=lambda config: Weights())


class Last(Gate):
    def decide(self, state, pool, rankings):
        return GateDecision(rankings["b-aware"], "always")


class Dim(RaycastRenderer):
    def rgb(self, camera_from_world):
        return super().rgb(camera_from_world) // 2


def nearer(views):
    """Everything stands a twentieth nearer than it does."""
    return {name: 0.95 * depth_m for name, depth_m in sgbm_depth_maps(views).items()}


FARTHEST = Metric("farthest_mm", "Farthest", "mm", False, lambda distances, t: float(distances.to_cloud_mm.max()))


def egg(p, rng, seed):
    """a smooth egg"""
    return sdf.ellipsoid(p, (0.0, 0.0, 0.75), (rng.uniform(0.5, 0.6), 0.5, 0.8), np.eye(3))


class Counted(GeometricFidelity):
    name = "counted"

    def measure(self, cloud):
        return {**super().measure(cloud), "views": float(len(self.context.config.plugins_used))}
'''
PLACES = {
    "scorers": ("low", "LOW"),
    "gates": ("last", "Last"),
    "renderers": ("dim", "Dim"),
    "dense": ("nearer", "nearer"),
    "metrics": ("farthest", "FARTHEST"),
    "samplers": ("drawn", "PlainSampler"),
    "fidelities": ("counted", "Counted.run"),
    "families": ("egg", "egg"),
}


def install(folder: Path) -> Path:
    """Write the module and what pip writes of it; its file. The folder belongs on ``sys.path``."""
    about = folder / "every_part-1.2.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: every-part\nVersion: 1.2\n")
    lines = [
        f"[gatetune.{group}]\n{name} = every_part_module:{part}" for group, (name, part) in PLACES.items()
    ]
    (about / "entry_points.txt").write_text("\n".join(lines) + "\n")
    (folder / "every_part_module.py").write_text(PARTS)
    return folder / "every_part_module.py"
