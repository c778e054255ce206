"""A campaign in optuna-dashboard: the real package, asked over its own web interface."""

from __future__ import annotations

import json
import threading
import urllib.request
from collections.abc import Iterator
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, make_server

import fake_campaigns
import numpy as np
import optuna_dashboard
import pytest
from optuna.artifacts import FileSystemArtifactStore
from PIL import Image

from nbv.mission.run_directory import write_ply
from nbv.types import PointCloud
from tuner.campaign.campaign import Campaign
from tuner.report.dashboard import Dashboard, write_dashboard


class _Silent(WSGIRequestHandler):
    def log_message(self, *_: Any) -> None:
        pass


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    campaign = fake_campaigns.run(
        tmp_path_factory.mktemp("campaign") / "c", sampler="sobol", budget=16, rocks=("b", "flaky-b")
    )
    kept = campaign.directory / campaign.trials()[0].directory
    (kept / "images").mkdir()
    for name in ("seed_00", "cand_007"):
        Image.fromarray(np.full((48, 64, 3), 120, np.uint8)).save(kept / "images" / f"{name}.png")
    write_ply(kept / "cleaned.ply", PointCloud(np.eye(3)))
    return campaign


@pytest.fixture(scope="module")
def server(campaign: Campaign) -> Iterator[str]:
    files: Dashboard = write_dashboard(campaign, campaign.directory / "dashboard")
    store = FileSystemArtifactStore(files.artefacts)
    storage = optuna_dashboard._storage_url.get_storage(str(files.journal))
    with make_server(
        "127.0.0.1", 0, optuna_dashboard.wsgi(storage, artifact_store=store), handler_class=_Silent
    ) as http:
        threading.Thread(target=http.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{http.server_port}"
        http.shutdown()


def asked(url: str) -> dict[str, Any]:
    with urllib.request.urlopen(url, timeout=20) as answer:
        return json.load(answer)


def test_the_server_shows_what_the_ledger_knows(campaign: Campaign, server: str) -> None:
    (study,) = asked(f"{server}/api/studies")["study_summaries"]
    shown = asked(f"{server}/api/studies/{study['study_id']}")["trials"]
    trials = campaign.trials()
    assert {t.state for t in trials} == {"complete", "failed"}
    assert [t["state"] == "Fail" for t in shown] == [t.state == "failed" for t in trials]
    assert [t["constraints"] for t in shown] == [[float(t.state == "failed")] for t in trials]
    assert {a["filename"] for a in shown[0]["artifacts"]} >= {"photographs.jpg", "cleaned.ply"}
    artefact = next(a for a in shown[0]["artifacts"] if a["filename"] == "cleaned.ply")
    where = f"{server}/artifacts/{study['study_id']}/{shown[0]['trial_id']}/{artefact['artifact_id']}"
    with urllib.request.urlopen(where, timeout=20) as answer:
        assert answer.read(3) == b"ply"


def test_the_objective_has_no_rock_in_it(campaign: Campaign, server: str) -> None:
    (study,) = asked(f"{server}/api/studies")["study_summaries"]
    shown = asked(f"{server}/api/studies/{study['study_id']}")["trials"]
    trials = campaign.trials()

    def spread(values: list[float | None]) -> float:
        means = [
            np.mean([v for v, t in zip(values, trials) if t.rock == rock and v is not None])
            for rock in campaign.settings.rocks
        ]
        return float(np.ptp(means))

    adjusted = [t["values"][0] if t["state"] == "Complete" else None for t in shown]
    assert spread([t.raw for t in trials]) > 0.3
    assert spread(adjusted) < 0.5 * spread([t.raw for t in trials])
    importances = asked(f"{server}/api/studies/{study['study_id']}/param_importances")["param_importances"]
    assert {p["name"] for p in importances[0]} == set(campaign.settings.space.paths)
