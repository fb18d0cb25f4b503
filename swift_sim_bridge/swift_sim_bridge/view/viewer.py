"""The viewer: a window, a page in the browser, or a file. Viewer and page are reachable from this machine alone.

The servers that Rerun's Python API starts listen on all interfaces, and that cannot be changed; those of its program
`rerun` take an address. So the program is started, and the recording is sent to it.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import quote

import rerun as rr
import rerun_cli

from swift_ros.errors import UsageError
from swift_sim_bridge.tcp_ports import LOOPBACK, free_port

APPLICATION = "swift"
PROGRAM = Path(rerun_cli.__file__).parent / "rerun"  # its Python wrapper would leave it running when it is ended
MEMORY = "2GiB"  # of the page's server; of a longer recording it forgets the beginning
# The stream is sent in batches: the viewer is slow with many small ones. `Stream.flush` sends what there is.
BATCH_S, BATCH_BYTES = 1.0, 2**22
START_S, POLL_S, END_S = 60.0, 0.1, 5.0  # s to wait for the viewer's port, between two looks, and for its end


class Viewer:
    """A running viewer.

    Attributes:
        url: to which a recording is sent.
        page: address of the page in the browser; None for a window.
    """

    def __init__(self, web: bool):
        """Start a viewer. Raises UsageError when it does not start."""
        if not web and sys.platform == "linux" and not {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ):
            raise UsageError("there is no display for the viewer's window; use --web, or --save FILE.rrd")
        port, web_port = free_port(), free_port()
        self.url = f"rerun+http://{LOOPBACK}:{port}/proxy"
        self.page = f"http://{LOOPBACK}:{web_port}/?url={quote(self.url, safe='')}" if web else None
        options = ["--bind", LOOPBACK, "--port", str(port), "--hide-welcome-screen", "--server-memory-limit", MEMORY]
        options += ["--serve-web", "--web-viewer-port", str(web_port)] if web else ["--expect-data-soon"]
        output = subprocess.DEVNULL if web else None
        self._process = subprocess.Popen([PROGRAM, *options], stdout=output, stderr=output)
        for one in (port, web_port) if web else (port,):
            self._wait_for(one)

    @property
    def has_ended(self) -> bool:
        """Whether the viewer was closed."""
        return self._process.poll() is not None

    def wait(self) -> None:
        """Return when the viewer is closed."""
        self._process.wait()

    def close(self) -> None:
        """End the viewer."""
        self._process.terminate()
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()

    def _wait_for(self, port: int) -> None:
        end_s = time.monotonic() + START_S
        while not _listens(port):
            if self.has_ended or time.monotonic() > end_s:
                self.close()
                raise UsageError("Rerun's viewer did not start; try `rerun`, or use --save FILE.rrd")
            time.sleep(POLL_S)


def _listens(port: int) -> bool:
    """Return whether a process listens on a TCP port; no connection is made, which the viewer would count."""
    listening = "0A"  # state in /proc/net/tcp
    rows = (line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:])
    return any(row[1].endswith(f":{port:04X}") and row[3] == listening for row in rows)


@contextmanager
def recording(name: str, viewer: Viewer | None, file: Path | None) -> Iterator[rr.RecordingStream]:
    """Yield a recording that is sent to a viewer, written to a file, or both.

    Args:
        name: of the recording, for a reader.
        viewer: None for none.
        file: .rrd file; None for none.

    Raises:
        UsageError: the file cannot be written.
    """
    stream = rr.RecordingStream(APPLICATION, batcher_config=rr.ChunkBatcherConfig(BATCH_S, BATCH_BYTES))
    sinks = [rr.GrpcSink(viewer.url)] if viewer else []
    if file is not None:
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(b"")
        except OSError as error:
            raise UsageError(f"--save {file} cannot be written: {error.strerror}") from error
        sinks.append(rr.FileSink(file))
    stream.set_sinks(*sinks)
    stream.send_recording_name(name)
    try:
        yield stream
    finally:
        stream.flush()
        stream.disconnect()
