"""`swiftros sim` without a simulator: what it refuses before the start, and its help."""

import argparse
import socket
from types import SimpleNamespace

import pytest

from swift_ros import cli
from swift_ros.graph.runner import NodeFault
from swift_ros.working_time import WorkingTime
from swift_sim_bridge.commands import sim


def test_a_port_in_use_is_refused_in_one_sentence(capsys):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert cli.main(["sim", "--msp-port", str(port), "--no-images"]) == 2
    assert f"TCP port {port} is not available: Address already in use" in capsys.readouterr().err


def test_the_help_names_the_image_topic_only_with_images():
    texts = [
        sim._welcome(argparse.Namespace(msp_port=5761, msp_client=False, no_images=no), 21) for no in (False, True)
    ]
    assert ", images are on " in texts[0] and "image" not in texts[1]
    assert all("the state is on " in text for text in texts)


def test_a_port_and_a_seed_that_do_not_exist_are_refused_before_anything_starts(capsys):
    for wrong, sentence in (
        (["--msp-port", "99999"], "there is no TCP port 99999"),
        (["--msp-port", "-5"], "there is no TCP port -5"),
        (["--seed", str(2**31)], "there is no seed 2147483648"),
        (["--seed", "-1"], "there is no seed -1"),
    ):
        assert cli.main(["sim", *wrong]) == 2
        assert sentence in capsys.readouterr().err


def test_the_command_line_for_another_shell_names_the_ros_domain():
    text = sim._welcome(argparse.Namespace(msp_port=5761, msp_client=False, no_images=True), 37)
    assert "ROS_DOMAIN_ID=37 ros2 topic pub" in text


class FollowedFlight(SimpleNamespace):
    """A listener to a graph that is up, and what it reported."""

    def __init__(self):
        super().__init__(working_time=WorkingTime(), end=None, domain=21, link_ns=1, warnings=[], errors=[])

    def spin(self):
        pass

    def warn(self, sentence):
        self.warnings.append(sentence)

    def report_fault(self, sentence):
        self.errors.append(sentence)


@pytest.mark.parametrize(("node", "code"), [("recorder", 0), ("bridge", 1)])
def test_only_the_loss_of_a_needed_node_ends_the_simulation_and_it_is_named(monkeypatch, capsys, tmp_path, node, code):
    typed = tmp_path / "typed"
    typed.write_text("quit\n")
    fault = NodeFault(node, f"{node} was killed by SIGKILL; see its log")
    nodes, listener = SimpleNamespace(faults=lambda: [fault]), FollowedFlight()
    arguments = argparse.Namespace(msp_port=5761, msp_client=False, no_images=True)
    with open(typed) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        assert sim._attend(nodes, listener, arguments) == code
    assert (listener.errors or listener.warnings) == [fault.sentence] and bool(listener.errors) == bool(code)
    assert (fault.sentence in capsys.readouterr().err) == bool(code)
