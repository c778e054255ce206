"""Peers in processes of their own: what they are told, how they fail, and that the real ones work where set up."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import synthetic

import research.peers.sampler as peers
from nbv.config import MissionConfig
from nbv.errors import UserError
from research.peers.sampler import PEER_NAMES, PeerSampler, available_peers, make_peer_sampler
from tuner.problem.observations import Observation
from tuner.problem.space_files import space_from_dict
from tuner.samplers.base import SamplerSettings

FAKE = str(Path(__file__).with_name("fake_peer_server.py"))
FIRST, SECOND = synthetic.SPACE.paths
MIXED = space_from_dict(
    {
        "name": "mixed",
        "parameters": {
            "gate.budget_fraction": {"low": 0.0, "high": 1.0},
            "gate.d95_m": {"low": 0.01, "high": 1.0, "scale": "log"},
            "b_aware.target_track_length": {"kind": "int", "low": 3, "high": 12},
            "stop.knn_region": {"kind": "categorical", "choices": ["all", "box"]},
        },
    },
    "test_peers.py",
)


def running_servers() -> list[psutil.Process]:
    """The peers' servers that this process has started and that still run."""
    children = [p for p in psutil.Process().children() if p.status() != psutil.STATUS_ZOMBIE]
    return [p for p in children if any(word.endswith("_server.py") for word in p.cmdline())]


def kill_servers() -> None:
    for server in running_servers():
        server.kill()
        server.wait()


@pytest.fixture(autouse=True)
def _no_process_survives() -> Iterator[None]:
    yield
    kill_servers()


def fake(settings: SamplerSettings, accident: str = "", **changes: Any) -> PeerSampler:
    return PeerSampler(settings, "ax", lambda: [sys.executable, FAKE, accident], **changes)


def told(values: dict[str, Any]) -> int:
    """How many missions the fake peer knew when it proposed ``values``."""
    return round(100 * values[FIRST])


def test_the_peer_chooses_the_rock_and_hears_each_mission_once() -> None:
    sampler = fake(synthetic.sampler_settings(0, 4))
    history = synthetic.play(sampler, 4, 0.05, 0)
    assert history[0].values == synthetic.DEFAULT and not running_servers()  # the common design needs no peer
    for expected in (4, 5, 6):
        proposal = sampler.ask(history, [])
        assert told(proposal.values) == expected
        assert (proposal.instance, proposal.replicate) == (("r3", "ideal"), 7)
        assert proposal.metadata["phase"] == "model" and proposal.metadata["peer_cpu_s"] >= 0
        history.append(synthetic.observe(len(history), proposal.values, "r3", 0.05, np.random.default_rng(0)))


def test_a_resumed_sampler_is_told_everything_again() -> None:
    settings = synthetic.sampler_settings(0, 4)
    history = synthetic.random_design(9, 0.05, 0)
    pending = [Observation(9, synthetic.SPACE.from_unit([0.5, 0.5]), "r0", 0)]
    first, second = fake(settings), fake(settings)
    before = first.ask(history, pending)
    again = second.ask(history, pending)  # the process is shared: it has to forget the first sampler
    assert told(again.values) == 9 and again.values == before.values
    assert first.ask(history, pending).values == before.values
    assert len(running_servers()) == 1


def test_another_past_is_not_mixed_with_the_one_told_before() -> None:
    sampler = fake(synthetic.sampler_settings(0, 4))
    sampler.ask(synthetic.random_design(9, 0.05, 0), [])
    assert told(sampler.ask(synthetic.random_design(5, 0.05, 1), []).values) == 5
    failed = [Observation(i, synthetic.DEFAULT, "r0", i, None, None, "timeout") for i in range(6)]
    assert sampler.ask(failed, []).metadata["phase"] == "initial design"  # nothing to learn from


def test_a_peer_that_was_killed_is_started_again() -> None:
    sampler = fake(synthetic.sampler_settings(0, 4))
    history = synthetic.random_design(6, 0.05, 0)
    before = sampler.ask(history, []).values
    kill_servers()
    assert not running_servers()
    assert sampler.ask(history, []).values == before


@pytest.mark.parametrize(
    ("accident", "message"),
    [
        (
            "die",
            r"ax ended at 'ask' \(the last words\); set it up again with `python -m research.peers.setup ax`",
        ),
        ("raise", "ax cannot ask: ValueError: a matrix is singular; resume"),
        ("outside", f"proposed {FIRST} = 'nowhere', which is outside the search space"),
        pytest.param("hang", "gave no answer to 'ask'", marks=pytest.mark.slow),
    ],
)
def test_accidents_are_told_in_one_line(accident: str, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if accident == "hang":
        monkeypatch.setattr(peers, "REPLY_TIMEOUT_S", 1.5)
    with pytest.raises(UserError, match=message) as caught:
        fake(synthetic.sampler_settings(0, 4), accident).ask(synthetic.random_design(6, 0.05, 0), [])
    assert "\n" not in str(caught.value)


def test_a_missing_interpreter_is_a_users_mistake() -> None:
    sampler = PeerSampler(synthetic.sampler_settings(0, 4), "ax", lambda: ["/no/such/python", FAKE])
    with pytest.raises(UserError, match="cannot start the peer ax"):
        sampler.ask(synthetic.random_design(6, 0.05, 0), [])


@pytest.mark.parametrize("name", PEER_NAMES)
def test_a_peer_that_is_not_set_up_names_the_command(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GATETUNE_PEERS", str(tmp_path / "none"))
    monkeypatch.setattr(peers, "distributions", lambda name: iter(()))
    assert available_peers() == ()
    with pytest.raises(UserError, match=f"set it up with `python -m research.peers.setup {name}`"):
        peers.peer_command(name)


def test_peers_of_the_extra_run_in_this_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GATETUNE_PEERS", str(tmp_path / "none"))
    monkeypatch.setattr(peers, "distributions", lambda name: iter([name]))
    assert available_peers() == ("ax", "smac")
    assert peers.peer_command("smac")[0] == sys.executable


# -- the real ones, where they have been set up --------------------------------------------------------------


def real(name: str, settings: SamplerSettings) -> PeerSampler:
    if name not in available_peers():
        pytest.skip(f"{name} is not set up: python -m research.peers.setup {name}")
    return make_peer_sampler(name, settings)


def mixed_history(missions: int) -> list[Observation]:
    """Random configurations of the mixed space on two rocks, every fifth a failure."""
    rng = np.random.default_rng(0)
    history: list[Observation] = []
    for i in range(missions):
        values = MIXED.from_unit(rng.random(MIXED.dimension))
        kept = {k: v for k, v in values.items() if k in synthetic.SPACE.paths}
        o = synthetic.observe(i, kept, f"r{i % 2}", 0.05, rng, i // 2 % 2)
        y = None if i % 5 == 4 else o.outcome
        history.append(replace(o, values=values, outcome=y, raw=y))
    return history


@pytest.mark.slow
@pytest.mark.parametrize("name", PEER_NAMES)
def test_real_peer_is_told_failures_and_missions_in_flight(name: str) -> None:
    default = MIXED.default(MissionConfig())
    settings = SamplerSettings(MIXED, default, ("r0", "r1"), 3, 5, 2)
    assert real(name, settings).ask([], []).values == default
    history, pending = mixed_history(11), [Observation(11, default, "r1", 1)]
    proposals = [real(name, settings).ask(history, pending) for _ in range(2)]
    units = [MIXED.to_unit(p.values) for p in proposals]
    for proposal in proposals:
        assert all(p.contains(proposal.values[p.path]) for p in MIXED.parameters)
        assert proposal.metadata["phase"] == "model"
        assert (
            proposal.instance is None or proposal.instance.rock in ("r0", "r1")
        ) and proposal.replicate in (None, 0, 1)
    np.testing.assert_allclose(units[0], units[1], atol=1e-6)  # the same history, told to two samplers


@pytest.mark.slow
@pytest.mark.parametrize("name", PEER_NAMES)
def test_real_peer_learns(name: str) -> None:
    """The best of three asks after 20 random points without noise beats nine tenths of these."""
    settings = SamplerSettings(synthetic.SPACE, synthetic.DEFAULT, ("r0",), 0, 1)
    rng = np.random.default_rng(0)
    points = [synthetic.DEFAULT, *(synthetic.SPACE.from_unit(rng.random(2)) for _ in range(19))]
    history = [synthetic.observe(i, v, "r0", 0.0, rng) for i, v in enumerate(points)]
    sampler = real(name, settings)
    proposals = []
    for _ in range(3):
        values = sampler.ask(history, []).values
        proposals.append(synthetic.true_value(values))
        history.append(synthetic.observe(len(history), values, "r0", 0.0, rng))
    assert max(proposals) > np.quantile([synthetic.true_value(v) for v in points], 0.9)
