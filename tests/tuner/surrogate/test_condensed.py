"""The model of many missions says what the exact one says."""

import numpy as np
import pytest
import synthetic

from tuner.problem.observations import Observation
from tuner.surrogate import condensed
from tuner.surrogate.model import RockMeanGP

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
def models() -> tuple[RockMeanGP, RockMeanGP]:
    missions = _missions(160)
    exact = RockMeanGP(synthetic.SPACE, missions, ROCKS)
    patch = pytest.MonkeyPatch()
    with patch.context() as small:
        small.setattr(condensed, "EXACT_MISSIONS", 100)
        small.setattr(condensed, "FITTED_MISSIONS", 80)
        small.setattr(condensed, "PROMISING", 30)
        return exact, RockMeanGP(synthetic.SPACE, missions, ROCKS)


def test_many_missions_are_believed_as_by_the_exact_model(models: tuple[RockMeanGP, RockMeanGP]) -> None:
    exact, small = models
    assert len(small.model.train_targets) <= 110
    configurations = [synthetic.SPACE.from_unit(u) for u in np.random.default_rng(1).uniform(size=(40, 2))]
    a, b = exact.posterior(configurations), small.posterior(configurations)
    assert np.abs(a.mean - b.mean).max() < 2 * a.sd.max()
    assert b.sd.mean() == pytest.approx(a.sd.mean(), rel=0.5)
    assert exact.best_first(configurations)[0] in small.best_first(configurations)[:3]
    assert small.noise_sd == pytest.approx(0.3, rel=0.4)


def test_with_all_missions_inducing_it_is_the_exact_model() -> None:
    missions = _missions(60)
    exact = RockMeanGP(synthetic.SPACE, missions, ROCKS)
    x, y = exact.model.train_inputs[0], exact.model.train_targets
    small = condensed.condensed(exact.model, x, y[:, None])
    probe = exact.inputs(np.random.default_rng(1).uniform(size=(20, 2)))
    assert np.allclose(small.posterior(probe).mean, exact.model.posterior(probe).mean, atol=1e-3)
    assert np.allclose(small.posterior(probe).variance, exact.model.posterior(probe).variance, atol=1e-3)
