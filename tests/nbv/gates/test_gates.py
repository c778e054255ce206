"""Fixed, heuristic and control gates, and how a gate is made."""

from dataclasses import dataclass

import numpy as np
import pytest
from gate_states import pool, rankings, state

from nbv import plugins
from nbv.config import SCORERS, MissionConfig, gate_kinds
from nbv.errors import UserError
from nbv.gates import gate_class, make_gate
from nbv.gates.registry import RandomGate


def config(kind: str, **values: object) -> MissionConfig:
    return MissionConfig().with_values({"gate.kind": kind, **values})


@pytest.mark.parametrize("kind", list(SCORERS))
def test_every_scorers_name_flies_it_alone(kind: str) -> None:
    every = {name: rankings(0, 1, len(pool()))["b-aware"] for name in SCORERS}
    assert make_gate(config(kind)).decide(state(), pool(), every).ranking is every[kind]


@pytest.mark.parametrize(
    ("used", "d95_m", "expected"),
    [
        (0, 0.0, "b-aware"),
        (15, 0.0, "b-aware"),  # 15 / 40 < 0.4
        (16, 0.0, "covis"),  # 16 / 40 = 0.4: not less
        (16, 0.14, "covis"),  # equal: not more
        (16, 0.1401, "b-aware"),
        (39, 0.2, "b-aware"),
        (39, float("inf"), "b-aware"),
        (39, 0.0, "covis"),
    ],
)
def test_equation_9_is_strict(used: int, d95_m: float, expected: str) -> None:
    both = rankings(0, 1, len(pool()))
    decision = make_gate(config("hyb-h")).decide(state(used=used, d95_m=d95_m), pool(), both)
    assert decision.ranking is both[expected]  # the whole ranking, unchanged
    assert decision.details["f_b"] == used / 40 and decision.details["d95_m"] == d95_m
    assert decision.reason


def test_every_kind_can_be_made_or_says_what_it_lacks() -> None:
    for kind in gate_kinds():
        if gate_class(kind).sees_ground_truth:
            with pytest.raises(UserError, match="ground truth"):
                make_gate(config(kind))
        else:
            assert make_gate(config(kind)) is not None


def test_a_gate_gets_the_truth_only_if_it_says_that_it_sees_it(monkeypatch: pytest.MonkeyPatch) -> None:
    @dataclass
    class Peeking(RandomGate):
        def __post_init__(self) -> None:
            self.truth  # noqa: B018

    monkeypatch.setattr(plugins, "_registered", {})
    plugins.register("gates", "peeking", Peeking)
    with pytest.raises(ValueError, match="sees_ground_truth = True"):
        make_gate(config("peeking"), oracle=object())  # type: ignore[arg-type]
    monkeypatch.setattr(Peeking, "sees_ground_truth", True)
    assert isinstance(make_gate(config("peeking"), oracle=object()), Peeking)  # type: ignore[arg-type]


def test_random_is_keyed_not_sequential() -> None:
    both, candidates = rankings(0, 1, len(pool())), pool()
    gate = RandomGate(config("random"), "rock", 0)
    first = gate.decide(state(used=3), candidates, both).ranking
    gate.decide(state(used=4), candidates, both)
    again = gate.decide(state(used=3), candidates, both).ranking
    np.testing.assert_array_equal(first.order, again.order)
    assert first.scorer == "random" and sorted(first.order) == list(range(len(candidates)))
    others = [
        gate.decide(state(used=4), candidates, both).ranking,
        RandomGate(config("random"), "rock", 1).decide(state(used=3), candidates, both).ranking,
        RandomGate(config("random"), "other rock", 0).decide(state(used=3), candidates, both).ranking,
    ]
    assert all((first.order != o.order).any() for o in others)


def test_the_movement_control_ranks_by_its_term() -> None:
    candidates, both = pool(), rankings(0, 1, len(pool()))
    terms = both["covis"].terms
    movement = make_gate(config("movement-only")).decide(state(), candidates, both).ranking
    assert movement.scorer == "movement-only" and movement.top == int(np.argmin(terms["move"]))
