"""One mission at a time on a card, and what its refusals mean."""

import threading

import pytest

from nbv.dense import patchmatch as card
from nbv.errors import MissionFailure


@pytest.fixture(autouse=True)
def two_cards(monkeypatch, tmp_path):
    monkeypatch.setattr(card.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "3,5")


def test_cards_are_the_visible_ones_else_all(monkeypatch, tmp_path):
    assert [(c.index, c.id) for c in card.cards()] == [(0, "3"), (1, "5")]
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES")
    monkeypatch.setattr(card, "DEVICES", tmp_path)
    for name in ("nvidiactl", "nvidia10", "nvidia2"):
        (tmp_path / name).touch()
    assert [c.id for c in card.cards()] == ["2", "10"]


def test_each_card_has_one_mission_and_the_next_waits():
    third = list[str]()

    def wait() -> None:
        with card.free_card() as free:
            third.append(free.id)

    waiting = threading.Thread(target=wait)
    with card.free_card() as first:
        with card.free_card() as second:
            assert (first.id, second.id) == ("3", "5")
            waiting.start()
            waiting.join(0.5)
            assert third == []
        waiting.join(30)
    assert third == ["5"]


def test_without_a_card_the_mission_fails(monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    with pytest.raises(MissionFailure, match=r"dense\.backend=sgbm") as failed, card.free_card():
        pass
    assert failed.value.reason == "machine_error: card_lost"


@pytest.mark.parametrize(
    ("said", "reason"),
    [
        ("E1 cudacc.cc:52] CUDA error at gpu_mat.h:144 - out of memory\n", "card_full"),
        (
            "CUDA error at patch_match_cuda.cu:1 - no kernel image is available for execution on the device",
            "card_too_old",
        ),
        (
            "what():  1 task(s) threw exception(s):\n[cuda.cc:85] Check failed: num_cuda_devices > 0 (0 vs. 0) No CUDA devices available\n",
            "card_lost",
        ),
        ("RuntimeError: something else\n", "card_failed"),
    ],
)
def test_a_refusal_names_card_and_remedy(said, reason):
    failed = card.refusal("card 3 (NVIDIA H100)", said, 134)
    assert failed.reason == f"machine_error: {reason}"
    assert "card 3 (NVIDIA H100)" in failed.message and "dense.backend=sgbm" in failed.message
    assert said.strip().splitlines()[-1].rpartition("] ")[2].rpartition(" - ")[2][:20] in failed.message
