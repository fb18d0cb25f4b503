"""The viewer's program serves this machine alone, and ends with the command."""

import http.client
from pathlib import Path
from urllib.parse import parse_qs, urlparse

import pytest

from swift_sim_bridge.tcp_ports import LOOPBACK, require_free

LOOPBACK_HEX, LISTENING = "0100007F", "0A"  # as in /proc/net/tcp


def listeners(port: int) -> list[str]:
    """Return the addresses on which processes listen at a port, IPv6 included."""
    rows = [line.split() for name in ("tcp", "tcp6") for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]]
    return [row[1].split(":")[0] for row in rows if row[1].endswith(f":{port:04X}") and row[3] == LISTENING]


def test_page_and_data_are_served_on_the_loopback_interface_alone_until_the_end(tmp_path):
    rr = pytest.importorskip("rerun", reason="needs Rerun: make view")
    from rerun_file import RerunFile

    from swift_sim_bridge.view.viewer import Viewer, recording

    viewer = Viewer(web=True)
    try:
        page = urlparse(viewer.page)
        (url,) = parse_qs(page.query)["url"]
        assert url == viewer.url
        ports = page.port, urlparse(url).port
        assert [listeners(port) for port in ports] == [[LOOPBACK_HEX], [LOOPBACK_HEX]]
        connection = http.client.HTTPConnection(LOOPBACK, page.port)
        connection.request("GET", "/")
        assert b"<html" in connection.getresponse().read().lower()
        with recording("both", viewer, tmp_path / "both.rrd") as stream:
            stream.log("log/test", rr.TextLog("in both"))
    finally:
        viewer.close()
    assert RerunFile(tmp_path / "both.rrd").texts("log/test") == ["in both"]
    for port in ports:
        require_free(port, "the viewer has not ended")
