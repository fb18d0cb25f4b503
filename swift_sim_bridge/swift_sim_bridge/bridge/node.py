"""Node bridge: the simulator in the hardware's place. Speaks what sensors would, hears commands as MSP bytes.

On simulated time it makes the clock, tick by tick in lockstep with the graph; on the system's clock nothing waits.
"""

import json
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.time import Time
from rosgraph_msgs.msg import Clock as ClockMessage

from swift_ros import configuration, messages
from swift_ros.camera.model import Camera
from swift_ros.configuration import setting
from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import NODES
from swift_ros.nodes.shell import Shell, run
from swift_ros.race.control import RaceSettings
from swift_ros.race.judge import ENDS, LOST
from swift_sim_bridge.bridge.graph_wait import await_graph
from swift_sim_bridge.bridge.lockstep import Lockstep, Pace, has_image
from swift_sim_bridge.bridge.report import RaceReport
from swift_sim_bridge.flight_controller.msp_socket import MspSocket
from swift_sim_bridge.flight_controller.sitl.cli_lines import left_out
from swift_sim_bridge.flight_controller.sitl.msp_proxy import SitlProxy
from swift_sim_bridge.rendering.image_thread import ImageThread, View
from swift_sim_bridge.sensors.camera import flown_camera, image_errors
from swift_sim_bridge.simulation.simulated_vehicle import TICK_NS, SimulatedVehicle

LOOK_S = 0.1
FRAMES_PATIENCE_S = 1.0  # a frame was written before the link says so: it is there at once
WALL_CLOCK_CURE = "give one with gyro sync (its option SIMULATOR_GYROPID_SYNC), or fly in real time (--real-time)"
IMAGE, INFO = "camera/image_raw", "camera/camera_info"


@dataclass(frozen=True)
class BridgeSettings:
    """Section `bridge` of nodes.yaml."""

    seed: int = setting("of sensor noise, VIO drift and the world's looks", 0, 2**31 - 1)
    port: int = setting("TCP port of 127.0.0.1 for MSP; 0: a free one, printed; -1: a pseudo-terminal", -1, 65535)
    images: bool = setting("false: no camera")
    sitl: str = setting("path of a Betaflight SITL binary in the simulated controller's place; empty: none")
    report: str = setting("JSON file for hashes, thrust-to-weight and what was late; empty: none")
    nodes: tuple[str, ...] = setting("lockstep: the clock starts when these are there, and the judge is waited for")
    graph_timeout_s: float = setting("lockstep: s to wait for them", 1, 3600)
    patience_s: float = setting("lockstep: steady s without an answer after which nobody is waited for", 0.5, 60)


class BridgeNode(Shell):
    """Shell around SimulatedVehicle and Lockstep."""

    def __init__(self):
        _prepare_jax()
        super().__init__("bridge", BridgeSettings)
        s = self.settings
        self._vehicle = SimulatedVehicle(self.folder, s.seed, s.sitl)
        self._controller = self._vehicle.flight_controller
        self._vehicle.compile()
        self._report = RaceReport(s.seed, self._vehicle)
        self._say = {name: self.publisher(name) for name in NODES["bridge"].publishes if name != "/clock" or self.lockstep}
        self._camera = configuration.load(Camera, self.folder / "camera.yaml")
        self._eye = self._open_eye() if s.images else None
        self.background_threads = frozenset({self._eye.native_id} if self._eye else ())  # ticks do not wait for images
        self._msp = self._open_port()  # last: who connects expects a vehicle that moves
        self.get_logger().info(f"flight controller: {self._msp.name}")
        self._stamp_ns, self._frames = -1, 0
        self._pace: Pace | None = None
        self._closing = threading.Event()
        self._failed: UsageError | None = None
        self.subscribe("race/status", self._on_status)
        if self.lockstep:
            self._start_lockstep()
        else:
            self._begun_ns = time.time_ns()
            self._keep_pace()

    def _open_port(self) -> MspSocket:
        firmware, port = self._vehicle.firmware, self.settings.port
        if firmware is None:
            return MspSocket(self._controller, port)
        if self.lockstep and not firmware.sitl.stepped:
            raise UsageError(f"the binary {self.settings.sitl} flies by the wall clock; {WALL_CLOCK_CURE}")
        if lacking := left_out(self._vehicle.vehicle):
            self.get_logger().warning(f"Betaflight SITL flies without {', '.join(lacking)}")
        return SitlProxy(self._controller, port, firmware.sitl.open_port())

    def _open_eye(self) -> ImageThread:
        from swift_sim_bridge.rendering.renderer import Renderer  # not needed, and not compiled, without images
        from swift_sim_bridge.rendering.scene import Looks

        looks = configuration.load_section(Looks, self.folder / "simulation.yaml", "renderer")
        terms = self._vehicle.sensor_terms
        camera, errors = flown_camera(self._camera, terms), image_errors(terms)
        renderer = Renderer(camera, self._vehicle.track, looks, self.settings.seed, errors)
        renderer.render(*self._vehicle.track.start_pose, np.zeros(3), np.zeros(3))  # compile before the clock starts
        return ImageThread(renderer.render, self._publish_image)

    # Lockstep.

    def _start_lockstep(self) -> None:
        self._time_source.detach_node()  # it makes the clock; to hear it back would cost 0.1 ms a tick
        judged, s = "race_monitor" in self.settings.nodes, self.settings
        monitor = configuration.load_section(RaceSettings, self.folder / "nodes.yaml", "race_monitor")
        self._lockstep = Lockstep(round(0.5e9 * monitor.announce_ahead_s) if judged else None, s.patience_s)
        self.subscribe("betaflight/link", self._on_link)
        if judged:
            self.subscribe("race/judged", self._on_judged)
        await_graph(self, s.nodes, {name: self._say[name] for name in (IMAGE, INFO)}, s.graph_timeout_s)
        self.get_logger().info("everybody is there; the clock starts")
        self.create_timer(LOOK_S, self._check_patience, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._publish_tick(0)

    def _on_link(self, message) -> None:
        self._lockstep.hear_link(messages.stamp_ns(message.command_stamp), message.frames_sent)
        self._go_on()

    def _on_judged(self, message) -> None:
        self._lockstep.hear_judge(messages.stamp_ns(message.stamp))
        self._go_on()

    def _go_on(self) -> None:
        """Advance when nothing is owed any more."""
        if self._pace is not None:
            return
        owed = self._lockstep.owed(self._controller.frames)
        if owed.frames and self._msp.wait_for_frames(self._lockstep.frames_sent, FRAMES_PATIENCE_S):
            owed = self._lockstep.owed(self._controller.frames)
        if not owed:
            self._tick()

    def _check_patience(self) -> None:
        if self._pace is not None:
            return
        owed = self._lockstep.owed(self._controller.frames)
        if not owed:
            self._tick()  # a frame came later than anybody waited for it
        elif self._lockstep.is_stuck(time.monotonic()):
            self._set_free(f"no answer for {self.settings.patience_s:.0f} s ({'; '.join(owed.what)})")

    def _set_free(self, why: str) -> None:
        """Wait for nobody any more: simulated time runs on at the pace of the steady clock."""
        self.diagnose("error", f"simulated time runs on without the graph: {why}")
        self._keep_pace()

    # By the steady clock.

    def _keep_pace(self) -> None:
        """From now on ticks come by the steady clock, from a thread of their own."""
        self._pace = Pace(time.monotonic())
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(LOOK_S, self._check_pacer, clock=steady)
        if self._vehicle.firmware and not self.lockstep:
            self._hurry = self.create_timer(LOOK_S, self._hurry_firmware, clock=steady)
        self._pacer = threading.Thread(target=self._run, name="pace", daemon=True)
        self._pacer.start()

    def _run(self) -> None:
        while not self._closing.wait(max(0.0, self._pace.wait_s(time.monotonic()))):
            self._pace.begin(time.monotonic())
            missed = self._controller.arming.armed and self._controller.frames == self._frames
            self._report.late_commands += missed
            self._report.late_ticks = self._pace.late
            try:
                self._tick()
            except UsageError:
                return

    def _hurry_firmware(self) -> None:
        self._hurry.cancel()  # once: by now this node has the priority of its row
        self._vehicle.firmware.hurry()

    def _check_pacer(self) -> None:
        if self._failed is not None:
            raise self._failed

    # In any case.

    def _tick(self) -> None:
        """Fly on for 10 ms by what was heard, and say what the sensors see then."""
        crash = self._vehicle.crash
        with self._msp.lock:
            self._report.note(self._stamp_ns)
            self._frames = self._controller.frames
            try:
                self._vehicle.advance()
            except UsageError as error:  # the real firmware has ended
                self._failed = error
                raise
        if self._vehicle.crash != crash:
            self.diagnose("warn", self._vehicle.crash)
        time_ns = self._vehicle.tick * TICK_NS
        self._publish_tick(time_ns if self.lockstep else self._begun_ns + time_ns)

    def _publish_tick(self, stamp_ns: int) -> None:
        self._stamp_ns = stamp_ns
        if self.lockstep:
            self.get_clock().set_ros_time_override(Time(nanoseconds=stamp_ns, clock_type=ClockType.ROS_TIME))
            self._lockstep.publish(stamp_ns, time.monotonic())
            self._say["/clock"].publish(ClockMessage(clock=messages.to_time(stamp_ns)))
        sensed = self._vehicle.sense(stamp_ns)
        if self._eye and has_image(self._vehicle.tick):
            self._see(View(stamp_ns, *sensed.filmed))
        self._say["ground_truth/odometry"].publish(messages.to_odometry(sensed.motion_capture, "map"))
        self._say["imu/data_raw"].publish(messages.to_imu(stamp_ns, sensed.gyro, sensed.specific_force_body))
        self._say["vio/raw"].publish(messages.to_odometry(sensed.vio, "odom"))

    def _see(self, view: View) -> None:
        if self._eye.busy and not self.lockstep:
            self._report.late_images += 1
            return
        # Ahead of the odometry of its stamp: who waits for an image must know of it.
        self._say[INFO].publish(messages.to_camera_info(self._camera, view.stamp_ns))
        self._eye.draw(view)

    def _publish_image(self, image, stamp_ns: int) -> None:
        if self.context.ok():
            self._say[IMAGE].publish(messages.to_image(image, stamp_ns))

    def _on_status(self, message) -> None:
        event = messages.from_race_status(message)
        if event.state in ENDS:
            self._report.end(event.stamp_ns)
            self._write_report()
        if event.state == LOST and self._pace is None:
            self._set_free(event.text)

    def _write_report(self) -> None:
        if self.settings.report:
            Path(self.settings.report).write_text(json.dumps(self._report.as_dict(), indent=1) + "\n")

    def close(self) -> None:
        """Write the report, and stop drawing and answering."""
        self._closing.set()
        if self._pace:
            self._pacer.join(timeout=2.0)
        self._write_report()
        if self._eye:
            self._eye.close()
        if self._failed is None:  # else clients, whose port ends with this process, would tell of their trouble first
            self._msp.close()
        if self._vehicle.firmware:
            self._vehicle.firmware.close()


def _prepare_jax() -> None:
    """Physics in double precision, on the CPU and in the caller's thread: a tick is too short to hand it to another.

    XLA keeps its pool of threads: with a single one, ticks wait for images (10 ms), and no CPU time is saved.
    """
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_cpu_enable_async_dispatch", False)


def main() -> None:
    """Run the node."""
    run(BridgeNode)
