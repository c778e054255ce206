import fake_missions
import pytest

from nbv import plugins
from nbv.config import preset
from nbv.errors import UserError
from tuner.comparison.curves import Suite, comparison_plan, drawn_targets
from tuner.missions.registry import MissionKind, kind_on, mission_kind
from tuner.report.labels import measure_text


def test_a_fidelity_of_ones_own_is_a_plug_in() -> None:
    assert mission_kind("fake") == MissionKind(fake_missions.fake_mission)
    assert mission_kind("of-yesterday").targets == "own"


def test_an_unknown_fidelity_is_refused_with_a_remedy() -> None:
    with pytest.raises(
        UserError, match=r"no such fidelity is known here; name its plug-in with gatetune --plugin"
    ):
        _ = mission_kind("photogrametric").function


def test_a_kind_in_one_file_is_asked_wherever_missions_are_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(config):
        raise UserError(f"no flights with {config.preset}")

    sketch = MissionKind(
        fake_missions.fake_mission,
        targets="rocks",
        every_number=True,
        refuses="test_fidelities:refused",
        numbers_are="drawn by hand",
    )
    monkeypatch.setattr(plugins, "_registered", {})
    monkeypatch.setitem(globals(), "refused", refuse)
    plugins.register("fidelities", "sketch", sketch)
    suite = Suite(drawn_targets(2), fidelity="sketch")
    plan = comparison_plan(suite, {"random": None})
    assert list(plan.strategies) == ["random"]  # one mission tells of every number
    with pytest.raises(UserError, match="no flights with campaign"):
        plan.require_runnable()
    assert measure_text("F", "sketch", ["slab"], ["ideal"]) == "F; drawn by hand; condition ideal"
    assert kind_on("slab", "sketch")(preset("campaign"), "slab", 0, None, keep="summary").status == "ok"
