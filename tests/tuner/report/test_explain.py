"""``gatetune mission explain`` on a bare planning state."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from scoring_state import synthetic_state

from nbv.config import preset
from nbv.mission.planning_state import save_state
from nbv.scorers import rank_candidates


@pytest.mark.parametrize("geometry_scorer", ["b-aware", "matchable"])
def test_candidates_are_named_in_full_and_in_the_scorers_order(
    gatetune, tmp_path: Path, geometry_scorer: str
) -> None:
    config = preset("paper").with_values({"gate.geometry_scorer": geometry_scorer})
    state, pool = synthetic_state(400, config, 0)
    save_state(tmp_path / "state.npz", state, pool)
    code, out, _ = gatetune(
        "mission", "explain", "state.npz", "--set", f"gate.geometry_scorer={geometry_scorer}", "--top", "3"
    )
    assert code == 0
    assert max(len(line) for line in out.splitlines() if line.startswith("│")) <= 80  # a usual terminal
    rankings = rank_candidates(state, pool, config)
    for name in {"covis", "b-aware", geometry_scorer}:
        table = out[out.index(f"{name}") :]
        rows = re.findall(r"│ +(\d) │ +(cand_\d+) │.*│ +(-?[\d.]+) │\n", table)[:3]
        assert [row[1] for row in rows] == [pool.ids[i] for i in rankings[name].order[:3]]
        assert [float(row[2]) for row in rows] == pytest.approx(
            [rankings[name].scores[i] for i in rankings[name].order[:3]], abs=1e-4
        )
    assert ("matchable" in out) == (geometry_scorer == "matchable")
