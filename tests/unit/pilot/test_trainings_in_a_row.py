"""Trainings in a row begin each with the pilot of the one before, resume, and are refused before the first."""

import json

import pytest
from tiny_training import log_of, train

from swift_ros.errors import UsageError
from swift_sim_bridge.model_files import provenance
from swift_sim_bridge.pilot import stages
from swift_sim_bridge.pilot import train as training


@pytest.mark.slow
def test_trainings_in_a_row_begin_with_the_pilot_before_and_go_on_where_they_stopped(
    tiny_configuration, tmp_path, capsys, monkeypatch
):
    out, settings = tmp_path / "row", tmp_path / "settings"
    settings.mkdir()
    for name in ("1-first", "2-second"):
        (settings / f"{name}.yaml").write_text((tiny_configuration / "training.yaml").read_text())
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(stages, "train_policy", lambda stage: stop_in_the_second(stage, training.train_policy))
        train(tiny_configuration, out, "--settings", str(settings))
    first = (out / "1-first" / "pilot.npz").read_bytes()
    assert train(tiny_configuration, out, "--settings", str(settings)) == 0
    assert "training 1 of 2: " in (printed := capsys.readouterr().out) and "1-first.yaml, is done" in printed
    assert (out / "1-first" / "pilot.npz").read_bytes() == first
    begun_with = [json.loads((out / name / "pilot.json").read_text())["started_from"] for name in ("1-first", ".")]
    assert begun_with == [{}, {"pilot.npz": provenance.file_hash(out / "1-first" / "pilot.npz")}]
    assert [one["interactions"] for one in log_of(out / "1-first")] == [64, 128, 192, 256]
    assert log_of(out)[-1]["interactions"] == 128  # as long as `fine_tuning` says


def stop_in_the_second(stage, train_policy):
    if stage.out.name != "1-first":
        raise KeyboardInterrupt
    train_policy(stage)


@pytest.mark.parametrize(
    ("files", "options", "said"),
    [
        ({"a.yaml": "policy: {}", "b.yaml": ""}, ("--interactions", "64"), "--interactions is the length of one"),
        ({"notes.txt": ""}, (), "which has no .yaml file"),
        ({"1.yaml": None, "2.yaml": "policy: {agents: many}"}, (), "2.yaml"),
    ],
)
def test_trainings_in_a_row_that_cannot_be_are_refused_before_the_first(
    tiny_configuration, tmp_path, files, options, said
):
    out, settings = tmp_path / "row", tmp_path / "settings"
    settings.mkdir()
    for name, content in files.items():
        (settings / name).write_text((tiny_configuration / "training.yaml").read_text() if content is None else content)
    with pytest.raises(UsageError, match=said):
        train(tiny_configuration, out, "--settings", str(settings), *options)
    assert not out.exists()
