"""Real sparse models against ray casting on the rocks that they show."""

from pathlib import Path

import pytest

from research.occlusion_quality import CASES, Case


@pytest.mark.shared
def test_tells_visible_from_hidden_on_real_models(shared_rocks: Path) -> None:
    """Real sparse models against ray casting on the rocks that they show."""
    golden_states = Path(__file__).parents[1] / "data" / "golden_scorers"
    for golden, rock in CASES:
        case = Case.golden(golden_states / f"{golden}.npz", shared_rocks / rock / f"{rock}.obj")
        visible = case.surfel_test()
        for rock_only in (True, False):
            ours, frustum = (case.counts(mask, rock_only) for mask in (visible, case.frustum))
            assert ours.balanced > 0.83, (golden, rock_only, ours)
            assert frustum.recall == 1.0 and ours.precision > frustum.precision + 0.1, (golden, ours, frustum)
            assert ours.recall > 0.8, (golden, rock_only, ours)
        assert case.correlation(visible) > 0.75  # candidates that see more of the rock are told apart
