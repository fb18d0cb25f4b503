"""What flies, on the system's clock: a recorded race played in step with it, latencies and load measured.

Camera, odometry and judge are played from the recording; the flight controller is the simulated one, standing still: it
answers MSP as in a race. Nothing renders and nothing waits, as on hardware.
"""

import contextlib
import json
import os
import struct
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rclpy

from swift_ros import bags, configuration, messages
from swift_ros.errors import UsageError
from swift_ros.graph import TOPICS, VEHICLE_NAMESPACE, full_name
from swift_ros.nodes.shell import quality
from swift_ros.runner import Runner, environment, free_domain
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller.firmware import TICK_S, FlightController, Readings
from swift_sim_bridge.flight_controller.msp_socket import MspSocket
from swift_sim_bridge.flight_controller.settings import FirmwareSettings

PLAYED = ("camera/camera_info", "camera/image_raw", "vio/odometry", "race/status", "race/judged")
ONBOARD = ("gate_detector", "gate_pose", "state_estimator", "policy", "betaflight", "recorder", "mavlink_telemetry")
WARM_UP_S = 8.0  # networks are loaded, discovery is done, the flight controller's boot grace is over
LISTEN_FIRST_S = 3.0
AS_HARDWARE = 30  # SCHED_FIFO priority
CLOCK_TICKS = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Cue:
    """A recorded message: when it is due (ns, recording's time), its topic, its bytes."""

    due_ns: int
    topic: str
    data: bytes


def cues(bag: Path) -> list[Cue]:
    """Return what is played of a race's bag, in time. Raises UsageError when a topic is missing."""
    for topic in PLAYED:
        bags.require(bag, full_name(topic))
    short = {full_name(topic): topic for topic in PLAYED}
    rows = [
        Cue(raw.log_time_ns if raw.topic == full_name("race/status") else messages.header_stamp_ns(raw.data),
            short[raw.topic], raw.data)
        for raw in bags.read_raw(bag, list(short))
    ]
    return sorted(rows, key=lambda cue: (cue.due_ns, PLAYED.index(cue.topic)))


def restamped(data: bytes, shift_ns: int) -> bytes:
    """Return a serialized message that begins with a stamp, with that stamp moved."""
    seconds, nanoseconds = divmod(messages.header_stamp_ns(data) + shift_ns, messages.NANOSECONDS)
    layout = "<iI" if data[1] & 1 else ">iI"
    return data[:4] + struct.pack(layout, seconds, nanoseconds) + data[12:]


class StandingController:
    """A simulated flight controller on a vehicle at rest, behind MSP on a TCP port, on the system's clock."""

    def __init__(self, folder: Path):
        vehicle = configuration.load(Vehicle, folder / "drone.yaml")
        settings = configuration.load_section(FirmwareSettings, folder / "simulation.yaml", "flight_controller")
        still = np.zeros(len(vehicle.rotors))
        self._readings = Readings(
            q_world_body=np.array([0.0, 0.0, 0.0, 1.0]), omega_body=np.zeros(3),
            voltage=vehicle.battery.open_circuit_full, current=0.5, drawn=0.0, motor_command=still, rotor_speed=still,
        )
        self._controller = FlightController(settings, vehicle, self._readings)
        self._socket = MspSocket(self._controller, 0)
        self.name = self._socket.name
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        begun_s = time.monotonic()
        while not self._ended.wait(TICK_S):
            with self._socket.lock:
                self._controller.update(round(1e9 * (time.monotonic() - begun_s)), self._readings)

    def close(self) -> None:
        """Stop answering."""
        self._ended.set()
        self._thread.join()
        self._socket.close()


def load(process_ids: list[int]) -> tuple[float, float]:
    """Return (CPU seconds so far, resident MB) of processes, together."""
    cpu_s, resident_mb = 0.0, 0.0
    for number in process_ids:
        fields = Path(f"/proc/{number}/stat").read_text().rsplit(")", 1)[1].split()
        cpu_s += (int(fields[11]) + int(fields[12])) / CLOCK_TICKS
        status = Path(f"/proc/{number}/status").read_text()
        resident_mb += int(status.split("VmRSS:")[1].split()[0]) / 1024
    return cpu_s, resident_mb


def measure(bag: Path, config: Path, out: Path, tell=print) -> dict:
    """Return {"latency_ms": {hop: {count, p50, p99, max}}, "cores", "resident_mb", "late_plays"} of the onboard nodes
    while a recorded race is played to them. Raises UsageError for a bag without a topic and a node's own refusal."""
    rows = cues(bag)
    length_s = 1e-9 * (rows[-1].due_ns - rows[0].due_ns)
    domain, reservation = free_domain()
    controller = StandingController(config)
    parameters = {
        "*": {"config": str(config.resolve())},
        "betaflight": {"port": controller.name},
        "recorder": {"folder": str((out / "bag").resolve())},
    }
    try:
        with Runner(ONBOARD, out / "logs", parameters, lockstep=False, domain=domain) as nodes:
            stage = _Stage(domain)
            time.sleep(WARM_UP_S)
            words = ["topics", "latency", "--domain", str(domain), "--seconds", str(length_s + LISTEN_FIRST_S)]
            listener = subprocess.Popen(
                [sys.executable, "-m", "swift_ros.cli", *words, "--out", str(out / "latency")],
                stdout=subprocess.DEVNULL, env=environment(domain),
            )
            time.sleep(LISTEN_FIRST_S)
            tell(f"playing {length_s:.0f} s of {bag} in real time")
            before, begun_s = load([nodes.process_id(name) for name in ONBOARD])[0], time.monotonic()
            late = stage.play(rows)
            faults = nodes.faults()
            if faults:
                raise UsageError(faults[0])
            after, resident_mb = load([nodes.process_id(name) for name in ONBOARD])
            cores = (after - before) / (time.monotonic() - begun_s)
            listener.wait(timeout=60)
            stage.close()
    finally:
        controller.close()
        if reservation:
            reservation.close()
    latency = json.loads((out / "latency" / "result.json").read_text())["latency_ms"]
    return {"latency_ms": latency, "cores": cores, "resident_mb": resident_mb, "late_plays": late}


class _Stage:
    """Publishes the cues."""

    LATE_S = 0.002

    def __init__(self, domain: int):
        self._context = rclpy.Context()
        self._context.init(domain_id=domain)
        self._node = rclpy.create_node("player", context=self._context, namespace=VEHICLE_NAMESPACE)
        self._voices = {
            topic: self._node.create_publisher(messages.message_type(TOPICS[topic].type), topic,
                                               quality(TOPICS[topic], False))
            for topic in PLAYED
        }

    def play(self, rows: list[Cue]) -> int:
        """Publish every cue when it is due; return how many went out late. Where it may, it goes before every node, as
        camera and tracker would: they do not share the computer's cores."""
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(AS_HARDWARE))
        shift_ns, late = time.time_ns() + 100_000_000 - rows[0].due_ns, 0
        for cue in rows:
            data = restamped(cue.data, shift_ns)
            wait_s = 1e-9 * (cue.due_ns + shift_ns - time.time_ns())
            if wait_s > 0:
                time.sleep(wait_s)
            late += wait_s < -self.LATE_S
            self._voices[cue.topic].publish(data)
        time.sleep(0.2)  # the last answers
        return late

    def close(self) -> None:
        self._node.destroy_node()
        self._context.try_shutdown()
