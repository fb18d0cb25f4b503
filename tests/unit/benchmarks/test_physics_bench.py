"""The physics' speed beside other simulators, which another interpreter measures."""

import json

from swift_sim_bridge.benchmarks import physics_speed
from swift_sim_bridge.benchmarks.physics_rivals import Row


def test_what_other_simulators_write_does_not_stay_here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "venv").mkdir()
    python = tmp_path / "venv" / "python"
    row = Row("crazyflow", 1, 10, 2000.0, 0.001)
    answer = json.dumps({"rows": [row._asdict()], "says": {"crazyflow": "so it is"}})
    python.write_text(f"#!/bin/sh\ntouch MUJOCO_LOG.TXT\necho '{answer}'\n")
    python.chmod(0o755)
    told = []
    rows, says = physics_speed.measure_rivals("venv/python", told.append)
    assert rows == [row] and says == {"crazyflow": "so it is"}
    assert told == ["crazyflow: so it is"] and [path.name for path in tmp_path.iterdir()] == ["venv"]
