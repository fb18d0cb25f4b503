"""A recorded flight: read from its bag message by message, so that a long one needs no more memory than a short one."""

import json
import time
from collections.abc import Callable
from pathlib import Path

import rerun as rr

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import full_name
from swift_ros.messages.race import from_race_status
from swift_ros.messages.stamps import message_stamp_ns
from swift_ros.race.judge import RACING
from swift_ros.race.result import REPORT
from swift_ros.recording import bags
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.view import layout
from swift_sim_bridge.view.flight import TRUTH, FlightRows, latency_rows, static_rows
from swift_sim_bridge.view.rows import Shape, Stream

PROGRESS_EVERY_S = 5.0  # s; period of the progress line
STATUS = full_name("race/status")


def show(bag: Path, recording: rr.RecordingStream, progress: Callable[[str], None] = print) -> None:
    """Write a flight to a recording of the viewer.

    Args:
        bag: folder or .mcap file.
        recording: of the viewer.
        progress: called with a line of text from time to time.

    Raises:
        UsageError: the bag cannot be read, or holds none of the topics that are shown.
    """
    stored, present = bags.custom_data(bag), bags.topics(bag)
    track, camera, vehicle = (
        bags.stored_record(bag, kind, name) if f"config/{name}" in stored else None
        for kind, name in ((Track, "track.yaml"), (Camera, "camera.yaml"), (Vehicle, "drone.yaml"))
    )
    flight = FlightRows(camera, track, full_name(TRUTH) in present)
    if not set(flight.topics) & set(present):
        wanted = ", ".join(list(flight.topics)[:4])
        raise UsageError(f"{bag} holds none of the topics {wanted}, ...; there is no flight to show")
    begin_ns = start_ns(bag)
    recording.send_blueprint(layout.flight(track, is_live=False))
    stream = Stream(recording)
    stream.add_static(static_rows(track, vehicle or configured_vehicle()))
    stream.add_static([Shape("about", rr.TextDocument(about(bag, track, vehicle), media_type="text/markdown"))])
    printed_s = time.monotonic()
    for name, message, log_ns in bags.read(bag, flight.topics):
        topic = flight.topics[name]
        stamp_ns = message_stamp_ns(message) or log_ns
        if begin_ns is None:
            begin_ns = stamp_ns
        time_s = 1e-9 * (stamp_ns - begin_ns)
        stream.add(time_s, [*flight.rows(topic, message), *latency_rows(topic, message, log_ns)])
        if time.monotonic() - printed_s > PROGRESS_EVERY_S:
            printed_s = time.monotonic()
            progress(f"  {time_s:.1f} s of the flight")
    stream.flush()


def start_ns(bag: Path) -> int | None:
    """Return the stamp of the start signal, which is time 0; None without a race."""
    events = (from_race_status(message) for _, message, _ in bags.read(bag, [STATUS]))
    return next((event.stamp_ns for event in events if event.state == RACING), None)


def configured_vehicle() -> Vehicle:
    """Return the vehicle of the configuration folder, for a bag that stores none."""
    return configuration.load(Vehicle, configuration.configuration_folder() / "drone.yaml")


def about(bag: Path, track: Track | None, vehicle: Vehicle | None) -> str:
    """Return in Markdown what a bag holds, and the result beside it."""
    lines = [f"# {bag}", ""]
    lines += [f"- track: {track.name}, {len(track.gates)} gates, {track.laps} laps"] if track else []
    lines += [f"- vehicle: {vehicle.name}"] if vehicle else []
    report = (bag if bag.is_dir() else bag.parent).parent / REPORT
    try:
        content = json.loads(report.read_text())
        lines += [f"- {key}: {value}" for key, value in content.items() if isinstance(value, str | int | float)]
    except (OSError, ValueError, AttributeError):
        pass  # a flight without the simulator has no report
    types = bags.topic_types(bag)
    return "\n".join([*lines, "", "| topic | type |", "|---|---|", *(f"| {t} | {types[t]} |" for t in sorted(types))])
