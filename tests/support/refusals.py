"""What a user's mistake ends in."""

from collections.abc import Callable
from typing import Any

import pytest

from nbv.errors import UserError


def refused(says: str, call: Callable[..., Any], *arguments: Any, **options: Any) -> str:
    """The one line in which a call refuses what it is given; ``says`` is a pattern that is found in it."""
    with pytest.raises(UserError, match=says) as told:
        call(*arguments, **options)
    said = str(told.value)
    # Traceback and frame hold each other: what the call made would else be finalised at any later time, in any thread.
    del told
    assert "\n" not in said
    return said
