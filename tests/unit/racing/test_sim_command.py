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
    texts = [sim._welcome(argparse.Namespace(msp_port=5761, msp_client=False, no_images=no)) for no in (False, True)]
    assert ", images are on " in texts[0] and "image" not in texts[1]
    assert all("the state is on " in text for text in texts)
