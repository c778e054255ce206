"""Records of missions that somebody else wrote."""

import json

import pytest

from tuner.report.pages import recorded, recorded_rows


@pytest.mark.parametrize("provenance", ["text", 7, [1], {"versions": "text"}, {"versions": ["numpy"]}])
def test_a_provenance_that_is_no_record_is_left_out(tmp_path, provenance):
    (tmp_path / "mission.json").write_text(json.dumps({"provenance": provenance}))
    assert recorded([tmp_path]) == []
    assert dict(recorded_rows(recorded([tmp_path])))["machine"] == "not recorded"
