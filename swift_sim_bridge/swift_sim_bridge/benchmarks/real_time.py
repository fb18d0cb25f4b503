"""Latency and load of the onboard nodes in real time, on the system clock, while a recorded race is replayed.

Every onboard node runs. The camera node shows the recorded images from a folder at its own rate; odometry and service
calls are replayed in step with them. The flight controller is the simulated one at rest, which answers MSP as in a
race. As on hardware there is no renderer, no lockstep and no ground truth.
"""

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from swift_ros import configuration
from swift_ros.errors import UsageError
from swift_ros.graph.domain import RunDomain
from swift_ros.graph.runner import Runner, environment
from swift_ros.graph.topic_table import NODES, full_name
from swift_ros.messages.camera import from_image
from swift_ros.messages.race import from_race_status
from swift_ros.messages.stamps import from_time, header_stamp_ns
from swift_ros.race.judge import ARMED, RACING
from swift_ros.recording import bags
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.benchmarks.race_player import IMAGES, ODOMETRY, SERVICES, RacePlayer, TimedInput
from swift_sim_bridge.flight_controller.firmware import TICK_S, FlightController, Readings
from swift_sim_bridge.flight_controller.firmware_settings import FirmwareSettings
from swift_sim_bridge.flight_controller.msp_socket import MspSocket
from swift_sim_bridge.racing.race import telemetry_parameters

STATUS = "race/status"
ONBOARD = tuple(name for name, row in NODES.items() if row.onboard)
SERVICE_OF = {ARMED: SERVICES[0], RACING: SERVICES[1]}  # the service that led to a state
WARM_UP_S = 8.0  # loading of the networks, discovery, and the boot grace time of the flight controller
LISTEN_FIRST_S = 3.0  # the latency measurement starts so long before the race
DARK_IMAGES = 150  # black images before the recorded ones, 5 s at 30 Hz, for the nodes to discover each other
CLOCK_TICKS = os.sysconf("SC_CLK_TCK")


def timed_inputs(bag: Path) -> list[TimedInput]:
    """Return the inputs of a recorded race, in the order of time. Raises UsageError if a topic is missing."""
    for topic in (ODOMETRY, STATUS):
        bags.require(bag, full_name(topic))
    rows = [
        TimedInput(header_stamp_ns(raw.data), odometry=raw.data) for raw in bags.read_raw(bag, [full_name(ODOMETRY)])
    ]
    state_ns = {}
    for _, message, _ in bags.read(bag, [full_name(STATUS)]):
        event = from_race_status(message)
        state_ns.setdefault(event.state, event.stamp_ns)
    rows += [TimedInput(state_ns[state], service=service) for state, service in SERVICE_OF.items() if state in state_ns]
    return sorted(rows, key=lambda entry: entry.due_ns)


def unpack_images(bag: Path, folder: Path) -> dict[int, int]:
    """Write the images of a race as files for the camera node, after DARK_IMAGES black ones.

    Returns:
        The stamp of each image, ns, by the hash of its pixels.

    Raises:
        UsageError: the bag has no images.
    """
    bags.require(bag, full_name(IMAGES))
    taken_ns = {}
    for number, (_, message, _) in enumerate(bags.read(bag, [full_name(IMAGES)]), start=DARK_IMAGES):
        image = from_image(message)
        cv2.imwrite(str(folder / f"{number}.pgm"), image)
        taken_ns[hash(image.tobytes())] = from_time(message.header.stamp)
    for number in range(DARK_IMAGES):
        cv2.imwrite(str(folder / f"{number}.pgm"), np.zeros_like(image))
    return taken_ns


class StandingController:
    """A simulated flight controller of a vehicle at rest, with MSP on a TCP port, on the system clock."""

    def __init__(self, folder: Path):
        vehicle = configuration.load(Vehicle, folder / "drone.yaml")
        settings = configuration.load_section(FirmwareSettings, folder / "simulation.yaml", "flight_controller")
        still = np.zeros(len(vehicle.rotors))
        self._readings = Readings(
            q_world_body=np.array([0.0, 0.0, 0.0, 1.0]),
            omega_body=np.zeros(3),
            voltage=vehicle.battery.open_circuit_full,
            current=0.5,
            drawn=0.0,
            motor_command=still,
            rotor_speed=still,
        )
        self._controller = FlightController(settings, vehicle, self._readings)
        self._socket = MspSocket(self._controller, 0)
        self.name = self._socket.name
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        started_s = time.monotonic()
        while not self._ended.wait(TICK_S):
            with self._socket.lock:
                self._controller.update(round(1e9 * (time.monotonic() - started_s)), self._readings)

    def close(self) -> None:
        """End the thread and close the port."""
        self._ended.set()
        self._thread.join()
        self._socket.close()


@dataclass(frozen=True)
class Load:
    """Load of a process.

    Attributes:
        cpu_s: CPU time so far.
        resident_mb: memory now.
    """

    cpu_s: float
    resident_mb: float


def load(process_id: int) -> Load:
    """Return the load of a running process."""
    fields = Path(f"/proc/{process_id}/stat").read_text().rsplit(")", 1)[1].split()
    status = Path(f"/proc/{process_id}/status").read_text()
    return Load((int(fields[11]) + int(fields[12])) / CLOCK_TICKS, int(status.split("VmRSS:")[1].split()[0]) / 1024)


def measure(bag: Path, config: Path, out: Path, progress=print) -> dict:
    """Replay a recorded race to all onboard nodes and return their latency and load.

    Args:
        bag: of the race.
        config: configuration folder.
        out: folder of logs and latencies.
        progress: called with a line before the replay.

    Returns:
        {"latency_ms": {hop: {count, p50, p99, max}}, "cores": {node: ...}, "resident_mb": {node: ...}, "late_plays"}.

    Raises:
        UsageError: the bag lacks a topic, or a node refuses its input.
    """
    rows = timed_inputs(bag)
    run_domain = RunDomain()
    domain = run_domain.number
    controller = StandingController(config)
    with contextlib.ExitStack() as stack:
        stack.callback(controller.close)
        stack.callback(run_domain.close)
        images = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        taken_ns = unpack_images(bag, images)
        parameters = _parameters(config, out, images, controller.name)
        parameters["mavlink_telemetry"] = telemetry_parameters(domain)
        how = {"lockstep": False, "domain": domain}
        others = [name for name in ONBOARD if name != "camera"]
        nodes = stack.enter_context(Runner(others, out / "logs", parameters, **how))
        player = RacePlayer(domain)
        stack.callback(player.close)
        time.sleep(WARM_UP_S)
        length_s = 1e-9 * (rows[-1].due_ns - min(taken_ns.values()))
        listener = _listen(domain, length_s + 4 * LISTEN_FIRST_S, out)
        time.sleep(LISTEN_FIRST_S)
        progress(f"replaying {length_s:.0f} s of {bag} in real time")
        camera = stack.enter_context(Runner(["camera"], out / "logs", parameters, **how))
        shift_ns = player.synchronize(taken_ns, rows[0])
        rows = [entry for entry in rows if entry.due_ns + shift_ns > time.time_ns()]
        processes = {name: (camera if name == "camera" else nodes).process_id(name) for name in ONBOARD}
        before, begun_s = {name: load(number) for name, number in processes.items()}, time.monotonic()
        late = player.play(rows, shift_ns)
        for fault in nodes.faults() + camera.faults():
            raise UsageError(fault.sentence)
        after, seconds = {name: load(number) for name, number in processes.items()}, time.monotonic() - begun_s
        listener.wait(timeout=60)
    return {
        "latency_ms": json.loads((out / "latency" / "result.json").read_text())["latency_ms"],
        "cores": {name: (after[name].cpu_s - before[name].cpu_s) / seconds for name in ONBOARD},
        "resident_mb": {name: after[name].resident_mb for name in ONBOARD},
        "late_plays": late,
    }


def _parameters(config: Path, out: Path, images: Path, port: str) -> dict[str, dict]:
    """Return the ROS parameters, by node."""
    return {
        "*": {"config": str(config.resolve())},
        "betaflight": {"port": port},
        "camera": {"kind": "folder", "path": str(images), "repeat": False},
        "recorder": {"folder": str((out / "bag").resolve())},
    }


def _listen(domain: int, seconds: float, out: Path) -> subprocess.Popen:
    """Start `swiftros topics latency` in a process of its own."""
    words = ["topics", "latency", "--domain", str(domain), "--seconds", str(seconds), "--out", str(out / "latency")]
    return subprocess.Popen(
        [sys.executable, "-m", "swift_ros.cli", *words], stdout=subprocess.DEVNULL, env=environment(domain)
    )
