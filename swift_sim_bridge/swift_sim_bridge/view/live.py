"""The running graph. The view is a node that no flight needs: all its subscriptions are best effort, nothing waits for
it, and a view that is too slow loses messages.
"""

import time
from collections.abc import Callable
from pathlib import Path

import rerun as rr

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import TOPICS, full_name
from swift_ros.messages.serialization import deserialize
from swift_ros.messages.stamps import message_stamp_ns
from swift_ros.nodes.domain_listener import DomainListener
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.view import layout
from swift_sim_bridge.view.flight import TRUTH, FlightRows, latency_rows, static_rows
from swift_sim_bridge.view.rows import Stream

FLUSH_S = 0.1  # s between two flushes of the curves: the eye sees no more


def show(
    domain: int, folder: Path, recording: rr.RecordingStream, seconds: float, until: Callable[[], bool]
) -> dict[str, int]:
    """Write the messages of a running graph to a recording of the viewer as they come.

    Args:
        domain: ROS domain.
        folder: configuration with camera.yaml and drone.yaml; the gates come from the graph.
        recording: of the viewer.
        seconds: s, longest time; may be infinite.
        until: ends the view before.

    Returns:
        The number of received messages of each topic.

    Raises:
        UsageError: no topic of the graph has a publisher.
    """
    camera = configuration.load(Camera, folder / "camera.yaml")
    vehicle = configuration.load(Vehicle, folder / "drone.yaml")
    with DomainListener(domain) as listener:
        live = listener.published_topics()
        flight = FlightRows(camera, None, full_name(TRUTH) in live)
        if not set(flight.topics) & set(live):
            raise UsageError(
                f"no graph is running in ROS domain {domain}; start one, choose another --domain, or give a PATH"
            )
        recording.send_blueprint(layout.flight(None, is_live=True))
        stream = Stream(recording)
        stream.add_static(static_rows(None, vehicle))
        received = dict.fromkeys(flight.topics.values(), 0)
        begin_ns: list[int] = []

        def subscribe(name: str, topic: str) -> None:
            def on_data(data, info) -> None:
                message = deserialize(data, TOPICS[topic].type)
                stamp_ns = message_stamp_ns(message)
                if not begin_ns and stamp_ns and not TOPICS[topic].latched:  # a latched message may be old
                    begin_ns.append(stamp_ns)
                rows = [*flight.rows(topic, message), *latency_rows(topic, message, info["source_timestamp"])]
                stream.add(1e-9 * max(stamp_ns - begin_ns[0], 0) if begin_ns else 0.0, rows)
                received[topic] += 1

            listener.subscribe(name, TOPICS[topic].type, on_data)

        for name, topic in flight.topics.items():
            subscribe(name, topic)
        end_s = time.monotonic() + seconds
        try:
            while (left_s := end_s - time.monotonic()) > 0 and not until():
                listener.spin(min(FLUSH_S, left_s))
                stream.flush()
        finally:
            stream.flush()
    return received
