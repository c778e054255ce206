"""Many missions at once: the acquisition's values are BoTorch's, and a batch is half the acquisition's, half drawn."""

import concurrent.futures
import dataclasses
import threading

import numpy as np
import pytest
import synthetic
import torch
from botorch.acquisition.logei import qLogNoisyExpectedImprovement
from botorch.sampling import SobolQMCNormalSampler

from tuner.acquisition.constrained import Constraint, thompson_configurations, two_models
from tuner.acquisition.propose import LogNoisyImprovement, propose
from tuner.problem.observations import Observation
from tuner.problem.search_space import Values
from tuner.samplers import gp
from tuner.surrogate.model import InstanceMeanGP

DRAWS = 4096


def positions(count: int, seed: int) -> list[Values]:
    unit = np.random.default_rng(seed).random((count, 2))
    return [synthetic.SPACE.from_unit(u) for u in unit]


def model_of(count: int) -> InstanceMeanGP:
    return InstanceMeanGP(synthetic.SPACE, synthetic.random_design(count, 0.1, 0), synthetic.INSTANCES)


def test_values_are_those_of_botorch() -> None:
    model = model_of(40)
    baseline = model.inputs(model.promising(12))
    running = model.inputs(np.array([synthetic.SPACE.to_unit(v) for v in positions(6, 1)]))
    everywhere = model.inputs(np.random.default_rng(2).random((200, 2))).unsqueeze(1)
    theirs = qLogNoisyExpectedImprovement(
        model.model,
        baseline,
        SobolQMCNormalSampler(torch.Size([DRAWS]), seed=0),
        X_pending=running,
        prune_baseline=False,
    )
    ours = LogNoisyImprovement(model.model, torch.cat([baseline, running]), DRAWS, 1)
    with torch.no_grad():
        expected, found = theirs(everywhere), ours(everywhere)
    likely = expected > expected.max() - 3  # fewer draws than that say nothing of the others
    assert likely.sum() > 10
    assert found[likely].numpy() == pytest.approx(expected[likely].numpy(), abs=0.15)


@pytest.mark.parametrize(("running", "by_acquisition"), [(24, 6), (gp.MAX_JOINT + 1, 0)])
def test_half_a_batch_is_by_the_acquisition(running: int, by_acquisition: int) -> None:
    history = synthetic.random_design(24, 0.1, 0)
    pending = [Observation(24 + i, v, "r0", 0) for i, v in enumerate(positions(running, 4))]
    proposals = gp.GPSampler(synthetic.sampler_settings(0, 4)).ask_many(history, pending, 12)
    assert [("expected_gain" in p.metadata) for p in proposals].count(True) == by_acquisition
    assert len({tuple(p.values.values()) for p in proposals}) == 12


def test_what_is_proposed_does_not_depend_on_another_thread() -> None:
    """A proposal is made in a thread of its own, beside a recommendation and whatever else uses torch."""
    model = model_of(24)

    def proposed(seed: int) -> list[Values]:
        return [propose(model, [], seed)[0], *thompson_configurations([model], None, 3, seed)]

    alone, stop = [proposed(seed) for seed in range(3)], threading.Event()

    def beside() -> None:
        while not stop.is_set():
            torch.manual_seed(7)
            torch.rand(1000)

    with concurrent.futures.ThreadPoolExecutor(3) as threads:
        busy = threads.submit(beside)
        found = list(threads.map(proposed, range(3)))
        stop.set()
        busy.result()
    assert found == alone


def two_objectives(count: int) -> list[Observation]:
    """The second falls along the first parameter: from 1 to 0."""
    rng = np.random.default_rng(0)
    return [
        dataclasses.replace(
            o, second=1 - float(synthetic.SPACE.to_unit(o.values)[0]) + 0.02 * float(rng.normal())
        )
        for o in synthetic.random_design(count, 0.05, 0)
    ]


def test_what_is_drawn_within_a_limit_keeps_it_and_is_good() -> None:
    models = two_models(synthetic.PROBLEM, two_objectives(40))
    drawn = thompson_configurations(models, Constraint(models[1], 0.5), 12, 0)
    first = np.array([synthetic.SPACE.to_unit(v)[0] for v in drawn])
    assert (first < 0.6).all()  # 0.5 and what the model leaves open
    anywhere = [synthetic.true_value(v) for v in positions(200, 5) if synthetic.SPACE.to_unit(v)[0] < 0.5]
    assert np.mean([synthetic.true_value(v) for v in drawn]) > np.mean(anywhere) + 0.1
    out_of_reach = thompson_configurations(models, Constraint(models[1], 2.0), 6, 0)
    assert np.mean([synthetic.SPACE.to_unit(v)[0] for v in out_of_reach]) < 0.2
