"""Speed of the training: the shares of an update are what their parts take beyond one another."""

import shutil
from dataclasses import replace

import pytest
import yaml

from swift_ros import configuration
from swift_ros.errors import UsageError
from swift_sim_bridge.benchmarks import training_speed


def test_the_shares_add_up_to_the_processor_time_of_the_whole():
    whole = {"devices": 2, "interactions_per_s": 91234.4, "cpu_s_per_million": 17.25, "trials": 0.5}
    figures = whole | {"compile_cpu_s": 31.26}
    one = training_speed._with_shares(figures, {"physics": 1.0, "step": 1.5, "roll_out": 4.0})
    assert list(one["shares"].values()) == [1.0, 0.5, 2.5, 12.75, 0.5]
    rows = training_speed.table({"full physics": one, "the paper's model": one | {"cpu_s_per_million": 12.0}})
    assert rows[0] == ("training", "full physics", "the paper's model") and {len(row) for row in rows} == {3}
    text = {row[0].strip(): row[1:] for row in rows}
    assert text["interactions/s, end to end"] == ("91,234", "91,234")
    assert text["CPU s per million interactions"] == ("17.25", "12.00")
    assert text["advantages, gradients"] == ("12.75", "12.75") and text["trial races"] == ("0.50", "0.50")


def test_a_call_costs_processor_time_and_its_first_one_the_compilation_too():
    calls = []

    def work():
        calls.append(sum(k * k for k in range(20000 if calls else 2_000_000)))

    cost = training_speed.measure_call(work, rounds=3)
    assert len(calls) == 4 and 0 < cost.cpu_s < 0.2 * cost.compile_s


def test_the_prototypes_epochs_are_measured_beside_the_settings_that_ship():
    folder = configuration.configuration_folder()
    vehicles, settings = zip(*training_speed.cases(folder).values(), strict=True)
    assert vehicles[0] != vehicles[1] and vehicles[1] is vehicles[2]
    shipped, _, prototype = (one.ppo for one in settings)
    assert (prototype.epochs, prototype.minibatch) == (4, 2048)
    assert replace(prototype, epochs=shipped.epochs, minibatch=shipped.minibatch) == shipped


def test_the_speed_is_that_of_ppo(tmp_path):
    folder = tmp_path / "config"
    shutil.copytree(configuration.configuration_folder(), folder)
    content = yaml.safe_load((folder / "training.yaml").read_text())
    del content["policy"]["ppo"]
    content["policy"]["algorithm"] = "backpropagation"
    (folder / "training.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(UsageError, match="training.yaml: .*'algorithm: ppo'"):
        training_speed.cases(folder)
