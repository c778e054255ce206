"""One mission: the request goes in, the result comes out."""

import subprocess
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent


def run(request: dict[str, Any]) -> dict[str, Any]:
    """Return metrics, or why the configuration fails. An exception is the machine's failure: run again."""
    values = dict(request["configuration"])
    file = HERE / f"{request['instance']['name']}.raw"
    delta = values.pop("delta")
    filters = [f"--delta=dist={delta}"] if delta else []
    options = ",".join(f"{name}={value}" for name, value in values.items())
    command = ["xz", "--stdout", "--format=raw", *filters, f"--lzma2={options}", str(file)]
    done = subprocess.run(command, stdout=subprocess.PIPE)
    if done.returncode:
        return {"failure": "refused"}
    return {"metrics": {"packed_percent": 100 * len(done.stdout) / file.stat().st_size}}
