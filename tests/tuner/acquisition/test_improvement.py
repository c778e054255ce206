"""The closed form of the noisy improvement is BoTorch's sampled one, and has a slope where that has run out of draws."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic
import torch

from tuner.acquisition import propose as acquisition
from tuner.acquisition.improvement import LogNoisyImprovement
from tuner.acquisition.propose import SearchSettings
from tuner.surrogate.model import RockMeanGP, numerics


def _model() -> RockMeanGP:
    return RockMeanGP(synthetic.SPACE, synthetic.random_design(12, 0.3, 0), synthetic.ROCKS)


@pytest.mark.parametrize("in_flight", [0, 1])
def test_equals_the_sampled_acquisition(in_flight: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(acquisition, "MONTE_CARLO_SAMPLES", 4096)
    model = _model()
    pending = [synthetic.SPACE.from_unit(np.array([0.3, 0.6]))][:in_flight]
    places = model.inputs(np.random.default_rng(0).random((40, 2))).unsqueeze(1)
    with numerics(0), torch.no_grad():
        sampled = acquisition._acquisition(model, pending, 0, "mean", SearchSettings(closed_form=False))
        closed = acquisition._acquisition(model, pending, 0, "mean", SearchSettings())
        assert isinstance(closed, LogNoisyImprovement)
        one, two = sampled(places), closed(places)
    likely = one > -4
    assert likely.sum() >= 5
    assert float((one - two)[likely].abs().max()) < 0.25
    assert int(one.argmax()) == int(two.argmax())


def test_knows_what_is_in_flight() -> None:
    model = _model()
    with numerics(0):
        best, _ = acquisition.maximise(model, LogNoisyImprovement(model, np.empty((0, 2)), 0), 0)
        here = model.inputs(best[None]).unsqueeze(1)
        with torch.no_grad():
            alone = float(LogNoisyImprovement(model, np.empty((0, 2)), 0)(here))
            twice = float(LogNoisyImprovement(model, best[None], 0)(here))
    assert twice < alone - 1


def test_has_a_slope_where_improvement_is_hopeless() -> None:
    model = _model()
    worst = model.unit[int(np.argmin(model.targets))]
    with numerics(0):
        here = model.inputs(worst[None]).unsqueeze(1).requires_grad_()
        LogNoisyImprovement(model, np.empty((0, 2)), 0)(here).sum().backward()
    assert here.grad is not None
    slope = here.grad[0, 0, :2]
    assert bool(torch.isfinite(slope).all()) and float(slope.abs().max()) > 0
