"""Is the expected believed saving worth its code? The fewest photographs of a quality, by it and by BoTorch's constrained logNEI.

    OMP_NUM_THREADS=1 python -m research.believed_saving --seeds 6

The missions are the tests' fake ones on two rocks: 24 photographs are the fewest that give 98. Both run 24 missions, whose last
ones confirm the favourite by the same rule.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import unittest.mock
from pathlib import Path
from typing import Any

import numpy as np
import torch
from botorch.acquisition import AcquisitionFunction
from botorch.acquisition.logei import qLogNoisyExpectedImprovement
from botorch.acquisition.objective import GenericMCObjective
from botorch.models import ModelList
from botorch.models.deterministic import GenericDeterministicModel
from botorch.sampling.get_sampler import get_sampler

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests/support"))

import fake_campaigns
import photograph_missions

from tuner.acquisition import constrained
from tuner.problem.objective import Objective
from tuner.problem.search_space import builtin


def of_botorch(cost: Any, constraint: Any, model: Any, running: torch.Tensor | None) -> AcquisitionFunction:
    """The cost as a deterministic model beside the quality's surrogate, which has the limit."""
    floor = constraint.floor()
    known = GenericDeterministicModel(lambda x: cost.at(x).unsqueeze(-1), num_outputs=1)
    models, evaluated = ModelList(known, model.model), model.inputs(np.unique(model.unit, axis=0))
    with torch.no_grad():
        sampler = get_sampler(models.posterior(evaluated), torch.Size([64]), seed=0)
    return qLogNoisyExpectedImprovement(
        models,
        X_baseline=evaluated,
        sampler=sampler,
        objective=GenericMCObjective(lambda samples, X=None: samples[..., 0]),
        constraints=[lambda samples: floor - samples[..., 1]],
        X_pending=running,
        prune_baseline=False,
        cache_root=False,
    )


def main() -> None:
    """Print a CSV row a campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=6)
    ways = {"believed saving": constrained._saving, "BoTorch's constrained logNEI": of_botorch}
    print("seed,acquisition,photographs,true_f_score")
    for seed in range(parser.parse_args().seeds):
        for name, way in ways.items():
            with unittest.mock.patch.object(constrained, "_saving", way), tempfile.TemporaryDirectory() as at:
                campaign = fake_campaigns.run(
                    Path(at) / "run",
                    space=photograph_missions.SPACE,
                    fidelity="photograph_missions:mission",
                    replicates=2,
                    objective=Objective("costs.images", "minimise"),
                    second=Objective(),
                    limit=98.0,
                    budget=24,
                    seed=seed,
                )
                best = campaign.recommended()
            truth = photograph_missions.truth(builtin(campaign.settings.config(best.values)))
            print(f"{seed},{name},{best.mean:g},{truth:.2f}", flush=True)


if __name__ == "__main__":
    main()
