"""Peers in processes of their own: which there are, and what is said of one that is not set up."""

import sys
from pathlib import Path

import pytest

import research.peers.sampler as peers
from nbv.errors import UserError
from research.peers.sampler import PEER_NAMES, available_peers


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
