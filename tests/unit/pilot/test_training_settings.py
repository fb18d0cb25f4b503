"""A settings file states what is other than in training.yaml, so that one measured number reaches every training."""

import shutil
from dataclasses import replace

import pytest
import yaml

from swift_ros import configuration
from swift_ros.errors import UsageError
from swift_sim_bridge.pilot.job import read_settings

FOLDER = configuration.configuration_folder()
PRESETS = sorted((FOLDER / "trainings").rglob("*.yaml"))


def changed(tmp_path, content) -> tuple:
    """Return the settings of training.yaml, and those with a file of other content."""
    (file := tmp_path / "other.yaml").write_text(yaml.safe_dump({"policy": content}))
    return read_settings(FOLDER), read_settings(FOLDER, file)


def test_a_section_changes_the_entries_that_it_has(tmp_path):
    shipped, other = changed(tmp_path, {"agents": 512, "ppo": {"epochs": 2}, "environment": {"episode_s": 9.0}})
    environment = replace(shipped.environment, episode_s=9.0)
    assert other == replace(shipped, agents=512, ppo=replace(shipped.ppo, epochs=2), environment=environment)


def test_rewards_are_all_rewards(tmp_path):
    shipped, other = changed(tmp_path, {"rewards": {"pace": [13.0, 13.0]}})
    assert other == replace(shipped, rewards={"pace": (13.0, 13.0)})


def test_another_algorithm_does_without_the_section_of_ppo(tmp_path):
    assert changed(tmp_path, {"algorithm": "backpropagation"})[1].ppo is None


@pytest.mark.parametrize("content", [{"agents": "many"}, {"environment": {"episode_s": -1.0}}, {"epochs": 3}])
def test_an_error_names_the_file_that_has_it(tmp_path, content):
    with pytest.raises(UsageError, match="other.yaml, section 'policy'"):
        changed(tmp_path, content)


def test_an_error_of_training_yaml_is_not_one_of_the_other_file(tmp_path):
    (tmp_path / "training.yaml").write_text("policy: {agents: many}")
    with pytest.raises(UsageError, match="training.yaml, section 'policy'"):
        read_settings(tmp_path, PRESETS[0])


def test_measured_errors_of_the_estimate_reach_the_trainings_from_nothing(tmp_path):
    shutil.copytree(FOLDER, folder := tmp_path / "config")
    text = (folder / "training.yaml").read_text()
    assert "    position_m: 0.016 " in text
    (folder / "training.yaml").write_text(text.replace("    position_m: 0.016 ", "    position_m: 0.025 "))
    for file in (folder / "trainings" / "from_nothing").iterdir():
        assert read_settings(folder, file).estimate_errors.position_m == 0.025


@pytest.mark.parametrize("file", PRESETS, ids=lambda file: file.stem)
def test_a_preset_states_nothing_that_training_yaml_has(file):
    given, shipped = (configuration.read_section(one, "policy") for one in (file, FOLDER / "training.yaml"))
    for name, value in given.items():
        assert value != shipped.get(name)
        if isinstance(value, dict) and name != "rewards":
            assert [key for key, own in value.items() if own == shipped[name].get(key)] == []
