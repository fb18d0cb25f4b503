"""Plan of a replay: which nodes run, which topics are played, and in which order.

The nodes run in lockstep, as in the simulator: a message is played at its header stamp, not at its time of recording.
"""

import heapq
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import NODES, TOPICS, full_name
from swift_ros.messages.stamps import header_stamp_ns
from swift_ros.recording import bags

IMAGE, INFO, IMU = "camera/image_raw", "camera/camera_info", "imu/data_raw"
RAW, ODOMETRY = "vio/raw", "vio/odometry"
DETECTIONS, POSES, STATE = "gates/detections", "gates/poses", "state/odometry"
# Order at equal stamps: first the announcement of an image, then the messages that nodes wait for, then the image.
ORDER = (INFO, DETECTIONS, POSES, IMU, RAW, ODOMETRY, IMAGE)
CAMERA_TOPICS = (IMAGE, DETECTIONS, POSES)  # only the first of these in the recording is played
REPLAYED = ("vio", "gate_detector", "gate_pose", "state_estimator")


@dataclass(frozen=True)
class Plan:
    """Nodes and topics of a replay.

    Attributes:
        nodes: names of the nodes that run.
        played: topics that are played to them.
        announced: topic with one message for each image, None without images.
        idle: reasons why the other nodes of perception do not run, by name.
    """

    nodes: tuple[str, ...]
    played: tuple[str, ...]
    announced: str | None
    idle: dict[str, str]

    @property
    def recomputed(self) -> tuple[str, ...]:
        """Topics that the running nodes publish."""
        return tuple(topic for node in self.nodes for topic in NODES[node].publishes)


def plan(topics, where) -> Plan:
    """Return the plan for a recording with these topics.

    Args:
        topics: topics of the recording, by their names in the table.
        where: name of the recording, for errors.

    Raises:
        UsageError: the recording has no odometry, which every node needs.
    """
    if ODOMETRY not in topics and RAW not in topics:
        available = ", ".join(sorted(topics)) or "no topic of the graph"
        raise UsageError(f"{where} has neither {full_name(ODOMETRY)} nor {full_name(RAW)}; it has {available}")
    idle = {}
    if ODOMETRY in topics:
        idle["vio"] = f"{ODOMETRY} is in the recording"
    observed = next((topic for topic in CAMERA_TOPICS if topic in topics), None)
    if observed != IMAGE:
        idle["gate_detector"] = f"no {IMAGE} in the recording"
    if observed not in (IMAGE, DETECTIONS):
        idle["gate_pose"] = f"no {IMAGE} and no {DETECTIONS} in the recording"
    nodes = tuple(name for name in REPLAYED if name not in idle)
    played = {RAW if "vio" in nodes else ODOMETRY, observed, INFO if observed else None, IMU if IMU in topics else None}
    return Plan(nodes, tuple(topic for topic in ORDER if topic in played), observed, idle)


@dataclass(frozen=True)
class Play:
    """One message of a replay.

    Attributes:
        at_ns: simulated time at which it is played, ns.
        topic: name in the table, or full name of a topic outside it.
        data: CDR bytes.
        to_nodes: published to the nodes; otherwise only copied into the new bag.
    """

    at_ns: int
    topic: str
    data: bytes
    to_nodes: bool


def recorded_topics(bag: Path) -> dict[str, str]:
    """Return the types of a bag's topics, by their name in the table or by full name of a topic outside it."""
    short = {full_name(topic): topic for topic in TOPICS}
    return {short.get(name, name): kind for name, kind in bags.topic_types(bag).items()}


def schedule(bag: Path, plan: Plan, announce: Callable[[int], bytes]) -> Iterator[Play]:
    """Yield the messages of a bag in the order of play: those for the nodes by stamp, the others by log time.

    Topics that the nodes recompute are omitted, and so are images after the last odometry. A message with a stamp
    before its predecessor's stays at its place in its topic.

    Args:
        bag: the recording.
        plan: of the replay.
        announce: returns the camera_info (CDR bytes) of an image with a stamp (ns). One is played before each image;
            the recorded camera_info is not used, because it may announce images that were not recorded.
    """
    odometry = RAW if RAW in plan.played else ODOMETRY
    end_ns = max((at_ns for at_ns, _, _ in _stream(bag, odometry, 0)), default=0)
    streams = [_stream(bag, topic, ORDER.index(topic)) for topic in plan.played if topic != INFO]
    if plan.announced:
        streams.append(_announcements(bag, plan.announced, announce))
    streams += [_stream(bag, topic, len(ORDER), to_nodes=False) for topic in copied_topics(bag, plan)]
    for at_ns, _, play in heapq.merge(*streams, key=lambda entry: entry[:2]):
        # an image waits for later odometry, and after the last there is none
        if at_ns <= end_ns or play.topic not in (INFO, *CAMERA_TOPICS):
            yield play


def copied_topics(bag: Path, plan: Plan) -> dict[str, str]:
    """Return the types of a bag's topics that are neither played to the nodes nor recomputed by them."""
    other = {*plan.recomputed, *plan.played, INFO, "/clock", "/diagnostics"}
    return {topic: kind for topic, kind in recorded_topics(bag).items() if topic not in other}


def _stream(bag: Path, topic: str, rank: int, to_nodes: bool = True):
    at_ns = 0
    for raw in bags.read_raw(bag, [full_name(topic)]):
        at_ns = max(at_ns, header_stamp_ns(raw.data) if to_nodes else raw.log_time_ns)
        yield at_ns, rank, Play(at_ns, topic, raw.data, to_nodes)


def _announcements(bag: Path, topic: str, announce: Callable[[int], bytes]):
    for at_ns, _, play in _stream(bag, topic, ORDER.index(INFO)):
        yield at_ns, ORDER.index(INFO), Play(at_ns, INFO, announce(header_stamp_ns(play.data)), True)


def node_parameters(bag: Path, config: Path) -> dict[str, dict]:
    """Return the ROS parameters of the nodes: the configuration folder, and those stored in the recording."""
    stored = bags.stored_json(bag, "parameters", {})
    return {"*": {"config": str(config.resolve())}} | stored


def changed_since(bag: Path, now: dict[str, str]) -> list[str]:
    """Return the names of configuration files and models that differ from the recording's.

    Args:
        bag: the recording.
        now: current provenance, see `recording.writer.provenance`.
    """
    recorded = bags.custom_data(bag)
    return sorted(name for name, text in now.items() if name in recorded and recorded[name] != text)


def find_bag(path: Path) -> Path:
    """Return the bag at a path or the only bag below it. Raises UsageError when there is none or more than one."""
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
