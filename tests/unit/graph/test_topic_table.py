"""The table of the graph is consistent with itself and with the messages, nodes and settings that exist."""

import importlib.util
from pathlib import Path

import pytest

from swift_ros import configuration, messages
from swift_ros.graph.topic_table import IMPORTED, MAY_HEAR_GROUND_TRUTH, NODES, SERVICES, TOPICS, full_name
from swift_ros.nodes.shell import quality

CONFIG = Path(__file__).parents[3] / "config"
# what comes from outside the table: the vehicle's odometry source, a motion-capture system
OUTSIDE = {"vio/raw", "ground_truth/odometry"}


def test_every_topic_has_a_speaker_and_every_heard_topic_is_in_the_table():
    spoken = {topic for node in NODES.values() for topic in node.publishes}
    heard = {topic for node in NODES.values() for topic in node.hears}
    assert spoken | set(IMPORTED) == set(TOPICS) and not spoken & set(IMPORTED)
    assert heard <= spoken


@pytest.mark.parametrize("node", [node for node in NODES.values() if node.answers], ids=lambda node: node.name)
def test_a_node_hears_what_it_answers_and_answers_as_often(node):
    assert node.answers in node.hears
    assert TOPICS[node.answers].rate_hz == TOPICS[node.publishes[0]].rate_hz


def test_onboard_every_topic_has_one_speaker_and_needs_no_simulator():
    onboard = [node for node in NODES.values() if node.onboard]
    spoken = [topic for node in onboard for topic in node.publishes if topic != "/diagnostics"]
    assert len(spoken) == len(set(spoken))
    assert {topic for node in onboard for topic in node.hears} - set(spoken) - {"/diagnostics"} <= OUTSIDE


def test_only_judge_recorder_and_simulator_may_hear_ground_truth():
    hearers = {node.name for node in NODES.values() for topic in node.hears if topic.startswith("ground_truth/")}
    assert hearers <= set(MAY_HEAR_GROUND_TRUTH)
    assert set(MAY_HEAR_GROUND_TRUTH) <= set(NODES)


@pytest.mark.parametrize("topic", TOPICS.values(), ids=lambda topic: topic.name)
def test_the_type_of_each_topic_exists(topic):
    assert messages.message_type(topic.type).__name__ == topic.type.rsplit("/", 1)[1]


def test_services_exist_and_full_names_are_absolute():
    assert all(messages.message_type(kind) for kind in SERVICES.values())
    assert full_name("race/arm") == "/swift/race/arm" and full_name("/clock") == "/clock"


@pytest.mark.parametrize("node", NODES.values(), ids=lambda node: node.name)
def test_each_row_is_a_module_with_a_main_and_a_section_of_settings(node):
    module = f"{node.package}.nodes.{node.name}"
    found = importlib.util.find_spec(module)
    assert found is not None, f"{module} does not exist"
    assert "def main(" in Path(found.origin).read_text()
    assert node.name in configuration.read_yaml(CONFIG / "nodes.yaml")


def test_images_may_be_late_in_real_time_but_nothing_is_lost_in_lockstep():
    image, command = TOPICS["camera/image_raw"], TOPICS["command/body_rate_thrust"]
    assert (quality(image, False).depth, quality(image, False).reliability.name) == (1, "BEST_EFFORT")
    assert (quality(image, True).depth, quality(image, True).reliability.name) == (1000, "RELIABLE")
    assert (quality(command, False).depth, quality(command, False).reliability.name) == (10, "RELIABLE")


def test_what_a_command_waits_for_goes_before_images_and_images_before_what_only_listens():
    priority = {name: row.priority or 0 for name, row in NODES.items()}
    command = {priority[name] for name in ("vio", "state_estimator", "policy", "betaflight")}
    assert len(command) == 1
    assert priority["bridge"] > max(command)  # it stands in for hardware
    assert command.pop() > priority["race_monitor"] == priority["gate_pose"] > priority["gate_detector"]
    patient = {name: row.patient_priority for name, row in NODES.items()}
    assert priority["recorder"] == 10 and patient["recorder"] == 0  # receives in time, writes when there is time
    # Ticks need the interpreter's lock that drawing holds: drawing must not queue behind what looks at the images.
    assert max(priority["race_monitor"], priority["gate_detector"]) < patient["bridge"] < priority["policy"]
