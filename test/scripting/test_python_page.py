"""The code of docs/python.md runs as it stands."""

import re
import warnings

import pytest

import softrobot_twin as st
from test.places import ROOT

TEXT = (ROOT / "docs" / "python.md").read_text()


@pytest.mark.exhaustive
def test_the_code_of_the_page_runs_block_by_block(tmp_path, monkeypatch, capsys):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    for folder in ("config", "meshes"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    names: dict = {}
    blocks = re.findall(r"```python\n(.*?)```", TEXT, re.S)
    assert len(blocks) >= 8
    with warnings.catch_warnings():
        warnings.simplefilter("error", st.SceneWarning)
        for block in blocks:
            exec(compile(block, "docs/python.md", "exec"), names)
    printed = capsys.readouterr().out
    assert "is flexor_shortening_m meant?" in printed and "<Result ok; tip at [" in printed
    assert names["table"]["status"].tolist().count("diverged") == 0
    assert {path.name for path in tmp_path.glob("finger.*")} == {
        "finger.png", "finger.rrd", "finger.vtu"}
    repeated = names["again"]["tip_z_m"].tolist()
    assert len(repeated) > 10 and min(repeated) < -0.005
