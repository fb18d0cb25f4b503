"""Node bridge: the simulator in the place of the hardware.

It publishes what the sensors would publish and receives commands as MSP bytes. On simulated time it publishes the
clock, tick by tick in lockstep with the graph. On the system's clock nothing waits.
"""

import json
import os
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import jax
import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.time import Time
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import Trigger

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_ros.configuration import refuse_outside, setting
from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import NODES
from swift_ros.messages.camera import to_camera_info, to_image
from swift_ros.messages.motion import odometry_bytes, to_imu
from swift_ros.messages.race import from_race_status
from swift_ros.messages.stamps import from_time, to_time
from swift_ros.nodes.shell import Shell, run
from swift_ros.race.control import RaceSettings
from swift_ros.race.judge import ARMED, ENDS, LOST
from swift_ros.working_time import WorkingTime
from swift_sim_bridge.bridge.graph_wait import await_graph
from swift_sim_bridge.bridge.lockstep import IMPATIENT_S, Lockstep, Pace, has_image
from swift_sim_bridge.bridge.report import RaceReport
from swift_sim_bridge.flight_controller.msp_socket import MspSocket
from swift_sim_bridge.flight_controller.sitl.cli_lines import unsupported_by_sitl
from swift_sim_bridge.flight_controller.sitl.msp_proxy import SitlProxy
from swift_sim_bridge.rendering.image_thread import ImageThread, View
from swift_sim_bridge.seeds import MAX_SEED
from swift_sim_bridge.sensors.camera import flown_camera, image_errors
from swift_sim_bridge.simulation.simulated_vehicle import TICK_NS, SimulatedVehicle

CHECK_S = 0.1  # steady s between two checks of patience and of the pacing thread
SMALL_LOOP = "xla_cpu_small_while_loop_byte_threshold=65536"  # bytes of arrays; the loop of a tick has fewer than 2,000
FRAMES_PATIENCE_S = 1.0  # the link writes a frame before it reports it, so the frame normally arrives at once
WALL_CLOCK_CURE = "give one with gyro sync (its option SIMULATOR_GYROPID_SYNC), or fly in real time (--real-time)"
BROWN_OUT = "simulator/brown_out"  # service
IMAGE, INFO = "camera/image_raw", "camera/camera_info"


@dataclass(frozen=True)
class BridgeSettings:
    """Section `bridge` of nodes.yaml."""

    seed: int = setting("seed of sensor noise, VIO drift and the appearance of the room", 0, MAX_SEED)
    port: int = setting("TCP port of 127.0.0.1 for MSP; 0: a free one, printed; -1: a pseudo-terminal", -1, 65535)
    images: bool = setting("false: no camera")
    sitl: str = setting("path of a Betaflight SITL binary in place of the simulated firmware; empty: none")
    report: str = setting("JSON file for hashes, thrust-to-weight and counts of late events; empty: none")
    nodes: tuple[str, ...] = setting(
        "lockstep: nodes to wait for before the clock starts; ticks wait for a race_monitor"
    )
    graph_timeout_s: float = setting("lockstep: s of working time to wait for these nodes", 1, 3600)
    patience_s: float = setting("lockstep: s of working time without an answer until ticks stop waiting", 0.5, 60)

    def __post_init__(self):
        for name in self.nodes:
            refuse_outside(NODES, nodes=name)


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
        self._publisher_of = {
            name: self.publisher(name) for name in NODES["bridge"].publishes if name != "/clock" or self.lockstep
        }
        self._camera = configuration.load(Camera, self.folder / "camera.yaml")
        self._image_thread = self._start_image_thread() if s.images else None
        # Ticks do not wait for images: that thread needs no priority.
        self.background_threads = frozenset({self._image_thread.native_id} if self._image_thread else ())
        self._msp = self._open_port()  # last: a client that connects expects a vehicle that moves
        self.get_logger().info(f"flight controller: {self._msp.name}")
        self._stamp_ns, self._frames = -1, 0
        self._pace: Pace | None = None
        self._closing = threading.Event()
        self._failed: UsageError | None = None
        self.subscribe("race/status", self._on_status)
        if self._vehicle.firmware is None:
            self.create_service(Trigger, BROWN_OUT, self._brown_out)
        if self.lockstep:
            self._start_lockstep()
        else:
            self._begun_ns = time.time_ns()  # stamp of the first tick: a stamp is never ahead of the clock
            self._start_pacing()

    def _open_port(self) -> MspSocket:
        firmware, port = self._vehicle.firmware, self.settings.port
        if firmware is None:
            return MspSocket(self._controller, port)
        if self.lockstep and not firmware.sitl.stepped:
            raise UsageError(f"the binary {self.settings.sitl} runs by the wall clock; {WALL_CLOCK_CURE}")
        if lacking := unsupported_by_sitl(self._vehicle.vehicle):
            self.get_logger().warning(f"Betaflight SITL flies without {', '.join(lacking)}")
        return SitlProxy(self._controller, port, firmware.sitl.open_port())

    def _start_image_thread(self) -> ImageThread:
        from swift_sim_bridge.rendering.renderer import Renderer  # not needed, and not compiled, without images
        from swift_sim_bridge.rendering.scene import Looks

        looks = configuration.load_section(Looks, self.folder / "simulation.yaml", "renderer")
        terms = self._vehicle.sensor_terms
        camera, errors = flown_camera(self._camera, terms), image_errors(terms)
        renderer = Renderer(camera, self._vehicle.track, looks, self.settings.seed, errors)
        renderer.render(*self._vehicle.track.start_pose, np.zeros(3), np.zeros(3))  # compile before the clock starts
        return ImageThread(renderer.render, self._publish_image)

    def now_ns(self) -> int:
        """Return the time of the node's clock, ns; in lockstep that of the last tick, for this node makes the clock."""
        return self._stamp_ns if self.lockstep else super().now_ns()

    # Lockstep.

    def _start_lockstep(self) -> None:
        self._time_source.detach_node()  # this node makes the clock; a subscription to it would cost 0.1 ms a tick
        has_judge, s = "race_monitor" in self.settings.nodes, self.settings
        monitor = configuration.load_section(RaceSettings, self.folder / "nodes.yaml", "race_monitor")
        self._waits, self._patience_clock = True, WorkingTime().now_s
        self._lockstep = Lockstep(round(0.5e9 * monitor.announce_ahead_s) if has_judge else None, s.patience_s)
        self.subscribe("betaflight/link", self._on_link)
        if has_judge:
            self.subscribe("race/judged", self._on_judged)
        await_graph(self, s.nodes, {name: self._publisher_of[name] for name in (IMAGE, INFO)}, s.graph_timeout_s)
        self.get_logger().info("all nodes are present; the clock starts")
        self.create_timer(CHECK_S, self._check_patience, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._publish_tick(0)

    def _on_link(self, message) -> None:
        self._lockstep.take_link_report(from_time(message.command_stamp), message.frames_sent)
        self._go_on()

    def _on_judged(self, message) -> None:
        self._lockstep.take_judged_time(from_time(message.stamp))
        self._go_on()

    def _go_on(self) -> None:
        """Fly the next tick when nothing is pending."""
        pending = self._lockstep.pending(self._controller.frames)
        patience_s = FRAMES_PATIENCE_S if self._waits else IMPATIENT_S
        if pending.only_frames and self._msp.wait_for_frames(self._lockstep.frames_due, patience_s):
            pending = self._lockstep.pending(self._controller.frames)
        if not pending:
            self._tick()

    def _check_patience(self) -> None:
        now_s, pending = self._patience_clock(), self._lockstep.pending(self._controller.frames)
        if pending.only_frames and self._lockstep.waited_s(now_s) > FRAMES_PATIENCE_S:
            lost = self._lockstep.write_off(self._controller.frames)
            self.diagnose("warn", f"{lost} MSP frames were lost")
            pending = self._lockstep.pending(self._controller.frames)
        if not pending:
            self._tick()  # a frame has arrived late, or never will
        elif self._lockstep.is_stuck(now_s):
            self._stop_waiting(f"no answer for {self.settings.patience_s:.0f} s ({'; '.join(pending.reasons)})")
            self._tick()

    def _stop_waiting(self, why: str) -> None:
        """Wait no longer than a moment for the graph's answers: simulated time goes on."""
        if not self._waits:
            return
        self._waits, self._patience_clock = False, time.monotonic
        self._lockstep.lose_patience(time.monotonic())
        self.diagnose("error", f"simulated time continues without the graph: {why}")
        self.create_timer(IMPATIENT_S, self._check_patience, clock=Clock(clock_type=ClockType.STEADY_TIME))

    # Ticks by the steady clock.

    def _start_pacing(self) -> None:
        """From now on, fly ticks by the steady clock in a thread."""
        self._pace = Pace(time.monotonic())
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(CHECK_S, self._check_pacing, clock=steady)
        if self._vehicle.firmware and not self.lockstep:
            self._priority_timer = self.create_timer(CHECK_S, self._prioritise_firmware, clock=steady)
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

    def _prioritise_firmware(self) -> None:
        self._priority_timer.cancel()  # once: by now this node has the priority of its row in the graph's table
        self._vehicle.firmware.inherit_priority()

    def _check_pacing(self) -> None:
        if self._failed is not None:
            raise self._failed

    # Ticks.

    def _tick(self) -> None:
        """Fly 10 ms with the commands received so far, then publish the measurements."""
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
        self._publish_tick(time_ns if self.lockstep else self._begun_ns + time_ns - TICK_NS)

    def _publish_tick(self, stamp_ns: int) -> None:
        self._stamp_ns = stamp_ns
        if self.lockstep:
            self.get_clock().set_ros_time_override(Time(nanoseconds=stamp_ns, clock_type=ClockType.ROS_TIME))
            self._lockstep.publish(stamp_ns, self._patience_clock())
            self._publisher_of["/clock"].publish(ClockMessage(clock=to_time(stamp_ns)))
        sensed = self._vehicle.sense(stamp_ns)
        if self._image_thread and has_image(self._vehicle.tick, self._camera.rate_hz):
            self._draw(View(stamp_ns, *sensed.filmed))
        self._publisher_of["ground_truth/odometry"].publish(odometry_bytes(sensed.motion_capture, "map"))
        self._publisher_of["imu/data_raw"].publish(to_imu(stamp_ns, sensed.gyro, sensed.specific_force_body))
        self._publisher_of["vio/raw"].publish(odometry_bytes(sensed.vio, "odom"))

    def _draw(self, view: View) -> None:
        if self._image_thread.busy and not self.lockstep:
            self._report.late_images += 1
            return
        # Before the odometry of the same stamp: a subscriber that waits for the image must know of it.
        self._publisher_of[INFO].publish(to_camera_info(self._camera, view.stamp_ns))
        self._image_thread.draw(view)

    def _publish_image(self, image, stamp_ns: int) -> None:
        if self.context.ok():
            self._publisher_of[IMAGE].publish(to_image(image, stamp_ns))

    def _on_status(self, message) -> None:
        event = from_race_status(message)
        if event.state == ARMED:
            self._report.arm()
        if event.state in ENDS:
            self._report.end(event.stamp_ns)
            self._write_report()
        if event.state == LOST and self.lockstep:
            self._stop_waiting(event.text)

    def _brown_out(self, request, response):
        """Restart the flight controller for lack of voltage, to see what the graph does."""
        with self._msp.lock:
            self._controller.brown_out()
        response.success, response.message = True, "the flight controller restarts"
        return response

    def _write_report(self) -> None:
        if self.settings.report:
            Path(self.settings.report).write_text(json.dumps(self._report.as_dict(), indent=1) + "\n")

    def close(self) -> None:
        """Write the report and close images, MSP port and firmware."""
        self._closing.set()
        if self._pace:
            self._pacer.join(timeout=2.0)
        self._write_report()
        if self._image_thread:
            self._image_thread.close()
        if self._failed is None:  # after a failure the process exit closes the port, so clients report after this node
            self._msp.close()
        if self._vehicle.firmware:
            self._vehicle.firmware.close()


def _prepare_jax() -> None:
    """Configure JAX: double precision, on the CPU, in the caller's thread because a tick is too short for a handover.

    XLA splits the arrays of an image among the threads of its pool, which costs a third more CPU time than one thread
    needs; its loop over the sub-steps of a tick takes three times as long as one compiled function. Both settings are
    read when JAX first computes; those of the environment win.
    """
    os.environ.setdefault("PJRT_NPROC", "1")
    os.environ.setdefault("XLA_FLAGS", f"--xla_backend_extra_options={SMALL_LOOP}")
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_cpu_enable_async_dispatch", False)


def main() -> None:
    """Run the node."""
    run(BridgeNode)
