"""Quality of service of the topics of the graph's table."""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from swift_ros.graph.topic_table import Topic

IMAGE_DEPTH = 1  # messages; in real time only the newest image is of use
LATCHED_DEPTH = 1  # messages; the last one is the present state
DEPTH = 10  # messages; 0.1 s of a topic of 100 Hz
DEEP = 1000  # messages; where none may be lost: 10 s of a topic of 100 Hz


def publisher_profile(topic: Topic, lockstep: bool) -> QoSProfile:
    """Return the QoS with which a topic of the table is published.

    It is that of the subscribers, but a latched topic has depth 1: a late subscriber receives the last message alone.
    """
    profile = qos_profile(topic, lockstep)
    if topic.latched:
        profile.depth = LATCHED_DEPTH
    return profile


def qos_profile(topic: Topic, lockstep: bool) -> QoSProfile:
    """Return the QoS of a topic of the table.

    In real time images are best effort and everything else is reliable. In lockstep every topic is reliable with a
    deep queue, so that no message is lost. There every topic except images is also transient local: a subscriber that
    discovers its publisher late still receives the earlier messages. For images the simulator waits until all their
    subscribers are discovered.
    """
    best_effort = topic.image and not lockstep
    transient_local = topic.latched or (lockstep and not topic.image)
    depth = DEEP if lockstep else IMAGE_DEPTH if topic.image else DEPTH
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if transient_local else DurabilityPolicy.VOLATILE,
    )
