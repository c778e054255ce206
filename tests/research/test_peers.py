"""Peers in processes of their own: which there are, and that they learn where they are set up."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest
import synthetic

import research.peers.sampler as peers
from nbv.config import MissionConfig
from nbv.errors import UserError
from research.peers.sampler import PEER_NAMES, PeerSampler, available_peers, make_peer_sampler
from tuner.problem.instances import Instance
from tuner.problem.observations import Observation
from tuner.problem.problem import Problem
from tuner.problem.space_files import space_from_dict
from tuner.samplers.base import SamplerSettings

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


@pytest.fixture(autouse=True)
def _no_process_survives() -> Iterator[None]:
    yield
    for server in running_servers():
        server.kill()
        server.wait()


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
    settings = SamplerSettings(Problem(MIXED, (Instance("r0"), Instance("r1")), default, 2), 3, 5)
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
    settings = SamplerSettings(replace(synthetic.PROBLEM, instances=(Instance("r0"),)), 0, 1)
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
