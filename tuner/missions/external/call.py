"""Runs ``module:function`` of a mission file: ``python -P call.py MODULE:FUNCTION REQUEST``.

The file imports nothing of this program, so a mission starts in the time that Python takes.
"""

import importlib
import json
import sys
from pathlib import Path


def main(target: str, request_file: str) -> None:
    """Call the function with the request and write what it returns as the result."""
    request = json.loads(Path(request_file).read_text(encoding="utf-8"))
    module, _, name = target.partition(":")
    result = getattr(importlib.import_module(module), name)(request)
    Path(request["output"], "result.json").write_text(json.dumps(result, default=float), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
