"""From what a user names, a scheduler's address or a batch system, to an executor."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, get_args
from urllib.parse import urlsplit

import dask
from distributed import Client, LocalCluster, Security

from nbv.cache import home
from nbv.errors import UserError
from tuner.missions.cluster import worker
from tuner.missions.cluster.executor import DaskExecutor

Where = Literal["dask", "slurm", "pbs"]
WHERE: tuple[Where, ...] = get_args(Where)
_CONNECT_S = 20.0
_SETTINGS = {
    # One death is enough: this program runs the mission again, and counts.
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.worker-ttl": "60s",
    "distributed.admin.large-graph-warning-threshold": "1GB",
}
_THIS_MACHINE = ("127.0.0.1", "::1", "localhost")
_REMEDY = "say --unencrypted where the network is yours alone"


def dask_executor(
    where: Where, scheduler: str | None, workers: int, timeout_s: float, *, unencrypted: bool = False
) -> DaskExecutor:
    """Return an executor on the scheduler at ``scheduler``, on a local cluster, or on jobs of SLURM or PBS.

    ``where``: what is started, with so many ``workers``, where ``scheduler`` is None. ``unencrypted``: whether ``tcp://`` to another
    machine, or between the batch system's, will do: whoever can reach a scheduler or worker there can run programs.

    Raises `UserError`: an address that is not allowed or not answered; a batch system without settings.
    """
    dask.config.set(_SETTINGS)
    if scheduler is not None:
        if where != "dask":
            raise UserError(f"--scheduler belongs to --executor dask, not {where}; leave one of them out")
        _check_address(scheduler, unencrypted)
        client = _client(scheduler)
        try:
            _check_scheduler(client, scheduler, unencrypted)
        except BaseException:
            client.close()
            raise
        return DaskExecutor(client, timeout_s)
    if where == "dask":
        cluster: Any = LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address=None,
            scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # else a warning where 8787 is taken
            silence_logs=50,
        )
    else:
        cluster = _batch_cluster(where, unencrypted)
        cluster.scale(jobs=workers)
    return DaskExecutor(_client(cluster), timeout_s)


def _check_address(address: str, unencrypted: bool) -> None:
    try:
        parts = urlsplit(address)
        good = parts.scheme in ("tcp", "tls") and parts.hostname and parts.port and "@" not in address
    except ValueError:
        good = False
    if not good:
        raise UserError(
            f"--scheduler {address!r} is not an address; give tls://HOST:PORT or tcp://127.0.0.1:PORT"
        )
    if parts.scheme == "tcp" and not unencrypted and parts.hostname not in _THIS_MACHINE:
        raise UserError(
            f"--scheduler {address}: without TLS anybody who reaches it can run programs on the workers; use tls://, or {_REMEDY}"
        )
    if parts.scheme == "tls":
        _check_certificates(address)


def _check_certificates(address: str) -> None:
    """Raise `UserError` where Dask's configuration names none, or no good ones: its client would wait for itself to end."""
    why = "none are named"
    try:
        if Security().get_connection_args("client").get("ssl_context") is not None:
            return
    except (OSError, ValueError) as error:  # of files and of what is in them
        why = str(error)
    raise UserError(
        f"--scheduler {address} needs certificates ({why}); name them where Dask looks, distributed.comm.tls: ca-file, "
        "client.cert and client.key, or DASK_DISTRIBUTED__COMM__TLS__CA_FILE and so on in the environment"
    )


def _check_scheduler(client: Client, address: str, unencrypted: bool) -> None:
    """Raise `UserError` where another program than this runs there, or others may reach it without TLS."""
    here = worker.identity()
    try:
        theirs = client.run_on_scheduler(worker.identity, callback_timeout=_CONNECT_S)
        heard = client.scheduler_info(n_workers=0)["address"]
        why = worker.difference(theirs, here, "scheduler")
    except (ImportError, AttributeError) as error:
        why = f"it has not this program, gatetune {here['gatetune']} ({error}); install it there"
    except (OSError, TimeoutError) as error:
        why = f"it does not answer ({str(error) or type(error).__name__}); look after it and the network"
    if why:
        raise UserError(f"the scheduler at {address}: {why}")
    if heard.startswith("tcp:") and not unencrypted and urlsplit(heard).hostname not in _THIS_MACHINE:
        raise UserError(
            f"the scheduler at {address} also listens on {heard}, without TLS; start it with --host 127.0.0.1 or for tls://, "
            f"or {_REMEDY}"
        )


def _client(to: Any) -> Client:
    try:
        return Client(to, timeout=_CONNECT_S, set_as_default=False, name="gatetune")
    except (OSError, TimeoutError, ValueError, TypeError) as error:
        raise UserError(
            f"no Dask scheduler answers at {to} ({str(error) or type(error).__name__}); start one with `dask scheduler`"
        ) from error


def _batch_cluster(where: Where, unencrypted: bool) -> Any:
    from dask_jobqueue import PBSCluster, SLURMCluster  # noqa: PLC0415  it reads the user's settings when imported

    options: dict[str, Any] = {}
    if not unencrypted:  # certificates of this cluster alone, where jobs can read them
        shared = dask.config.get(f"jobqueue.{where}.shared-temp-directory", None) or home() / "certificates"
        Path(shared).mkdir(mode=0o700, parents=True, exist_ok=True)
        options = {
            "protocol": "tls://",
            "security": Security.temporary(),
            "shared_temp_directory": str(shared),
        }
    try:
        return (SLURMCluster if where == "slurm" else PBSCluster)(**options)
    except (ValueError, OSError, ImportError) as error:
        raise UserError(
            f"--executor {where}: {error}; set cores, memory and so on in ~/.config/dask/jobqueue.yaml"
        ) from error
