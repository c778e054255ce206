"""Peers in processes of their own: which there are, and that they learn where they are set up."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest
import synthetic

import research.peers.sampler as peers
from nbv.errors import UserError
from research.peers.sampler import PEER_NAMES, available_peers, make_peer_sampler
from tuner.problem.instances import Instance
from tuner.samplers.base import SamplerSettings


@pytest.fixture(autouse=True)
def _no_process_survives() -> Iterator[None]:
    yield
    for child in psutil.Process().children():
        if child.status() != psutil.STATUS_ZOMBIE and any(w.endswith("_server.py") for w in child.cmdline()):
            child.kill()
            child.wait()


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


@pytest.mark.slow
@pytest.mark.parametrize("name", PEER_NAMES)
def test_real_peer_learns(name: str) -> None:
    """The best of three asks after 20 random points without noise beats nine tenths of these."""
    if name not in available_peers():
        pytest.skip(f"{name} is not set up: python -m research.peers.setup {name}")
    settings = SamplerSettings(replace(synthetic.PROBLEM, instances=(Instance("r0"),)), 0, 1)
    rng = np.random.default_rng(0)
    points = [synthetic.DEFAULT, *(synthetic.SPACE.from_unit(rng.random(2)) for _ in range(19))]
    history = [synthetic.observe(i, v, "r0", 0.0, rng) for i, v in enumerate(points)]
    sampler = make_peer_sampler(name, settings)
    proposals = []
    for _ in range(3):
        values = sampler.ask(history, []).values
        proposals.append(synthetic.true_value(values))
        history.append(synthetic.observe(len(history), values, "r0", 0.0, rng))
    assert max(proposals) > np.quantile([synthetic.true_value(v) for v in points], 0.9)
