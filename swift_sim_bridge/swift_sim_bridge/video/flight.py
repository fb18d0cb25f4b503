"""What a video shows of a recorded flight.

Times are s since the start signal, or since the first pose without a race.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from swift_ros import configuration, geometry
from swift_ros.camera.model import Camera
from swift_ros.errors import UsageError
from swift_ros.files import yaml_text
from swift_ros.graph.topic_table import full_name
from swift_ros.messages.camera import from_image
from swift_ros.messages.gates import from_detections, incomplete_from_detections
from swift_ros.messages.stamps import from_time
from swift_ros.race.judge import ENDS, RaceEvent
from swift_ros.race.result import CUT_SHORT, RaceRecord, judge_again
from swift_ros.recording import bags
from swift_ros.recording.flight_table import Samples
from swift_ros.recording.race_bag import read_flight
from swift_ros.track import Track
from swift_ros.types import GateCorners, Odometry
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.rendering.scene import Looks

TRUTH, STATE, VIO = "ground_truth/odometry", "state/odometry", "vio/odometry"
IMAGE, DETECTIONS = full_name("camera/image_raw"), full_name("gates/detections")
GAP_S = 0.2  # s without a pose that a viewer would see as a jump; poses are recorded at 100 Hz
MIN_POSES = 2


@dataclass(frozen=True)
class Path3:
    """A flown path.

    Attributes:
        t: (n,) s, increasing.
        p_world: (n, 3) m.
        q_world_body: (n, 4), without changes of sign between neighbours.
        v_world: (n, 3) m/s.
    """

    t: np.ndarray
    p_world: np.ndarray
    q_world_body: np.ndarray
    v_world: np.ndarray

    def at(self, times) -> "Path3":
        """Return the path at other times (m,), linear between its poses and constant beyond them."""
        p, q, v = (_interpolated(times, self.t, rows) for rows in (self.p_world, self.q_world_body, self.v_world))
        return Path3(np.asarray(times), p, geometry.normalize(q), v)


@dataclass(frozen=True)
class Flight:
    """A recorded flight.

    Attributes:
        bag: where it is recorded.
        begin_ns: stamp of time 0.
        source: topic of the poses.
        path: of the vehicle.
        estimate: path of the state estimate; None without one.
        error: m, distance from the estimate to the ground truth; None if either is missing.
        thrust: commanded, m/s^2.
        voltage: of the battery, V.
        events: passages and end of the race.
        detections: whole and incomplete gates, by the stamp of their image, ns.
        camera: None where the bag does not store it.
        track: None where the bag does not store it.
        vehicle: as stored, else the one of the configuration folder.
        cells: of its battery in series; 0 where they are not known.
        looks: of the hall.
        notes: sentences on what is missing.
    """

    bag: Path
    begin_ns: int
    source: str
    path: Path3
    estimate: Path3 | None
    error: Samples | None
    thrust: Samples
    voltage: Samples
    events: list[RaceEvent]
    detections: dict[int, list[GateCorners]]
    camera: Camera | None
    track: Track | None
    vehicle: Vehicle
    cells: int
    looks: Looks
    notes: list[str]

    def seconds(self, stamp_ns: int) -> float:
        """Return the time of a stamp, s."""
        return 1e-9 * (stamp_ns - self.begin_ns)

    @property
    def passages(self) -> list[RaceEvent]:
        """The passages of gates."""
        return [event for event in self.events if event.is_passage]

    @property
    def end(self) -> RaceEvent | None:
        """The end of the race; None without one."""
        return self.events[-1] if self.events and self.events[-1].state in ENDS else None

    def images(self) -> Iterator[tuple[int, np.ndarray]]:
        """Yield stamp (ns) and grey levels (H, W) of the recorded images that can be read."""
        for _, message, _ in bags.read(self.bag, [IMAGE]):
            try:
                yield from_time(message.header.stamp), from_image(message)
            except ValueError:  # of another encoding, or incomplete: the last one stays
                continue


def read(bag: Path) -> Flight:
    """Return the flight in a bag. Raises UsageError when it holds no poses."""
    record, stored = read_flight(bag), bags.custom_data(bag)
    source = next((topic for topic in (TRUTH, STATE, VIO) if len(record.odometry[topic]) >= MIN_POSES), None)
    if source is None:
        wanted = ", ".join(full_name(topic) for topic in (TRUTH, STATE, VIO))
        raise UsageError(f"{bag} has fewer than {MIN_POSES} poses on each of {wanted}; there is no flight to show")
    poses = _sound(record.odometry[source])
    begin_ns = poses[0].stamp_ns if record.start_ns is None else record.start_ns
    track, camera = (
        bags.stored_record(bag, kind, name) if f"config/{name}" in stored else None
        for kind, name in ((Track, "track.yaml"), (Camera, "camera.yaml"))
    )
    vehicle, looks = _vehicle(bag, stored), _looks(bag, stored)
    path = _path(poses, begin_ns)
    estimates = _sound(record.odometry[STATE])
    estimate = _path(estimates, begin_ns) if len(estimates) >= MIN_POSES else None
    events = judge_again(record, track, vehicle) if track else []
    return Flight(
        bag=bag,
        begin_ns=begin_ns,
        source=source,
        path=path,
        estimate=estimate,
        error=_error(path, estimate) if source == TRUTH and estimate else None,
        thrust=_samples(((command.stamp_ns, command.thrust) for command in record.commands), begin_ns),
        voltage=_samples(record.voltages, begin_ns),
        events=events,
        detections=_detections(bag),
        camera=camera,
        track=track,
        vehicle=vehicle,
        cells=vehicle.battery.cells if "config/drone.yaml" in stored else 0,
        looks=looks,
        notes=_notes(bag, record, path, source, events) + _vehicle_notes(stored),
    )


def _sound(states: list[Odometry]) -> list[Odometry]:
    """Return the states that are finite, in the order of increasing stamps."""
    finite = [s for s in states if all(np.isfinite(v).all() for v in (s.p_world, s.q_world_body, s.v_body))]
    by_stamp = {state.stamp_ns: state for state in finite}
    return [by_stamp[stamp] for stamp in sorted(by_stamp)]


def _path(states: list[Odometry], begin_ns: int) -> Path3:
    q = np.array([state.q_world_body for state in states])
    turned = np.cumprod(np.where(np.sum(q[1:] * q[:-1], axis=1) < 0, -1.0, 1.0))
    q[1:] *= turned[:, None]
    v = geometry.rotate(q, np.array([state.v_body for state in states]))
    t = np.array([1e-9 * (state.stamp_ns - begin_ns) for state in states])
    return Path3(t, np.array([state.p_world for state in states]), q, v)


def _interpolated(times, t, rows):
    return np.stack([np.interp(times, t, column) for column in rows.T], axis=-1)


def _samples(rows, begin_ns: int) -> Samples:
    """Return (stamp_ns, value) rows, without those that are not finite."""
    found = [(1e-9 * (stamp_ns - begin_ns), value) for stamp_ns, value in rows if np.isfinite(value)]
    t, values = np.array(sorted(found), dtype=float).reshape(-1, 2).T
    return Samples(t, values)


def _error(truth: Path3, estimate: Path3) -> Samples | None:
    inside = (estimate.t >= truth.t[0]) & (estimate.t <= truth.t[-1])
    t = estimate.t[inside]
    return Samples(t, np.linalg.norm(estimate.p_world[inside] - truth.at(t).p_world, axis=1)) if len(t) else None


def _detections(bag: Path) -> dict[int, list[GateCorners]]:
    return {
        from_time(message.header.stamp): [
            *from_detections(message),
            *incomplete_from_detections(message),
        ]
        for _, message, _ in bags.read(bag, [DETECTIONS])
    }


def _vehicle(bag: Path, stored: dict[str, str]) -> Vehicle:
    if "config/drone.yaml" in stored:
        return bags.stored_record(bag, Vehicle, "drone.yaml")
    return configuration.load(Vehicle, configuration.configuration_folder() / "drone.yaml")


def _looks(bag: Path, stored: dict[str, str]) -> Looks:
    """Return the looks of the simulated hall; of a flight elsewhere, those of the configuration folder."""
    text, where = stored.get("config/simulation.yaml"), f"{bag}, config/simulation.yaml"
    if text is None:
        path = configuration.configuration_folder() / "simulation.yaml"
        return configuration.load_section(Looks, path, "renderer")
    content = yaml_text.parse_yaml(text, f"{where} is damaged: it", "use another recording")
    return configuration.build(Looks, content["renderer"], where)


def _vehicle_notes(stored: dict[str, str]) -> list[str]:
    return [] if "config/drone.yaml" in stored else ["no vehicle file: the vehicle of the configuration is drawn"]


def _notes(bag: Path, record: RaceRecord, path: Path3, source: str, events: list[RaceEvent]) -> list[str]:
    notes = []
    if source != TRUTH:
        notes.append(f"no ground truth: the vehicle is shown where {source} places it")
    if IMAGE not in bags.topics(bag):
        notes.append("no images: the video has no onboard view")
    if record.start_ns is None:
        notes.append("no race: the video shows the whole recording")
    elif not (events and events[-1].state in ENDS):
        notes.append(CUT_SHORT)
    for i in np.flatnonzero(np.diff(path.t) > GAP_S):
        notes.append(f"no pose from {path.t[i]:.2f} to {path.t[i + 1]:.2f} s: the path between is a straight line")
    return notes
