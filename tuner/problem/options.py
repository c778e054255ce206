"""What is tuned over the training worlds. No numerics here: the command line imports it."""

from __future__ import annotations

from typing import Literal, get_args

Risk = Literal["mean", "worst"]  # the mean outcome over the training worlds, or that of the worst
RISKS: tuple[Risk, ...] = get_args(Risk)
