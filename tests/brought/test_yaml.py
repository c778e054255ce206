"""Values as users write them: files and command line read YAML 1.2's core schema, and what is written reads back."""

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from nbv.errors import UserError
from nbv.safe_files import parse_yaml, to_yaml
from tuner.commands.console import parse_overrides

TEXTS = ["no", "yes", "on", "off", "y", "n", "No", "YES", "a_1", "12:30", "2001-09-09", "0b1", "=", ".5."]
VALUES = {
    "1e-6": 1e-6,
    "1E3": 1e3,
    "+.5e+2": 50.0,
    "5.": 5.0,
    "-.inf": float("-inf"),
    "010": 10,
    "0o10": 8,
    "0x1F": 31,
    "+5": 5,
    "True": True,
    "FALSE": False,
    "~": None,
    "Null": None,
    "'1e-6'": "1e-6",
    "<<": "<<",
    "'1_000'": "1_000",
}
REFUSED = {
    "a: !!binary aGk=": "line 1: the tag !!binary is not read; give a plain value without it",
    "a: 1\nb: !!timestamp 2001-01-01": "line 2: the tag !!timestamp is not read",
    "a: !!python/object:os.system x": "the tag !!python/object:os.system is not read",
    "a: !mine 3": "the tag !mine is not read",
    "a: 1_0": "line 1: 1_0 is a number in YAML 1.1 and a text in 1.2; write 10, or quote it",
    "a: [2, -1_000.5]": "write -1000.5, or quote it",
    "<<: 3": "line 1: the key << takes in another mapping (<<: *NAME), and no mapping follows",
}


@pytest.mark.parametrize("text, value", [*VALUES.items(), *zip(TEXTS, TEXTS)])
def test_a_plain_value_is_what_yaml_1_2_says(text: str, value: object) -> None:
    for read in (
        parse_yaml(f"a: {text}", "it")["a"],
        parse_yaml(f"[{text}]", "it")[0],
        parse_overrides([f"a={text}"])["a"],
    ):
        assert read == value and type(read) is type(value)


@pytest.mark.parametrize("text, words", REFUSED.items())
def test_what_is_no_plain_value_is_one_line(text: str, words: str) -> None:
    with pytest.raises(UserError) as told:
        parse_yaml(text, "it")
    assert words in str(told.value) and "\n" not in str(told.value)
    assert parse_yaml("base: &b {x: 1}\na: {<<: *b, y: 2}", "it")["a"] == {"x": 1, "y": 2}


@given(
    st.recursive(
        st.sampled_from([*VALUES, *VALUES.values(), *TEXTS])
        | st.floats(allow_nan=False)
        | st.text(max_size=5),
        lambda inner: (
            st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(TEXTS), inner, max_size=3)
        ),
        max_leaves=6,
    )
)
def test_what_is_written_reads_back_by_either_version(tree: object) -> None:
    assert parse_yaml(to_yaml(tree), "it") == yaml.safe_load(to_yaml(tree)) == tree
