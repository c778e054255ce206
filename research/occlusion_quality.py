"""How well sparse points alone tell what a candidate sees: precision and recall against ray casting on the mesh.

    OMP_NUM_THREADS=1 python -m research.occlusion_quality [--mission RUN ROCK]... [--shared ../shared]

Judges the two visibility models of the scorers, ``frustum`` (the paper's) and ``occlusion`` (ours: sparse
points and their observing rays only), and two simpler tests for comparison, on planning states:

* the golden states of ../shared (real reconstructions of two Apollo rocks). The constants of the occlusion
  test were chosen on these, so its numbers there are flattering;
* every second state of each ``--mission``, a run directory flown with everything kept, with the rock that it
  shows (catalogue name or mesh file). Nothing was chosen on those.

For every fourth candidate, every box point in its frustum is truly visible or not: a ray from the camera
meets nothing more than 4 cm before the point. "Visible" is the positive class. Candidates and states of a
rock are pooled. Precision: of the (point, candidate) pairs that a test calls visible, the share that is.
Recall: of the pairs that are visible, the share that the test finds. Balanced: the mean of recall and of
the share of hidden pairs that are called hidden. Correlation, over candidates, mean over states: number of
rock points called visible against number visible, which is what a ranking lives on.

Points on the rock lie within 5 cm of the mesh and above 5 cm; "all" adds the ground and what is wrong.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from nbv.cache import Store
from nbv.config import MissionConfig, config_from_dict
from nbv.geometry.frustum import in_frustum
from nbv.geometry.raycasting import RayCaster
from nbv.mission.planning_state import load_state
from nbv.rocks import load_rock
from nbv.scorers import BoxPoints, box_points
from nbv.scorers.occlusion import mean_observing_directions, unoccluded
from nbv.types import Floats

CASES = (
    ("15016_seed_paper_weights", "apollo_15016_0"),
    ("15016_40_views_low_novelty_10deg_ring", "apollo_15016_0"),
    ("65035_40_views_other_weights", "apollo_65035_0"),
)
CANDIDATE_STEP, STATE_STEP = 4, 2
TOLERANCE_M = 0.04  # a reconstructed point lies up to this far behind the true surface
Mask = NDArray[np.bool_]


def golden_mesh(path: Path) -> RayCaster:
    """The mesh as the golden reconstructions show it: 1.6 m tall, resting on z = 0, centred."""
    mesh = trimesh.load(path, force="mesh", process=False)
    vertices = np.asarray(mesh.vertices)
    vertices = vertices * 1.6 / np.ptp(vertices[:, 2])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    vertices -= [*((low + high) / 2)[:2], low[2]]
    return RayCaster(vertices, np.asarray(mesh.faces))


@dataclass(frozen=True)
class Counts:
    """(point, candidate) pairs by truth and answer; adding pools them."""

    found: int = 0  # visible, called visible
    missed: int = 0  # visible, called hidden
    wrong: int = 0  # hidden, called visible
    rejected: int = 0  # hidden, called hidden

    def __add__(self, other: Counts) -> Counts:
        return Counts(
            self.found + other.found,
            self.missed + other.missed,
            self.wrong + other.wrong,
            self.rejected + other.rejected,
        )

    @property
    def precision(self) -> float:
        return _share(self.found, self.wrong)

    @property
    def recall(self) -> float:
        return _share(self.found, self.missed)

    @property
    def balanced(self) -> float:
        return (self.recall + _share(self.rejected, self.wrong)) / 2


def _share(part: int, rest: int) -> float:
    return part / (part + rest) if part + rest else float("nan")


class Case:
    """Box points, candidates and the truth of one planning state."""

    def __init__(
        self,
        box: BoxPoints,
        candidates_m: Floats,
        caster: RayCaster,
        config: MissionConfig,
    ) -> None:
        self.box, self.candidates, points_m = box, candidates_m, box.points_m
        self.frustum = in_frustum(points_m, candidates_m, np.array(config.target_m), config.camera)
        to_point = points_m[:, None] - candidates_m[None]
        self.distance = np.linalg.norm(to_point, axis=2)
        rays = np.concatenate([np.broadcast_to(candidates_m[None], to_point.shape), to_point], axis=2)
        hit = caster.cast(rays.astype(np.float32))
        self.truth: Mask = self.frustum & (hit.t > 1.0 - TOLERANCE_M / self.distance)
        from_mesh = caster.distances_m(points_m)
        self.on_rock: Mask = (from_mesh < 0.05) & (points_m[:, 2] > 0.05)

    @staticmethod
    def golden(state: Path, mesh: Path) -> Case:
        """A state of ../shared/golden/scorers and the mesh file of its rock."""
        with np.load(state) as z:
            lengths = np.bincount(z["track_point"], minlength=len(z["points_m"]))
            inside = (np.abs(z["points_m"] - z["target_m"]) <= 2.0).all(axis=1) & (lengths >= 2)
            order = np.argsort(z["track_point"], kind="stable")
            observed = inside[z["track_point"][order]]
            box = BoxPoints(
                z["points_m"][inside],
                np.zeros(np.count_nonzero(inside)),
                np.concatenate([[0], np.cumsum(lengths[inside])]),
                z["track_camera"][order][observed].astype(np.int64),
                z["camera_centers_m"],
            )
            return Case(box, z["candidates_m"][::CANDIDATE_STEP], golden_mesh(mesh), MissionConfig())

    @staticmethod
    def mission(state: Path, caster: RayCaster, config: MissionConfig) -> Case:
        """A state that a mission saved: exactly the points that its scorers counted."""
        planning, pool = load_state(state)
        box = box_points(planning.model, config)
        return Case(box, pool.positions_m[::CANDIDATE_STEP], caster, config)

    def mean_ray_test(self, limit_deg: float) -> Mask:
        """(P, C) candidate within ``limit_deg`` of the point's mean observing ray."""
        mean = mean_observing_directions(self.box)
        to_candidate = (self.candidates[None] - self.box.points_m[:, None]) / self.distance[..., None]
        cosine = np.einsum("pcj,pj->pc", to_candidate, mean)
        return self.frustum & (cosine > np.cos(np.deg2rad(limit_deg)))

    def surfel_test(self) -> Mask:
        """(P, C) what the scorers use with visibility.mode=occlusion."""
        return unoccluded(self.frustum, self.box, self.candidates)

    def counts(self, visible: Mask, rock_only: bool) -> Counts:
        """Pairs in the frustum."""
        part = self.frustum & self.on_rock[:, None] if rock_only else self.frustum
        truth, ours = self.truth[part], visible[part]
        return Counts(
            int((truth & ours).sum()),
            int((truth & ~ours).sum()),
            int((~truth & ours).sum()),
            int((~truth & ~ours).sum()),
        )

    def correlation(self, visible: Mask) -> float:
        """Over candidates: rock points called visible against rock points truly visible."""
        ours, truth = (m[self.on_rock].sum(axis=0) for m in (visible, self.truth))
        return float(np.corrcoef(ours, truth)[0, 1]) if np.ptp(ours) > 0 else float("nan")


TESTS: dict[str, Callable[[Case], Mask]] = {
    "`frustum`": lambda case: case.frustum,
    "mean observing ray < 60°": lambda case: case.mean_ray_test(60.0),
    "mean observing ray < 75°": lambda case: case.mean_ray_test(75.0),
    "`occlusion`": Case.surfel_test,
}


def text(value: float) -> str:
    """Three decimals; a dash where a test says the same of every candidate and nothing correlates."""
    return "–" if np.isnan(value) else f"{value:.3f}"


def rows(name: str, cases: Sequence[Case]) -> None:
    """Print one table row per test for the states of one rock."""
    points = f"{int(np.mean([c.on_rock.sum() for c in cases]))} of {int(np.mean([len(c.box.points_m) for c in cases]))}"
    for test, answer in TESTS.items():
        answers = [answer(case) for case in cases]
        rock = sum((c.counts(a, True) for c, a in zip(cases, answers)), Counts())
        everything = sum((c.counts(a, False) for c, a in zip(cases, answers)), Counts())
        correlation = float(np.mean([c.correlation(a) for c, a in zip(cases, answers)]))
        values = (
            rock.precision,
            rock.recall,
            rock.balanced,
            correlation,
            everything.precision,
            everything.recall,
            everything.balanced,
        )
        print(f"| {name} | {len(cases)} | {points} | {test} | " + " | ".join(map(text, values)) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shared", type=Path, default=Path(__file__).parents[2] / "shared")
    parser.add_argument("--mission", nargs=2, action="append", default=[], metavar=("RUN", "ROCK"))
    arguments = parser.parse_args()
    print(
        "| rock | states | points on the rock, of all (mean) | test | precision | recall | balanced | correlation "
        "| all: precision | recall | balanced |"
    )
    print("|---|---:|---:|---|" + "---:|" * 7)
    golden: dict[str, list[Case]] = {}
    for state, rock in CASES:
        mesh = arguments.shared / "rocks" / rock / f"{rock}.obj"
        golden.setdefault(rock, []).append(
            Case.golden(arguments.shared / "golden" / "scorers" / f"{state}.npz", mesh)
        )
    for rock, cases in golden.items():
        rows(f"{rock} (golden)", cases)
    for run, name in arguments.mission:
        import yaml

        config = config_from_dict(yaml.safe_load((Path(run) / "config.yaml").read_text()))
        subject = load_rock(name, Store())
        caster = RayCaster(subject.vertices_m, subject.faces)
        states = sorted((Path(run) / "states").glob("iter_*.npz"))[::STATE_STEP]
        rows(subject.name, [Case.mission(state, caster, config) for state in states])


if __name__ == "__main__":
    main()
