"""`swiftros sim` on its own: what it refuses before anything is started."""

import socket

from swift_ros import cli


def test_a_port_in_use_is_one_sentence(capsys):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert cli.main(["sim", "--msp-port", str(port), "--no-images"]) == 2
    assert f"TCP port {port} cannot be had: Address already in use" in capsys.readouterr().err
