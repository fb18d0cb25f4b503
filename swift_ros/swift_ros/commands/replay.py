"""Run a recording through the perception nodes again, and compare with what was recorded and with ground truth."""

import json
import time
from pathlib import Path

from swift_ros.configuration import configuration_folder, load
from swift_ros.errors import UsageError

BAG, LOGS, PICTURE, RESULT = "bag", "logs", "replay.png", "result.json"
TELL_EVERY_S = 2.0


def command(subparsers) -> None:
    """Add the parser of `swiftros replay`."""
    parser = subparsers.add_parser("replay", help=__doc__, description=__doc__)
    parser.add_argument("bag", metavar="BAG", help="a bag folder, a folder with one bag below, or an .mcap file")
    parser.add_argument("--config", metavar="DIR", help="configuration folder (default: today's, not the recorded one)")
    parser.add_argument("--out", metavar="DIR", default="recordings/replay", help="(default: %(default)s)")
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Replay a bag. Returns 0, or 1 when the nodes did not come to its end. Raises UsageError on bad input."""
    from swift_ros.recording import bags, replay
    from swift_ros.recording.writer import identity
    from swift_ros.results import fresh_folder

    bag = replay.find_bag(Path(arguments.bag))
    config = configuration_folder(arguments.config)
    plan = replay.plan(replay.recorded_topics(bag), bag)
    check_images(bag, plan, config)
    out = Path(arguments.out)
    if out.resolve() in (bag.resolve(), *bag.resolve().parents):
        raise UsageError(f"--out {out} holds the recording itself; give another --out")
    fresh_folder(out, (BAG, LOGS, PICTURE, RESULT))
    print(f"configuration: {config}; running {', '.join(plan.nodes)}")
    for name, reason in plan.idle.items():
        print(f"{name} idles: {reason}")
    if bags.is_cut_off(bag):
        print(f"{bag} is cut off: it is played up to the cut")
    changed = replay.changed_since(bag, identity(config))
    if changed:
        print(f"not as it was recorded: {', '.join(changed)}")
    played = play(bag, plan, config, out)
    result = conclude(bag, plan, played, config, out)
    return 0 if result["replay"]["complete"] else 1


def check_images(bag: Path, plan, config: Path) -> None:
    """Raise UsageError when the recorded images are not what camera.yaml says."""
    from swift_ros import messages
    from swift_ros.camera.model import Camera
    from swift_ros.graph.topic_table import full_name
    from swift_ros.recording import bags
    from swift_ros.recording.replay import IMAGE

    if IMAGE not in plan.played:
        return
    camera = load(Camera, config / "camera.yaml")
    image = next((message for _, message, _ in bags.read(bag, [full_name(IMAGE)])), None)
    if image is None:
        return
    try:
        height, width = messages.from_image(image).shape
    except ValueError as error:
        raise UsageError(f"{bag}, {full_name(IMAGE)}: {error}") from error
    if (width, height) != (camera.width, camera.height):
        wanted = f"{camera.width} x {camera.height}"
        raise UsageError(f"{bag} holds images of {width} x {height}, {config / 'camera.yaml'} says {wanted}")


def play(bag: Path, plan, config: Path, out: Path) -> dict:
    """Play the bag to the nodes and write the new one. Returns what happened, as in `result.json`, "replay"."""
    from swift_ros import messages
    from swift_ros.camera.model import Camera
    from swift_ros.graph.runner import Runner, free_domain
    from swift_ros.nodes.replayer import Replayer, Stuck
    from swift_ros.recording import bags, replay
    from swift_ros.recording.bags import BagWriter
    from swift_ros.recording.flight_bags import IMPORTED, REJECTED
    from swift_ros.recording.writer import identity

    camera = load(Camera, config / "camera.yaml")

    def announce(stamp_ns: int) -> bytes:
        return messages.serialize(messages.to_camera_info(camera, stamp_ns))

    domain, reservation = free_domain()
    kept = {name: text for name, text in bags.custom_data(bag).items() if name in (IMPORTED, REJECTED)}
    writer = BagWriter(out / BAG, identity(config) | kept | {"replay of": str(bag)})
    nodes = Runner(plan.nodes, out / LOGS, replay.node_parameters(bag, config), lockstep=True, domain=domain)
    replayer = Replayer(plan, writer, domain, nodes.faults)
    fault, begun_s, progress = "", time.monotonic(), Progress()
    try:
        replayer.copies(replay.copied_topics(bag, plan))
        with nodes:
            replayer.await_graph()
            begun_s = time.monotonic()
            for item in replay.schedule(bag, plan, announce):
                replayer.play(item)
                progress.tell(item.at_ns)
            replayer.finish()
    except (Stuck, KeyboardInterrupt) as error:
        fault = str(error) or "interrupted"
        print(f"the replay ended early: {fault}")
    finally:
        replayer.close()
        writer.close()
        if reservation:
            reservation.close()
    wall_s = time.monotonic() - begun_s
    return {
        "complete": not fault,
        "fault": fault or None,
        "wall_s": wall_s,
        "speed": progress.flown_s / wall_s,
        "played": replayer.played,
        "answered": replayer.heard,
        "odometry_refused": replayer.refused,
    }


class Progress:
    """Tells how far a replay is. flown_s: of the recording's time."""

    def __init__(self):
        self._begin_ns, self._begun_s, self._told_s = None, 0.0, 0.0
        self.flown_s = 0.0

    def tell(self, at_ns: int) -> None:
        """Note that the recording has been played up to a stamp; say so once in a while."""
        now_s = time.monotonic()
        if self._begin_ns is None:
            self._begin_ns, self._begun_s, self._told_s = at_ns, now_s, now_s
        self.flown_s = 1e-9 * (at_ns - self._begin_ns)
        if now_s - self._told_s > TELL_EVERY_S:
            self._told_s = now_s
            speed = self.flown_s / (now_s - self._begun_s)
            print(f"  {self.flown_s:.1f} s played, {speed:.2f} x real time", flush=True)


def conclude(bag: Path, plan, played: dict, config: Path, out: Path) -> dict:
    """Compare, tell, and write `result.json` and the picture. Returns the whole result."""
    from swift_ros.recording import replay_picture
    from swift_ros.recording.comparison import compare, read_perception, table
    from swift_ros.track import Track

    recorded, replayed = read_perception(bag), read_perception(out / BAG)
    comparison = compare(recorded, replayed)
    print(table(comparison))
    counts = ", ".join(f"{count} {topic}" for topic, count in played["played"].items())
    print(f"played {counts} in {played['wall_s']:.1f} s, {played['speed']:.2f} x real time; new bag: {out / BAG}")
    if played["odometry_refused"]:
        print(f"{played['odometry_refused']} odometry messages were refused; see /diagnostics in the new bag")
    replay_picture.draw(recorded, replayed, load(Track, config / "track.yaml"), out / PICTURE)
    result = {"bag": str(bag), "nodes": list(plan.nodes), "idle": plan.idle, "replay": played, **comparison}
    (out / RESULT).write_text(json.dumps(result, indent=1) + "\n")
    return result
