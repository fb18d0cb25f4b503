"""Render the video of a race or flight from its bag: a chase view, the onboard image, speed, thrust, battery, error."""

import json
import time
from pathlib import Path

from swift_ros.errors import UsageError
from swift_ros.race.result import REPORT

PROGRESS_EVERY_S = 5.0  # s; period of the progress line
LIMITS = {"fps": (1.0, 120.0), "slow": (0.1, 100.0), "height": (90, 2160)}


def command(subparsers) -> None:
    """Add the parser of `swiftros video`."""
    parser = subparsers.add_parser("video", help=__doc__, description=__doc__)
    parser.add_argument("race", metavar="RACE", help="a bag, an .mcap file, or a folder with one bag below")
    parser.add_argument("--out", metavar="FILE", default="recordings/video.mp4", help="(default: %(default)s)")
    parser.add_argument("--fps", type=float, default=30.0, help="frames a second (default: %(default)g)")
    parser.add_argument(
        "--slow", type=float, default=1.0, metavar="FACTOR", help="slow motion: 4 takes four times as long"
    )
    parser.add_argument("--from", dest="first", type=float, metavar="S", help="first time, s since the start signal")
    parser.add_argument("--to", dest="last", type=float, metavar="S", help="last time, s since the start signal")
    parser.add_argument("--height", type=int, default=720, metavar="PX", help="of a frame, 16:9 (default: %(default)s)")
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Render a video. Return 0. Raises UsageError on bad input."""
    check(arguments)
    from swift_ros.recording.replay import find_bag  # imports ROS
    from swift_sim_bridge.video import film, mp4  # imports JAX
    from swift_sim_bridge.video.flight import read

    bag, out = find_bag(Path(arguments.race)), Path(arguments.out)
    flight = read(bag)
    cut = film.Cut(
        arguments.height - arguments.height % 2, arguments.fps, arguments.slow, arguments.first, arguments.last
    )
    times = film.frame_times(flight, cut)
    if not len(times):
        first, last = flight.path.t[[0, -1]]
        raise UsageError(f"{bag} has poses from {first:.2f} to {last:.2f} s; choose --from and --to between them")
    for note in flight.notes:
        print(note)
    if flight.end is not None:
        print(f"{flight.end.state} after {flight.seconds(flight.end.stamp_ns):.2f} s: {flight.end.text}")
    frames = film.Film(flight, seed_of(bag), cut).frames(times)
    mp4.write(out, cut.size, cut.fps, with_progress(frames, len(times), cut.fps))
    size = f"{len(times)} frames of {cut.size[0]} x {cut.size[1]}, {out.stat().st_size / 1e6:.1f} MB"
    print(f"{out}: {len(times) / cut.fps:.1f} s, {size}")
    return 0


def check(arguments) -> None:
    """Raise UsageError for options out of range."""
    for name, (low, high) in LIMITS.items():
        value = getattr(arguments, name)
        if not low <= value <= high:
            raise UsageError(f"--{name} {value:g} is not between {low:g} and {high:g}")
    if Path(arguments.out).suffix != ".mp4":
        raise UsageError(f"--out {arguments.out} does not end with .mp4; the video is an MP4 file")


def seed_of(bag: Path) -> int:
    """Return the seed of the race of a bag, which draws the surfaces of its hall; 0 where none is stored."""
    path = (bag if bag.is_dir() else bag.parent).parent / REPORT
    try:
        seed = json.loads(path.read_text())["seed"]
    except (OSError, ValueError, KeyError, TypeError):
        return 0
    return seed if isinstance(seed, int) and seed >= 0 else 0


def with_progress(frames, count: int, fps: float):
    """Yield frames; print how much of the video is done, periodically."""
    begun_s = printed_s = time.monotonic()
    for number, frame in enumerate(frames, start=1):
        yield frame
        now_s = time.monotonic()
        if now_s - printed_s > PROGRESS_EVERY_S:
            printed_s, left_s = now_s, (now_s - begun_s) / number * (count - number)
            print(f"  {number / fps:.1f} of {count / fps:.1f} s, about {left_s:.0f} s left", flush=True)
