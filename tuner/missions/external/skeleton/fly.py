"""One mission: the request goes in, the result comes out."""

import subprocess
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent


def fly(request: dict[str, Any]) -> dict[str, Any]:
    """Metrics, or a failure of the configuration. An exception counts as the machine's failure: flown again."""
    c = dict(request["configuration"])
    if request.get("check") == "fail":  # `gatetune mission check` wants to see a failure
        return {"failure": {"of": "configuration", "reason": "asked_to_fail"}}
    file = HERE / f"{request['instance']['name']}.raw"
    delta = c.pop("delta")
    filters = [f"--delta=dist={delta}"] if delta else []
    options = ",".join(f"{name}={value}" for name, value in c.items())
    command = ["xz", "--stdout", "--format=raw", *filters, f"--lzma2={options}", str(file)]
    done = subprocess.run(command, capture_output=True)
    if done.returncode:
        return {"failure": {"of": "configuration", "reason": "refused", "message": done.stderr.decode()}}
    return {"metrics": {"packed_percent": 100 * len(done.stdout) / file.stat().st_size}}
