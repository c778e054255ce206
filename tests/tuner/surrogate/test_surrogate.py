"""The Gaussian process: accuracy, calibration, and the shapes of its answers."""

from __future__ import annotations

import math

import numpy as np
import pytest
import synthetic
import torch
from gpytorch.kernels import Kernel, MaternKernel, ScaleKernel

from tuner.problem.observations import Observation
from tuner.problem.search_space import Parameter, SearchSpace
from tuner.surrogate import fit
from tuner.surrogate.kernel import NO_OFFSET, mission_kernel, shared_variance
from tuner.surrogate.model import InstanceMeanGP
from tuner.surrogate.numerics import NORMAL_95
from tuner.surrogate.settings import SurrogateSettings


def test_recovers_a_smooth_function_over_shifted_rocks() -> None:
    model = InstanceMeanGP(synthetic.SPACE, synthetic.random_design(48, 0.01, 0), synthetic.ROCKS)
    grid = [
        synthetic.SPACE.from_unit([x, y]) for x in np.linspace(0.1, 0.9, 6) for y in np.linspace(0.1, 0.9, 6)
    ]
    belief = model.posterior(grid)
    truth = np.array([synthetic.true_rock_mean(v) for v in grid])
    assert np.sqrt(np.mean((belief.mean - truth) ** 2)) < 0.1 * truth.std() + 0.02
    assert np.corrcoef(belief.mean, truth)[0, 1] > 0.99


@pytest.mark.parametrize("noise_sd", [0.05, 0.3])
def test_leave_one_out_and_fresh_predictions_are_calibrated(noise_sd: float) -> None:
    inside, outside = [], []
    for seed in range(4):
        model = InstanceMeanGP(synthetic.SPACE, synthetic.random_design(40, noise_sd, seed), synthetic.ROCKS)
        inside.append(model.leave_one_out()["coverage_95"])
        fresh = synthetic.random_design(60, noise_sd, 100 + seed)
        y = np.array([o.outcome for o in fresh], dtype=float)
        mean, sd = np.array([model.predict_mission(o.values, o.rock) for o in fresh]).T
        outside.append(np.mean(np.abs(y - mean) <= NORMAL_95 * sd))
    assert 0.88 <= np.mean(inside) <= 1.0
    # Hyperparameters are plugged in, not integrated over: with noise as large as the signal and ten missions
    # per rock, 95 % intervals were measured to hold about 85 % of new missions.
    assert 0.80 <= np.mean(outside) <= 1.0


def test_block_offsets_are_told_from_noise_and_cancel() -> None:
    """Blocks that differ twice as much as configurations: noise and differences are found all the same."""
    space = synthetic.SPACE
    points = [space.from_unit(u) for u in ([0.7, 0.3], [0.2, 0.8], [0.4, 0.5])]
    scale = float(np.mean([synthetic.fake_missions.rock_shift(r)[1] for r in synthetic.ROCKS]))
    errors: dict[bool, list[float]] = {True: [], False: []}
    noise: dict[bool, list[float]] = {True: [], False: []}
    for seed in range(4):
        history = synthetic.random_design(32, 0.1, seed, replicates=2, block_sd=0.6)
        for blocks, found in errors.items():
            model = InstanceMeanGP(space, history, synthetic.ROCKS, settings=SurrogateSettings(blocks=blocks))
            noise[blocks].append(float(model.noise_sd / scale))
            belief = model.posterior(points)
            for i in (1, 2):
                truth = synthetic.true_rock_mean(points[i]) - synthetic.true_rock_mean(points[0])
                found.append(belief.difference(i, 0)[0] - truth)
            if blocks:
                gaps = [
                    synthetic.block_offset(r, 0, seed) - synthetic.block_offset(r, 1, seed)
                    for r in synthetic.ROCKS
                ]
                realised = 0.6 * scale * np.sqrt(np.mean(np.square(gaps)) / 2)  # four differences: a rough sd
                assert model.block_sd is not None and 0.4 * realised < model.block_sd < 2.5 * realised
                assert model.leave_one_out()["coverage_95"] >= 0.85
    assert np.mean(noise[True]) == pytest.approx(0.1, rel=0.3)
    assert np.mean(noise[False]) > 1.5 * np.mean(noise[True])  # blocks taken for noise
    rms = {blocks: np.sqrt(np.mean(np.square(e))) for blocks, e in errors.items()}
    assert rms[True] < 0.7 * rms[False]


def test_slots_are_modelled_only_where_they_show() -> None:
    from tuner.surrogate.model import blocks_identifiable

    assert blocks_identifiable([("a", 0), ("a", 0), ("a", 1)])
    assert not blocks_identifiable(
        [("a", 0), ("a", 0), ("b", 1), ("b", 1)]
    )  # a rock's only block is the rock
    assert not blocks_identifiable([("a", 0), ("a", 1), ("b", 0), ("b", 1)])  # one mission each: noise
    model = InstanceMeanGP(synthetic.SPACE, synthetic.random_design(12, 0.1, 1), synthetic.ROCKS)
    assert model.block_sd is None


def variance_of(kernel: Kernel, index: int, value: float) -> None:
    """Sets the variance of the ``index``-th term of the sum."""
    term = kernel.kernels[index]
    setattr(term, "outputscale" if isinstance(term, ScaleKernel) else "variance", value)


def test_kernel_of_missions() -> None:
    """What shares a rock or a block covaries by it; a column at NO_OFFSET shares nothing, not even with itself."""
    kernel = mission_kernel([0], [], 1, SurrogateSettings(own_landscapes=True))
    for term, value in enumerate((1.0, 2.0, 0.5, 3.0)):
        variance_of(kernel, term, value)
    x = [[0.5, 0, 0], [0.5, 0, 0], [0.5, 0, 1], [0.5, 1, 2], [0.5, NO_OFFSET, NO_OFFSET]]
    k = kernel(torch.tensor(x, dtype=torch.float64)).to_dense().detach()
    np.testing.assert_allclose(k[0], [6.5, 6.5, 3.5, 1.0, 1.0], rtol=1e-6)
    np.testing.assert_allclose(k[4], [1.0, 1.0, 1.0, 1.0, 1.0], rtol=1e-6)
    diagonal = kernel(torch.tensor(x, dtype=torch.float64), diag=True).detach()
    np.testing.assert_allclose(diagonal, k.diagonal(), rtol=1e-9)
    assert shared_variance(kernel, 2) == pytest.approx(3.0) and shared_variance(kernel, 0) == 0.0


def test_a_trend_reaches_where_nothing_was_flown() -> None:
    """Slopes seen in the middle of 15 parameters go on towards the corners; a smooth f alone falls back."""
    path = [f"x{i}" for i in range(15)]
    space = SearchSpace("cube", tuple(Parameter(p, "float", 0.0, 1.0) for p in path))
    slopes = np.r_[np.ones(5), -np.ones(5), np.zeros(5)]
    rng = np.random.default_rng(1)
    history = []
    for i, x in enumerate(rng.uniform(0.3, 0.7, (40, 15))):
        y = float(slopes @ x) + 0.05 * rng.normal()
        history.append(Observation(i, space.from_unit(x), "r0", i % 2, y, y))
    corner = [space.from_unit((slopes > 0).astype(float))]
    truth = float(slopes.clip(0).sum())
    with_trend, without = (
        InstanceMeanGP(
            space, history, ("r0",), settings=SurrogateSettings(sparse=True, trend=trend)
        ).posterior(corner)
        for trend in (True, False)
    )
    assert abs(with_trend.mean[0] - truth) < 0.15 * truth
    assert abs(with_trend.mean[0] - truth) < 0.5 * abs(without.mean[0] - truth)


def test_sparse_model_switches_parameters_off() -> None:
    """Only the first parameter matters; the sparse prior knows it from fewer missions."""
    rng = np.random.default_rng(1)
    history = []
    for i in range(24):
        u = rng.random(2)
        y = math.sin(6 * u[0]) + 0.05 * rng.normal()
        history.append(Observation(i, synthetic.SPACE.from_unit(u), "r0", 0, y, y))
    ratio = {}
    for sparse in (False, True):
        model = InstanceMeanGP(synthetic.SPACE, history, ("r0",), settings=SurrogateSettings(sparse=sparse))
        (matern,) = (k for k in model.model.covar_module.modules() if isinstance(k, MaternKernel))
        first, second = matern.lengthscale[0].tolist()
        ratio[sparse] = second / first
    assert ratio[True] > 10 and ratio[True] > ratio[False]


ROCKS = ("a", "b")


def _missions(count: int) -> list[Observation]:
    rng = np.random.default_rng(0)
    found = []
    for i in range(count):
        unit = rng.uniform(size=synthetic.SPACE.dimension)
        values = synthetic.SPACE.from_unit(unit)
        position = synthetic.SPACE.to_unit(values)
        y = 10 - 8 * float(((position - 0.6) ** 2).sum()) + i % 2 + 0.3 * rng.normal()
        found.append(Observation(i, values, ROCKS[i % 2], i // 2 % 2, y, y))
    return found


@pytest.fixture(scope="module")
def models() -> tuple[InstanceMeanGP, InstanceMeanGP]:
    missions = _missions(160)
    exact = InstanceMeanGP(synthetic.SPACE, missions, ROCKS)
    patch = pytest.MonkeyPatch()
    with patch.context() as small:
        small.setattr(fit, "EXACT_MISSIONS", 100)
        small.setattr(fit, "FITTED_MISSIONS", 80)
        small.setattr(fit, "PROMISING", 30)
        return exact, InstanceMeanGP(synthetic.SPACE, missions, ROCKS)


def test_many_missions_are_believed_as_by_the_exact_model(
    models: tuple[InstanceMeanGP, InstanceMeanGP],
) -> None:
    exact, small = models
    assert len(small.model.train_targets) <= 110
    configurations = [synthetic.SPACE.from_unit(u) for u in np.random.default_rng(1).uniform(size=(40, 2))]
    a, b = exact.posterior(configurations), small.posterior(configurations)
    assert np.abs(a.mean - b.mean).max() < 2 * a.sd.max()
    assert b.sd.mean() == pytest.approx(a.sd.mean(), rel=0.5)
    assert exact.best_first(configurations)[0] in small.best_first(configurations)[:3]
    assert small.noise_sd == pytest.approx(0.3, rel=0.4)


def test_with_all_missions_promising_it_is_the_exact_model() -> None:
    missions = _missions(60)
    exact = InstanceMeanGP(synthetic.SPACE, missions, ROCKS)
    x, y = exact.model.train_inputs[0], exact.model.train_targets
    small = fit.with_promising(exact.model, x, y[:, None])
    probe = exact.inputs(np.random.default_rng(1).uniform(size=(20, 2)))
    assert np.allclose(small.posterior(probe).mean, exact.model.posterior(probe).mean, atol=1e-3)
    assert np.allclose(small.posterior(probe).variance, exact.model.posterior(probe).variance, atol=1e-3)
