"""The page on which a person labels, served on the loopback interface."""

import json
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from swift_ros.errors import UsageError
from swift_sim_bridge.labelling.session import Session
from swift_sim_bridge.tcp_ports import LOOPBACK, PORTS

PAGE = Path(__file__).parent / "page"
FILES = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
}
MAX_BODY_BYTES = 4_000_000  # of one accepted frame


class LabellingServer(ThreadingHTTPServer):
    """Serves one session.

    Args:
        session: of labelling.
        port: TCP port; 0 for any free one.

    Raises:
        UsageError: the port is not available.
    """

    daemon_threads = True

    def __init__(self, session: Session, port: int):
        self.session = session
        if port and port not in PORTS:
            raise UsageError(f"there is no TCP port {port}; ports are {PORTS[0]} to {PORTS[-1]}")
        try:
            super().__init__((LOOPBACK, port), _Handler)
        except OSError as error:
            raise UsageError(f"TCP port {port} is not available: {error.strerror}; choose another --port") from error

    @property
    def address(self) -> str:
        """URL of the page."""
        return f"http://{LOOPBACK}:{self.server_address[1]}/"


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: LabellingServer

    def do_GET(self):
        if not self._is_local():
            return
        if self.path in FILES:
            name, kind = FILES[self.path]
            self._send(HTTPStatus.OK, (PAGE / name).read_bytes(), kind)
        elif self.path == "/session":
            self._answer(self.server.session.overview)
        elif self.path.startswith("/frame/"):
            self._answer(lambda: self.server.session.frame(self._number()))
        elif self.path.startswith("/picture/"):
            self._answer(lambda: self.server.session.picture(self._number()))
        else:
            self._refuse(HTTPStatus.NOT_FOUND, "there is no such page")

    def do_POST(self):
        if not self._is_local():
            return
        # a page of another site cannot send this type without asking first
        if self.headers.get_content_type() != "application/json" or not self.path.startswith("/frame/"):
            self._refuse(HTTPStatus.BAD_REQUEST, "only frames can be sent, as JSON")
            return
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > MAX_BODY_BYTES:
            self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"a frame has at most {MAX_BODY_BYTES} bytes")
            return
        body = self.rfile.read(int(length))
        self._answer(lambda: self.server.session.accept(self._number(), _mapping(body)))

    def _is_local(self) -> bool:
        """Refuse requests by another name of this machine, which a page of another site may have resolved."""
        host = (self.headers.get("Host") or "").rpartition(":")[0]
        if host in (LOOPBACK, "localhost"):
            return True
        self._refuse(HTTPStatus.FORBIDDEN, "the page is served to this machine only")
        return False

    def _number(self) -> int:
        text = self.path.rpartition("/")[2]
        if not text.isdecimal() or len(text) > 9:
            raise UsageError(f"there is no frame {text[:20]!r}")
        return int(text)

    def _answer(self, work) -> None:
        try:
            found = work()
        except UsageError as error:
            self._refuse(HTTPStatus.BAD_REQUEST, str(error))
            return
        if isinstance(found, bytes):
            self._send(HTTPStatus.OK, found, "image/png")
        else:
            self._send(HTTPStatus.OK, json.dumps(found).encode(), "application/json")

    def _refuse(self, status: HTTPStatus, sentence: str) -> None:
        self.close_connection = True  # what is left of the request is not read
        self._send(status, json.dumps({"error": sentence}).encode(), "application/json")

    def _send(self, status: HTTPStatus, content: bytes, kind: str) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format, *args):
        """Print nothing: the terminal shows the address and the summary."""


def _mapping(body: bytes) -> dict:
    try:
        content = json.loads(body)
    except ValueError as error:
        raise UsageError("the frame is not valid JSON") from error
    if not isinstance(content, dict):
        raise UsageError("the frame is not a mapping")
    return content
