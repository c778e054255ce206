"""One real flight measured at several strictness levels, against missions that were configured so."""

from __future__ import annotations

import pytest

from nbv.config import preset
from nbv.mission.result import MissionResult
from nbv.photogrammetric import run_photogrammetric_mission
from nbv.photogrammetric.agreement_levels import AGREEMENT_LEVELS, SeveralAgreementLevels, run_study_mission


@pytest.mark.slow
def test_each_level_is_the_mission_that_was_configured_with_it(tmp_path, monkeypatch):
    base = preset("campaign").with_values(
        {
            "stop.adaptive_budget": 1,
            "evaluation.gt_samples": 5000,
            "dense.agreeing_views": min(AGREEMENT_LEVELS),
        }
    )
    result = run_study_mission(base, "boulder", 0, tmp_path / "study", keep="summary")
    assert result.status == "ok" and result.timings_s["agreement_levels"] > 0
    assert list(result.metrics["agreement"]) == [str(level) for level in AGREEMENT_LEVELS]
    assert (
        result.metrics["agreement"][str(min(AGREEMENT_LEVELS))]["observable"] == result.metrics["observable"]
    )
    strict = run_photogrammetric_mission(base.with_values({"dense.agreeing_views": 5}), "boulder", 0)
    assert [r.chosen for r in strict.trace] == [r.chosen for r in result.trace]
    for surface in ("whole", "observable"):
        assert result.metrics["agreement"]["5"][surface] == strict.metrics[surface]
    completeness = [
        result.metric(f"agreement.{level}.observable.completeness_48mm") for level in AGREEMENT_LEVELS
    ]
    assert completeness == sorted(completeness, reverse=True) and completeness[0] > completeness[-1]
    assert (
        MissionResult.load(tmp_path / "study").metrics["agreement"].keys()
        == result.metrics["agreement"].keys()
    )
    # Impossibly strict: that level says so, the others stand.
    monkeypatch.setattr(SeveralAgreementLevels, "levels", (5, 12))
    blank = run_study_mission(base, "boulder")
    assert blank.metrics["agreement"]["12"] == {"failed": "empty_dense_cloud"}
    assert blank.metrics["agreement"]["5"] == result.metrics["agreement"]["5"]
