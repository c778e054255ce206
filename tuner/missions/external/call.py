"""Runs ``module:function`` of a mission file: ``python -P call.py MODULE:FUNCTION REQUEST``.

A file of its own that imports nothing of this program: the mission's process starts in the time that Python takes.
"""

import importlib
import json
import os
import sys
from pathlib import Path


def main(target: str, request_file: str) -> None:
    """Call the function with the request; what it returns becomes the result."""
    request = json.loads(Path(request_file).read_text(encoding="utf-8"))
    module, _, name = target.partition(":")
    result = getattr(importlib.import_module(module), name)(request)
    if isinstance(result, dict):
        result = {
            "schema": "gatetune.result/1",
            "status": "failed" if "failure" in result else "ok",
            **result,
        }
    half = Path(request["result"]).with_suffix(".part")
    half.write_text(json.dumps(result), encoding="utf-8")
    os.replace(half, request["result"])  # noqa: PTH105  one step: there is never half a result


if __name__ == "__main__":
    main(*sys.argv[1:])
