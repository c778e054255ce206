"""`gatetune rocks generate`."""

from __future__ import annotations


def test_the_command_names_the_rock(gatetune) -> None:
    code, out, _ = gatetune("rocks", "generate", "--family", "overhang", "--seed", "3")
    assert code == 0 and "overhang-3 (train)" in out
    code, _, err = gatetune("rocks", "generate", "--family", "pebble", "--seed", "3")
    assert code == 2 and "no family 'pebble'" in err
    code, _, err = gatetune(
        "campaign", "run", "--rock", "slab-20000", "--fidelity", "geometric", "--name", "x"
    )
    assert code == 2 and "held out" in err
