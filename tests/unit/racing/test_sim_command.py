"""`swiftros sim` on its own: what it refuses before anything is started, and what it says."""

import argparse
import socket

from swift_ros import cli
from swift_sim_bridge.commands import sim


def test_a_port_in_use_is_one_sentence(capsys):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert cli.main(["sim", "--msp-port", str(port), "--no-images"]) == 2
    assert f"TCP port {port} is not available: Address already in use" in capsys.readouterr().err


def test_without_images_none_are_said_to_be_anywhere():
    says = [sim._welcome(argparse.Namespace(msp_port=5761, msp_client=False, no_images=no)) for no in (False, True)]
    assert ", images are on " in says[0] and "image" not in says[1]
    assert all("the state is on " in one for one in says)
