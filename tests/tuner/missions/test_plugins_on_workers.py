"""Plug-ins on workers: in processes of this machine and on a real Dask cluster; what hangs or is not there fails clearly."""

import sys
from collections.abc import Iterator
from pathlib import Path

import every_part
import pytest

pytest.importorskip("distributed", reason="pip install 'gatetune[cluster]'")

from test_dask_pool import Cluster
from test_pool import run_jobs

from nbv import plugins
from nbv.config import preset
from nbv.errors import UserError
from tuner.missions.dask_pool import DaskPool
from tuner.missions.job import MissionJob

REGISTERS = """
from nbv.config import Weights
from nbv.plugins import register
from nbv.scorers import Scorer

def high(terms, pool, config):
    return pool.positions_m[:, 2] / 8.0

register("scorers", "high", Scorer("high", high, weights=lambda config: Weights()))
"""


@pytest.fixture
def brought(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An installed distribution, and a file that registers scorers of its own; the former's module."""
    file = every_part.install(tmp_path / "site")
    monkeypatch.syspath_prepend(tmp_path / "site")
    (tmp_path / "registers_scorers.py").write_text(REGISTERS)
    monkeypatch.setattr(plugins, "_registered", {})
    monkeypatch.setattr(sys, "path", [*sys.path])
    plugins.installed.cache_clear()
    plugins.use(str(tmp_path / "registers_scorers.py"))
    yield file
    plugins.installed.cache_clear()
    for name in ("registers_scorers", "every_part_module"):
        sys.modules.pop(name, None)


def job(tmp_path: Path, kind: str, fidelity: str = "geometric", rock: str = "slab") -> MissionJob:
    config = preset("campaign").with_values({"gate.kind": kind, "photographs": 26})
    return MissionJob(kind, config, rock, 0, tmp_path / "missions" / kind, fidelity=fidelity)


@pytest.mark.slow
def test_installed_and_registered_plug_ins_run_on_dask_and_others_are_refused(
    tmp_path: Path, brought: Path
) -> None:
    sys.path.remove(str(tmp_path))  # workers find the file by what they are told
    with Cluster(tmp_path, 1) as cluster, DaskPool(cluster.address, 60.0) as executor:
        jobs = [job(tmp_path, "low", "counted", "egg-5"), job(tmp_path, "high")]
        ended = run_jobs(executor, jobs)
        assert {trial.record.status for trial in ended.values()} == {"ok"}, [
            t.record.message for t in ended.values()
        ]
        assert ended["low"].metrics["views"] == 1.0, "the fidelity of the plug-in"
        for name in ("low", "high"):
            trace = (tmp_path / "missions" / name / "mission.json").read_text()
            assert f"scorers/{name}" in trace
        brought.write_text(every_part.PARTS + "\n# changed\n")
        plugins.installed.cache_clear()
        with pytest.raises(UserError, match=r"the code of scorer 'low' of every-part 1.2 is .* there"):
            run_jobs(executor, [job(tmp_path, "low")])


@pytest.mark.slow
def test_a_worker_without_the_plug_in_says_so_once(tmp_path: Path, brought: Path) -> None:
    sys.path.remove(str(tmp_path / "site"))
    with Cluster(tmp_path, 1) as cluster:
        sys.path.insert(0, str(tmp_path / "site"))
        with (
            DaskPool(cluster.address, 60.0) as executor,
            pytest.raises(UserError, match=r"a worker refuses: gate\.kind is 'low'"),
        ):
            run_jobs(executor, [job(tmp_path, "low")])
