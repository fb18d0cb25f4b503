"""The table of the graph is consistent, and agrees with the existing messages, nodes and settings."""

import importlib.util
from pathlib import Path

import pytest

from swift_ros import configuration
from swift_ros.graph.qos import qos_profile
from swift_ros.graph.topic_table import GROUND_TRUTH_SUBSCRIBERS, IMPORTED, NODES, SERVICES, TOPICS, full_name
from swift_ros.messages.serialization import message_type

CONFIG = Path(__file__).parents[3] / "config"
# published from outside: by the vehicle's odometry source and by a motion-capture system
OUTSIDE = {"vio/raw", "imu/data_raw", "ground_truth/odometry"}


def test_every_topic_has_a_publisher_and_every_subscribed_topic_is_in_the_table():
    published = {topic for node in NODES.values() for topic in node.publishes}
    subscribed = {topic for node in NODES.values() for topic in node.subscribes}
    assert published | set(IMPORTED) == set(TOPICS) and not published & set(IMPORTED)
    assert subscribed <= published


@pytest.mark.parametrize("node", [node for node in NODES.values() if node.answers], ids=lambda node: node.name)
def test_a_node_subscribes_to_the_topic_that_it_answers_and_answers_at_its_rate(node):
    assert node.answers in node.subscribes
    assert TOPICS[node.answers].rate_hz == TOPICS[node.publishes[0]].rate_hz


def test_onboard_every_topic_has_one_publisher_and_no_simulator_is_needed():
    onboard = [node for node in NODES.values() if node.onboard]
    published = [topic for node in onboard for topic in node.publishes if topic != "/diagnostics"]
    assert len(published) == len(set(published))
    assert {topic for node in onboard for topic in node.subscribes} - set(published) - {"/diagnostics"} <= OUTSIDE


def test_only_race_monitor_recorder_and_simulator_subscribe_to_ground_truth():
    subscribers = {
        node.name for node in NODES.values() for topic in node.subscribes if topic.startswith("ground_truth/")
    }
    assert subscribers <= set(GROUND_TRUTH_SUBSCRIBERS)
    assert set(GROUND_TRUTH_SUBSCRIBERS) <= set(NODES)


@pytest.mark.parametrize("topic", TOPICS.values(), ids=lambda topic: topic.name)
def test_the_type_of_each_topic_exists(topic):
    assert message_type(topic.type).__name__ == topic.type.rsplit("/", 1)[1]


def test_services_exist_and_full_names_are_absolute():
    assert all(message_type(kind) for kind in SERVICES.values())
    assert full_name("race/arm") == "/swift/race/arm" and full_name("/clock") == "/clock"


@pytest.mark.parametrize("node", NODES.values(), ids=lambda node: node.name)
def test_each_row_is_a_module_with_a_main_and_a_section_of_settings(node):
    module = node.entry_point.partition(" = ")[2].removesuffix(":main")
    found = importlib.util.find_spec(module)
    assert found is not None, f"{module} does not exist"
    assert "def main(" in Path(found.origin).read_text()
    assert node.name in configuration.read_yaml(CONFIG / "nodes.yaml")


def test_images_are_best_effort_in_real_time_and_every_topic_is_reliable_in_lockstep():
    image, command = TOPICS["camera/image_raw"], TOPICS["command/body_rate_thrust"]
    assert (qos_profile(image, False).depth, qos_profile(image, False).reliability.name) == (1, "BEST_EFFORT")
    assert (qos_profile(image, True).depth, qos_profile(image, True).reliability.name) == (1000, "RELIABLE")
    assert (qos_profile(command, False).depth, qos_profile(command, False).reliability.name) == (10, "RELIABLE")


def test_nodes_of_the_command_chain_have_priority_over_images_and_images_over_nodes_that_only_record():
    priority = {name: row.priority or 0 for name, row in NODES.items()}
    command = {priority[name] for name in ("vio", "state_estimator", "policy", "betaflight")}
    assert len(command) == 1
    assert priority["bridge"] > max(command)  # it replaces the hardware
    assert command.pop() > priority["race_monitor"] == priority["gate_pose"] > priority["gate_detector"]
    background = {name: row.background_priority for name, row in NODES.items()}
    assert priority["recorder"] == 10 and background["recorder"] == 0  # it receives at once, it writes later
    # Ticks need the interpreter lock that the renderer holds: the renderer must not wait for the nodes that use images.
    assert max(priority["race_monitor"], priority["gate_detector"]) < background["bridge"] < priority["policy"]
