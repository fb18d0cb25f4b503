"""Replay a recording through the perception nodes and compare the result with the recording and ground truth."""

import json
import time
from pathlib import Path

from swift_ros.camera.model import Camera
from swift_ros.configuration import configuration_folder, load
from swift_ros.errors import UsageError
from swift_ros.graph.domain import RunDomain
from swift_ros.graph.runner import Runner
from swift_ros.graph.topic_table import full_name
from swift_ros.results import fresh_folder
from swift_ros.track import Track

BAG, LOGS, PICTURE, RESULT = "bag", "logs", "replay.png", "result.json"
PROGRESS_EVERY_S = 2.0  # s; period of the progress line


def command(subparsers) -> None:
    """Add the parser of `swiftros replay`."""
    parser = subparsers.add_parser("replay", help=__doc__, description=__doc__)
    parser.add_argument("bag", metavar="BAG", help="a bag folder, a folder with one bag below, or an .mcap file")
    parser.add_argument(
        "--config", metavar="DIR", help="configuration folder (default: the current one, not the one stored in the bag)"
    )
    parser.add_argument("--out", metavar="DIR", default="recordings/replay", help="(default: %(default)s)")
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Replay a bag. Return 0, or 1 when the replay ended early. Raises UsageError on bad input."""
    from swift_ros.recording import replay  # imports ROS
    from swift_ros.recording.writer import provenance

    bag = replay.find_bag(Path(arguments.bag))
    config = configuration_folder(arguments.config)
    plan = replay.plan(replay.recorded_topics(bag), bag)
    check_images(bag, plan, config)
    out = Path(arguments.out)
    if out.resolve() in (bag.resolve(), *bag.resolve().parents):
        raise UsageError(f"--out {out} holds the recording itself; give another --out")
    RunDomain().close()  # one that is in use is refused before earlier results are removed
    fresh_folder(out, (BAG, LOGS, PICTURE, RESULT))
    print(f"configuration: {config}; running {', '.join(plan.nodes)}")
    for name, reason in plan.idle.items():
        print(f"{name} does not run: {reason}")
    changed = replay.changed_since(bag, provenance(config))
    if changed:
        print(f"changed since the recording: {', '.join(changed)}")
    played = play(bag, plan, config, out)
    result = conclude(bag, plan, played, config, out)
    return 0 if result["replay"]["complete"] else 1


def check_images(bag: Path, plan, config: Path) -> None:
    """Raise UsageError when the recorded images do not have the format of camera.yaml."""
    from swift_ros.messages.camera import from_image  # imports ROS
    from swift_ros.recording import bags
    from swift_ros.recording.replay import IMAGE

    if IMAGE not in plan.played:
        return
    camera = load(Camera, config / "camera.yaml")
    image = next((message for _, message, _ in bags.read(bag, [full_name(IMAGE)])), None)
    if image is None:
        return
    try:
        height, width = from_image(image).shape
    except ValueError as error:
        raise UsageError(f"{bag}, {full_name(IMAGE)}: {error}") from error
    if (width, height) != (camera.width, camera.height):
        wanted = f"{camera.width} x {camera.height}"
        raise UsageError(f"{bag} holds images of {width} x {height}, {config / 'camera.yaml'} says {wanted}")


def play(bag: Path, plan, config: Path, out: Path) -> dict:
    """Play a bag to the nodes and write the new bag. Return the entry "replay" of `result.json`."""
    from swift_ros.messages.camera import to_camera_info  # imports ROS
    from swift_ros.messages.serialization import serialize  # imports ROS
    from swift_ros.nodes.replay_publisher import ReplayPublisher, Stuck
    from swift_ros.recording import bags, replay
    from swift_ros.recording.bag_writer import BagWriter
    from swift_ros.recording.flight_bags import IMPORTED, REJECTED
    from swift_ros.recording.writer import provenance

    camera = load(Camera, config / "camera.yaml")

    def announce(stamp_ns: int) -> bytes:
        return serialize(to_camera_info(camera, stamp_ns))

    domain = RunDomain()
    kept = {name: text for name, text in bags.custom_data(bag).items() if name in (IMPORTED, REJECTED)}
    writer = BagWriter(out / BAG, provenance(config) | kept | {"replay of": str(bag)})
    nodes = Runner(plan.nodes, out / LOGS, replay.node_parameters(bag, config), lockstep=True, domain=domain.number)
    publisher = ReplayPublisher(plan, writer, domain.number, nodes.faults)
    fault, begun_s, progress = "", time.monotonic(), Progress()
    try:
        publisher.declare_copied(replay.copied_topics(bag, plan))
        with nodes:
            publisher.await_graph()
            begun_s = time.monotonic()
            for item in replay.schedule(bag, plan, announce):
                publisher.play(item)
                progress.update(item.at_ns)
            publisher.finish()
    except (Stuck, KeyboardInterrupt) as error:
        fault = str(error) or "interrupted"
        print(f"the replay ended early: {fault}")
    finally:
        publisher.close()
        writer.close()
        domain.close()
    wall_s = time.monotonic() - begun_s
    return {
        "complete": not fault,
        "fault": fault or None,
        "wall_s": wall_s,
        "speed": progress.flown_s / wall_s,
        "played": publisher.played,
        "answered": publisher.received,
        "odometry_refused": publisher.refused,
        "warnings": publisher.warnings,
    }


class Progress:
    """Prints the progress of a replay.

    Attributes:
        flown_s: time of the recording that has been played, s.
    """

    def __init__(self):
        self._begin_ns, self._begun_s, self._printed_s = None, 0.0, 0.0
        self.flown_s = 0.0

    def update(self, at_ns: int) -> None:
        """Record that messages up to a stamp (ns) have been played; print a progress line periodically."""
        now_s = time.monotonic()
        if self._begin_ns is None:
            self._begin_ns, self._begun_s, self._printed_s = at_ns, now_s, now_s
        self.flown_s = 1e-9 * (at_ns - self._begin_ns)
        if now_s - self._printed_s > PROGRESS_EVERY_S:
            self._printed_s = now_s
            speed = self.flown_s / (now_s - self._begun_s)
            print(f"  {self.flown_s:.1f} s played, {speed:.2f} x real time", flush=True)


def conclude(bag: Path, plan, played: dict, config: Path, out: Path) -> dict:
    """Compare both bags, print the comparison, write `result.json` and the figure. Return the content of the former."""
    from swift_ros.recording import replay_picture  # imports ROS and matplotlib
    from swift_ros.recording.comparison import compare, read_perception, table

    recorded, replayed = read_perception(bag), read_perception(out / BAG)
    comparison = compare(recorded, replayed)
    print(table(comparison))
    counts = ", ".join(f"{count} {topic}" for topic, count in played["played"].items())
    print(f"played {counts} in {played['wall_s']:.1f} s, {played['speed']:.2f} x real time; new bag: {out / BAG}")
    if played["odometry_refused"]:
        print(f"{played['odometry_refused']} odometry messages were refused; see /diagnostics in the new bag")
    for warning in played["warnings"]:
        print(warning)
    replay_picture.draw(recorded, replayed, load(Track, config / "track.yaml"), out / PICTURE)
    result = {"bag": str(bag), "nodes": list(plan.nodes), "idle": plan.idle, "replay": played, **comparison}
    (out / RESULT).write_text(json.dumps(result, indent=1) + "\n")
    return result
