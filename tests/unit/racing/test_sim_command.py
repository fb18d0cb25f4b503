"""`swiftros sim` without a simulator: what it refuses before the start, and its help."""

import argparse
import socket

from swift_ros import cli
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
