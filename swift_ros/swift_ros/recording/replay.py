"""What a recording can be replayed through, and in which order its messages are played. Pure.

The nodes run in lockstep, as in the simulator: a message is played at its own stamp, whenever it was recorded.
"""

import heapq
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from swift_ros import messages
from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import NODES, TOPICS, full_name
from swift_ros.recording import bags

IMAGE, INFO, IMU = "camera/image_raw", "camera/camera_info", "imu/data_raw"
RAW, ODOMETRY = "vio/raw", "vio/odometry"
DETECTIONS, POSES, STATE = "gates/detections", "gates/poses", "state/odometry"
# At one stamp: first the word that there is an image, then what is waited for, then the image itself.
ORDER = (INFO, DETECTIONS, POSES, IMU, RAW, ODOMETRY, IMAGE)
CAMERA_TOPICS = (IMAGE, DETECTIONS, POSES)  # the first that was recorded is played
REPLAYED = ("vio", "gate_detector", "gate_pose", "state_estimator")


@dataclass(frozen=True)
class Plan:
    """nodes: rows of the table that run; played: topics that are played to them; announced: the topic whose every
    message stands for an image, None without any; idle: why the other nodes of perception do not run, by name."""

    nodes: tuple[str, ...]
    played: tuple[str, ...]
    announced: str | None
    idle: dict[str, str]

    @property
    def made(self) -> tuple[str, ...]:
        """The topics that the nodes make anew."""
        return tuple(topic for node in self.nodes for topic in NODES[node].publishes)


def plan(topics, where) -> Plan:
    """Return how to replay a recording with these topics of the table. Raises UsageError, naming the recording `where`,
    when no odometry is among them: without it nothing can run."""
    if ODOMETRY not in topics and RAW not in topics:
        there = ", ".join(sorted(topics)) or "no topic of the graph"
        raise UsageError(f"{where} has neither {full_name(ODOMETRY)} nor {full_name(RAW)}; it has {there}")
    idle = {}
    if ODOMETRY in topics:
        idle["vio"] = f"{ODOMETRY} is in the recording"
    seen = next((topic for topic in CAMERA_TOPICS if topic in topics), None)
    if seen != IMAGE:
        idle["gate_detector"] = f"no {IMAGE} in the recording"
    if seen not in (IMAGE, DETECTIONS):
        idle["gate_pose"] = f"no {IMAGE} and no {DETECTIONS} in the recording"
    nodes = tuple(name for name in REPLAYED if name not in idle)
    played = {RAW if "vio" in nodes else ODOMETRY, seen, INFO if seen else None, IMU if IMU in topics else None}
    return Plan(nodes, tuple(topic for topic in ORDER if topic in played), seen, idle)


@dataclass(frozen=True)
class Play:
    """One message of a recording: when it is played (ns), its topic (of the table, or full where the table lacks it),
    bytes, and whether it is played to the nodes or only copied into the new bag."""

    at_ns: int
    topic: str
    data: bytes
    to_nodes: bool


def recorded_topics(bag: Path) -> dict[str, str]:
    """Return the types of a bag's topics, by their name in the table, or in full where the table lacks them."""
    short = {full_name(topic): topic for topic in TOPICS}
    return {short.get(name, name): kind for name, kind in bags.topic_types(bag).items()}


def schedule(bag: Path, plan: Plan, announce: Callable[[int], bytes]) -> Iterator[Play]:
    """Yield the messages of a bag in the order of play: those for the nodes at their stamp, the others when recorded.

    announce: returns the camera_info that says that an image was taken at a stamp (ns); it goes before each of them, in
    the place of what was recorded, which may speak of images that were lost. What the nodes make anew is left out,
    images after the last odometry as well, and a message whose stamp runs backwards comes where it came in its topic.
    """
    odometry = RAW if RAW in plan.played else ODOMETRY
    end_ns = max((at_ns for at_ns, _, _ in _stream(bag, odometry, 0)), default=0)
    streams = [_stream(bag, topic, ORDER.index(topic)) for topic in plan.played if topic != INFO]
    if plan.announced:
        streams.append(_announcements(bag, plan.announced, announce))
    streams += [_stream(bag, topic, len(ORDER), to_nodes=False) for topic in copied_topics(bag, plan)]
    for at_ns, _, play in heapq.merge(*streams, key=lambda entry: entry[:2]):
        # an image waits for the odometry after it: after the last there is none
        if at_ns <= end_ns or play.topic not in (INFO, *CAMERA_TOPICS):
            yield play


def copied_topics(bag: Path, plan: Plan) -> dict[str, str]:
    """Return the types of the topics of a bag that are neither played to the nodes nor made anew by them."""
    other = {*plan.made, *plan.played, INFO, "/clock", "/diagnostics"}
    return {topic: kind for topic, kind in recorded_topics(bag).items() if topic not in other}


def _stream(bag: Path, topic: str, rank: int, to_nodes: bool = True):
    at_ns = 0
    for raw in bags.read_raw(bag, [full_name(topic)]):
        at_ns = max(at_ns, messages.header_stamp_ns(raw.data) if to_nodes else raw.log_time_ns)
        yield at_ns, rank, Play(at_ns, topic, raw.data, to_nodes)


def _announcements(bag: Path, topic: str, announce: Callable[[int], bytes]):
    for at_ns, _, play in _stream(bag, topic, ORDER.index(INFO)):
        yield at_ns, ORDER.index(INFO), Play(at_ns, INFO, announce(messages.header_stamp_ns(play.data)), True)


def node_parameters(bag: Path, config: Path) -> dict[str, dict]:
    """Return the ROS parameters of the nodes: the configuration folder, and what the recording itself asks for."""
    try:
        asked = json.loads(bags.custom_data(bag).get("parameters", "{}"))
    except ValueError as error:
        raise UsageError(f"{bag}: its custom data 'parameters' is not JSON; record or import it again") from error
    return {"*": {"config": str(config.resolve())}} | asked


def changed_since(bag: Path, now: dict[str, str]) -> list[str]:
    """Return what of the configuration and the models differs from the recording's, by name; now: `identity`."""
    then = bags.custom_data(bag)
    return sorted(name for name, text in now.items() if name in then and then[name] != text)


def find_bag(path: Path) -> Path:
    """Return the bag at a path: itself, or the only one below. Raises UsageError when there is none or a choice."""
    if not path.exists():
        raise UsageError(f"{path} does not exist; give a bag folder or an .mcap file")
    if path.is_file() or list(path.glob("*.mcap")):
        return path
    below = sorted({file.parent for file in path.rglob("*.mcap")})
    if len(below) > 1:
        raise UsageError(f"{path} holds {len(below)} bags; choose one, such as {below[0]}")
    if not below:
        raise UsageError(f"{path} holds no .mcap file; give a bag folder or an .mcap file")
    return below[0]
