"""Speed of the physics compared with other simulators, which another interpreter measures."""

import json

from swift_sim_bridge.benchmarks import physics_speed
from swift_sim_bridge.benchmarks.physics_rivals import Row


def test_files_of_other_simulators_do_not_stay_in_the_working_directory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "venv").mkdir()
    python = tmp_path / "venv" / "python"
    row = Row("crazyflow", 1, 10, 2000.0, 0.001)
    answer = json.dumps({"rows": [row._asdict()], "says": {"crazyflow": "so it is"}})
    python.write_text(f"#!/bin/sh\ntouch MUJOCO_LOG.TXT\necho '{answer}'\n")
    python.chmod(0o755)
    lines = []
    rows, descriptions = physics_speed.measure_rivals("venv/python", lines.append)
    assert rows == [row] and descriptions == {"crazyflow": "so it is"}
    assert lines == ["crazyflow: so it is"] and [path.name for path in tmp_path.iterdir()] == ["venv"]
