"""Fits the constants of the geometric fidelity's dense stage to real depth maps.

    OMP_NUM_THREADS=1 python -m research.geometric_fit runs/noise-full --rocks slab cavern \\
        --strategies b08-default b08-random --work runs/geometric-fit

Repeats the named missions' reconstructions (replicate 0; photographs, features and pairs come from the store),
and looks up, for every surface sample and view, whether the depth map is right there (within 0.6 %) and how
many views agree. Two fits by maximum likelihood follow: the chance of a right depth, then the number of
agreeing views together with whether any view keeps the sample at 5, 6 and 7. What is printed is to be put
into `nbv.geometric.completeness.DenseModel` by hand.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml

import nbv.dense.reconstruct as dense_stage
from nbv.cache import Store
from nbv.config import config_from_dict, preset
from nbv.dense.stereo import pixel_matrix
from nbv.flight import arrival_position
from nbv.geometric import load_world
from nbv.geometric.completeness import pairwise_angles_deg, stereo_partners, witness_mask
from nbv.mission.result import MissionResult
from nbv.photogrammetric.cached_sequences import CachedReconstructor
from nbv.photogrammetric.cached_stages import CachedStudio
from nbv.rocks import load_rock
from nbv.scene import build_scene, make_renderer
from nbv.threads import limit_threads
from nbv.viewpoints import raw_candidates, seed_viewpoints

RIGHT = 0.006  # relative error of a depth that counts as right
LEVELS = (5, 6, 7)
Tensor = torch.Tensor


def observe(mission: Path, rock_name: str) -> dict[str, np.ndarray]:
    """(V, S) right depths and agreeing views of one mission's dense stage, and the geometry they are fitted to."""
    config = config_from_dict(yaml.safe_load((mission / "config.yaml").read_text()))
    result, rock = MissionResult.load(mission), load_rock(rock_name, Store())
    viewpoints = {v.id: v for v in raw_candidates(config)}
    visited = [*seed_viewpoints(config), *(viewpoints[t.chosen] for t in result.trace)]
    centers = np.array([arrival_position(v, config.flight, rock.sha256, result.replicate) for v in visited])
    store = Store()
    photographs = CachedStudio(
        lambda camera: make_renderer(
            build_scene(rock, config.scene, camera, store=Store()), config.scene.backend
        ),
        rock,
        result.replicate,
        config,
        store,
    )
    captures = [photographs.take_photograph(v, c, 0.0) for v, c in zip(visited, centers)]
    n_seeds = len(seed_viewpoints(config))
    reconstructor = CachedReconstructor(config, store)
    reconstructor.bootstrap(captures[:n_seeds])
    for capture in captures[n_seeds:]:
        reconstructor.add(capture)
    depths, poses, check = {}, {}, dense_stage.check_consistency

    def listen(maps: Any, at: Any, *rest: Any) -> Any:
        depths.update(maps)
        poses.update(at)
        return check(maps, at, *rest)

    dense_stage.check_consistency = listen  # type: ignore[assignment]
    try:
        reconstructor.finish()
    finally:
        dense_stage.check_consistency = check
    checked = reconstructor._checked
    assert checked is not None

    world = load_world(rock, config, store)
    matrix, samples = pixel_matrix(config.camera), world.samples_m
    right = np.zeros((len(visited), len(samples)), dtype=bool)
    agreeing = np.zeros(right.shape, dtype=np.uint8)
    for row, capture in enumerate(captures):
        if capture.name not in depths:
            continue
        pose = poses[capture.name]
        image = (samples @ pose[:3, :3].T + pose[:3, 3]) @ matrix.T
        u, v = np.rint(image[:, :2] / image[:, 2:]).astype(int).T
        inside = (
            (image[:, 2] > 0)
            & (u >= 0)
            & (u < config.camera.width_px)
            & (v >= 0)
            & (v < config.camera.height_px)
        )
        z, at = image[inside, 2], (v[inside], u[inside])
        right[row, inside] = np.abs(depths[capture.name][at] - z) < RIGHT * z  # NaN compares false
        agreeing[row, inside] = checked.depths[capture.name].agreeing[at]
    ray = centers[:, None] - samples[None]
    cosine = (ray * world.sample_normals).sum(axis=2) / np.linalg.norm(ray, axis=2)
    directions = centers - np.array(config.target_m)
    return {
        "right": right,
        "agreeing": agreeing,
        "seen": world.sample_seen[[world.index(v.id) for v in visited]],
        "incidence_deg": np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))),
        "directions": directions / np.linalg.norm(directions, axis=1, keepdims=True),
        "contrast": world.sample_contrast,
        "observable": world.observable,
    }


class Case:
    """One mission's arrays as tensors."""

    def __init__(self, arrays: dict[str, np.ndarray]) -> None:
        dense = preset("campaign").dense
        self.right, self.seen = torch.tensor(arrays["right"]), torch.tensor(arrays["seen"])
        self.observable = torch.tensor(arrays["observable"])
        self.agreeing = torch.tensor(arrays["agreeing"].astype(np.float32))
        self.incidence = torch.tensor(arrays["incidence_deg"], dtype=torch.float32)
        self.contrast = torch.tensor(arrays["contrast"], dtype=torch.float32)
        angle = pairwise_angles_deg(arrays["directions"])
        partner, usable = stereo_partners(angle, dense)
        self.partner, self.usable = torch.tensor(partner), torch.tensor(usable)
        self.between = torch.tensor(np.take_along_axis(angle, partner, axis=1), dtype=torch.float32)
        self.witnesses = torch.tensor(witness_mask(angle, dense.consistency_views).astype(np.float32))


def log_likelihood(chance: Tensor, outcome: Tensor) -> Tensor:
    """Mean over Bernoulli outcomes."""
    p, y = chance.clamp(1e-3, 1 - 1e-3), outcome.float()
    return (y * p.log() + (1 - y) * (1 - p).log()).mean()


def depth_chance(case: Case, p: dict[str, Tensor]) -> Tensor:
    """(V, S) as `nbv.geometric.completeness.reconstruction_probability` has it."""
    good = torch.sigmoid((p["incidence_deg"] - case.incidence) / p["incidence_width_deg"]) * case.seen
    texture = case.contrast / (case.contrast + p["half_contrast"].abs())
    miss = torch.ones_like(good)
    for k in range(case.partner.shape[1]):
        other = case.partner[:, k]
        decay = p["angle_decay_per_deg"].abs() * case.between[:, k, None]
        decay = decay + p["slant_decay_per_deg"].abs() * (case.incidence - case.incidence[other]).abs()
        miss = miss * (1 - good * good[other] * texture * torch.exp(-decay) * case.usable[:, k, None])
    return 1 - miss


def kept_chance(case: Case, depth: Tensor, p: dict[str, Tensor], level: int) -> Tensor:
    """(V, S) chance that a depth is confirmed by enough views."""
    confirms = torch.sigmoid((p["witness_incidence_deg"] - case.incidence) / p["log_witness_width"].exp())
    expected = 1.5 + torch.sigmoid(p["logit_agreement"]) * (case.witnesses @ (depth * confirms))
    return torch.sigmoid(1.702 * (expected - level) / p["log_agreement_sd"].exp())


def descend(start: dict[str, tuple[float, float]], loss: Any, steps: int) -> dict[str, Tensor]:
    """Adam from ``start`` (value, learning rate) by name."""
    p = {name: torch.tensor(value, requires_grad=True) for name, (value, _) in start.items()}
    optimiser = torch.optim.Adam([{"params": [p[name]], "lr": rate} for name, (_, rate) in start.items()])
    for _ in range(steps):
        optimiser.zero_grad()
        value = loss(p)
        value.backward()
        optimiser.step()
    print(f"mean negative log-likelihood {float(value.detach()):.4f}")
    return {name: value.detach() for name, value in p.items()}


def fit(cases: Sequence[Case], steps: int) -> dict[str, float]:
    """The constants."""

    def depth_loss(p: dict[str, Tensor]) -> Tensor:
        each = [log_likelihood(depth_chance(c, p)[c.seen], c.right[c.seen]) for c in cases]
        return -torch.stack(each).mean()

    first = descend(
        {
            "incidence_deg": (76.0, 0.8),
            "incidence_width_deg": (8.0, 0.8),
            "half_contrast": (0.003, 0.0005),
            "angle_decay_per_deg": (0.02, 0.002),
            "slant_decay_per_deg": (0.02, 0.002),
        },
        depth_loss,
        steps,
    )
    depths = [depth_chance(c, first) for c in cases]

    def kept_loss(p: dict[str, Tensor]) -> Tensor:
        total = []
        for c, depth in zip(cases, depths):
            flown = c.seen & c.right
            for level in LEVELS:
                kept = kept_chance(c, depth, p, level)
                lost = torch.prod(1 - depth * kept, dim=0)
                really = (flown & (c.agreeing >= level)).any(dim=0)
                total.append(log_likelihood(1 - lost[c.observable], really[c.observable]))
                total.append(0.3 * log_likelihood(kept[flown], c.agreeing[flown] >= level))
        return -torch.stack(total).mean()

    second = descend(
        {
            "logit_agreement": (2.2, 0.03),
            "witness_incidence_deg": (90.0, 0.5),
            "log_witness_width": (2.2, 0.03),
            "log_agreement_sd": (0.0, 0.03),
        },
        kept_loss,
        steps,
    )
    return {
        **{name: abs(float(value)) for name, value in first.items()},
        "agreement": float(torch.sigmoid(second["logit_agreement"])),
        "witness_incidence_deg": float(second["witness_incidence_deg"]),
        "witness_incidence_width_deg": float(second["log_witness_width"].exp()),
        "agreement_sd": float(second["log_agreement_sd"].exp()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("study", type=Path, help="directory of a noise study")
    parser.add_argument("--rocks", nargs="+", default=["slab", "cavern"])
    parser.add_argument("--strategies", nargs="+", default=["b08-default", "b08-random"])
    parser.add_argument("--work", type=Path, default=Path("runs/geometric-fit"))
    parser.add_argument("--steps", type=int, default=150)
    arguments = parser.parse_args()
    limit_threads()
    torch.set_num_threads(1)
    arguments.work.mkdir(parents=True, exist_ok=True)
    names = yaml.safe_load((arguments.study / "noise_study.yaml").read_text())["rocks"]
    cases = []
    for rock in arguments.rocks:
        index = [Path(name).stem for name in names].index(rock)
        for strategy in arguments.strategies:
            path = arguments.work / f"{rock}_{strategy}.npz"
            if not path.exists():
                folder = arguments.study / "crossed" / "missions" / strategy / f"{index:02d}_{rock}_r0"
                np.savez_compressed(path, **observe(folder, names[index]))  # type: ignore[arg-type]
                print(f"observed {rock}, {strategy}", flush=True)
            with np.load(path) as data:
                cases.append(Case(dict(data)))
    for name, value in fit(cases, arguments.steps).items():
        print(f"{name} = {value:.4g}")


if __name__ == "__main__":
    main()
