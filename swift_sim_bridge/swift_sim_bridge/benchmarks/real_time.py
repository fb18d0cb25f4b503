"""What flies, on the system's clock: a recorded race played in step with it, latencies and load measured.

Every onboard node runs. The camera shows the recorded images from a folder, at its own rate; odometry and the calls of
the race's director come in step with them; the flight controller is the simulated one, standing still: it answers MSP
as in a race. Nothing renders, nothing waits and nobody knows the truth, as on hardware.
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

from swift_ros import configuration, messages
from swift_ros.errors import UsageError
from swift_ros.graph.runner import Runner, environment, free_domain
from swift_ros.graph.topic_table import NODES, full_name
from swift_ros.race.judge import ARMED, RACING
from swift_ros.recording import bags
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.benchmarks.stage import IMAGES, ODOMETRY, SERVICES, Cue, Stage
from swift_sim_bridge.flight_controller.firmware import TICK_S, FlightController, Readings
from swift_sim_bridge.flight_controller.msp_socket import MspSocket
from swift_sim_bridge.flight_controller.firmware_settings import FirmwareSettings

STATUS = "race/status"
ONBOARD = tuple(name for name, row in NODES.items() if row.onboard)
SERVICE_OF = {ARMED: SERVICES[0], RACING: SERVICES[1]}  # what the race's director called, by what came of it
WARM_UP_S = 8.0  # networks are loaded, discovery is done, the flight controller's boot grace is over
LISTEN_FIRST_S = 3.0
DARK_IMAGES = 150
CLOCK_TICKS = os.sysconf("SC_CLK_TCK")


def cues(bag: Path) -> list[Cue]:
    """Return what is played to the graph of a race's bag, in time. Raises UsageError when a topic is missing."""
    for topic in (ODOMETRY, STATUS):
        bags.require(bag, full_name(topic))
    rows = [
        Cue(messages.header_stamp_ns(raw.data), odometry=raw.data) for raw in bags.read_raw(bag, [full_name(ODOMETRY)])
    ]
    asked = {}
    for _, message, _ in bags.read(bag, [full_name(STATUS)]):
        event = messages.from_race_status(message)
        asked.setdefault(event.state, event.stamp_ns)
    rows += [Cue(asked[state], service=service) for state, service in SERVICE_OF.items() if state in asked]
    return sorted(rows, key=lambda cue: cue.due_ns)


def unpack_images(bag: Path, folder: Path) -> dict[int, int]:
    """Write a race's images as files that the node camera plays, after a while of darkness in which the nodes find one
    another; return when each was taken, ns, by the hash of its pixels. Raises UsageError when the bag has none."""
    bags.require(bag, full_name(IMAGES))
    taken_ns = {}
    for number, (_, message, _) in enumerate(bags.read(bag, [full_name(IMAGES)]), start=DARK_IMAGES):
        image = messages.from_image(message)
        cv2.imwrite(str(folder / f"{number}.pgm"), image)
        taken_ns[hash(image.tobytes())] = messages.stamp_ns(message.header.stamp)
    for number in range(DARK_IMAGES):
        cv2.imwrite(str(folder / f"{number}.pgm"), np.zeros_like(image))
    return taken_ns


class StandingController:
    """A simulated flight controller on a vehicle at rest, behind MSP on a TCP port, on the system's clock."""

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
        begun_s = time.monotonic()
        while not self._ended.wait(TICK_S):
            with self._socket.lock:
                self._controller.update(round(1e9 * (time.monotonic() - begun_s)), self._readings)

    def close(self) -> None:
        """Stop answering."""
        self._ended.set()
        self._thread.join()
        self._socket.close()


@dataclass(frozen=True)
class Load:
    """What a process has used: cpu_s so far, resident_mb of memory now."""

    cpu_s: float
    resident_mb: float


def load(process_id: int) -> Load:
    """Return what a running process has used."""
    fields = Path(f"/proc/{process_id}/stat").read_text().rsplit(")", 1)[1].split()
    status = Path(f"/proc/{process_id}/status").read_text()
    return Load((int(fields[11]) + int(fields[12])) / CLOCK_TICKS, int(status.split("VmRSS:")[1].split()[0]) / 1024)


def measure(bag: Path, config: Path, out: Path, tell=print) -> dict:
    """Return {"latency_ms": {hop: {count, p50, p99, max}}, "cores": {node: ...}, "resident_mb": {node: ...},
    "late_plays"} of all onboard nodes while a recorded race is played to them. Raises UsageError for a bag without a
    topic and a node's own refusal."""
    rows = cues(bag)
    domain, reservation = free_domain()
    controller = StandingController(config)
    with contextlib.ExitStack() as stack:
        stack.callback(controller.close)
        if reservation:
            stack.callback(reservation.close)
        images = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        taken_ns = unpack_images(bag, images)
        parameters = _parameters(config, out, images, controller.name)
        how = {"lockstep": False, "domain": domain}
        rest = [name for name in ONBOARD if name != "camera"]
        nodes = stack.enter_context(Runner(rest, out / "logs", parameters, **how))
        stage = Stage(domain)
        stack.callback(stage.close)
        time.sleep(WARM_UP_S)
        length_s = 1e-9 * (rows[-1].due_ns - min(taken_ns.values()))
        listener = _listen(domain, length_s + 4 * LISTEN_FIRST_S, out)
        time.sleep(LISTEN_FIRST_S)
        tell(f"playing {length_s:.0f} s of {bag} in real time")
        camera = stack.enter_context(Runner(["camera"], out / "logs", parameters, **how))
        shift_ns = stage.synchronize(taken_ns, rows[0])
        rows = [cue for cue in rows if cue.due_ns + shift_ns > time.time_ns()]
        processes = {name: (camera if name == "camera" else nodes).process_id(name) for name in ONBOARD}
        before, begun_s = {name: load(number) for name, number in processes.items()}, time.monotonic()
        late = stage.play(rows, shift_ns)
        for fault in nodes.faults() + camera.faults():
            raise UsageError(fault)
        after, seconds = {name: load(number) for name, number in processes.items()}, time.monotonic() - begun_s
        listener.wait(timeout=60)
    return {
        "latency_ms": json.loads((out / "latency" / "result.json").read_text())["latency_ms"],
        "cores": {name: (after[name].cpu_s - before[name].cpu_s) / seconds for name in ONBOARD},
        "resident_mb": {name: after[name].resident_mb for name in ONBOARD},
        "late_plays": late,
    }


def _parameters(config: Path, out: Path, images: Path, port: str) -> dict[str, dict]:
    return {
        "*": {"config": str(config.resolve())},
        "betaflight": {"port": port},
        "camera": {"kind": "folder", "path": str(images), "repeat": False},
        "recorder": {"folder": str((out / "bag").resolve())},
    }


def _listen(domain: int, seconds: float, out: Path) -> subprocess.Popen:
    words = ["topics", "latency", "--domain", str(domain), "--seconds", str(seconds), "--out", str(out / "latency")]
    return subprocess.Popen(
        [sys.executable, "-m", "swift_ros.cli", *words], stdout=subprocess.DEVNULL, env=environment(domain)
    )
