"""MP4 files with H.264, which browsers play. ffmpeg encodes, as a program of its own."""

import contextlib
import subprocess
from collections.abc import Iterable
from pathlib import Path

import imageio_ffmpeg

from swift_ros.errors import UsageError
from swift_ros.text import excerpt

# faststart: a browser begins to play while the file loads
OPTIONS = (
    "-c:v",
    "libx264",
    "-pix_fmt",
    "yuv420p",
    "-crf",
    "21",
    "-preset",
    "veryfast",
    "-tune",
    "animation",
    "-movflags",
    "+faststart",
)


def write(path: Path, size: tuple[int, int], fps: float, frames: Iterable) -> None:
    """Write frames to a file.

    Args:
        path: of the file, .mp4.
        size: width and height of a frame, px; both even.
        fps: frames a second.
        frames: (H, W, 3) BGR uint8.

    Raises:
        UsageError: the file cannot be written.
    """
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "bgr24"]
    command += ["-s", f"{size[0]}x{size[1]}", "-r", f"{fps:g}", "-i", "-", *OPTIONS, str(path)]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.open("wb").close()  # refused here, in a sentence of its own, if it cannot be written
    except OSError as error:
        raise UsageError(f"--out {path} cannot be written: {error.strerror}") from error
    # a session of its own: Ctrl-C must not end it before the frames that are done are complete
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True) as encoder:
        try:
            for frame in frames:
                encoder.stdin.write(frame.tobytes())
        except BrokenPipeError:
            pass  # ffmpeg has ended, and says why
        finally:
            with contextlib.suppress(BrokenPipeError):
                encoder.stdin.close()
            fault = encoder.stderr.read().decode(errors="replace").strip()
    if encoder.returncode:
        raise UsageError(f"{path} is incomplete: ffmpeg ended with '{excerpt(fault)}'")
