"""What is tuned over the training worlds. No numerics here: the command line imports it."""

from __future__ import annotations

from typing import Literal

Risk = Literal["mean", "worst"]  # the mean outcome over the training worlds, or that of the worst
