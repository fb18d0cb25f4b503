"""The vehicle flown by Betaflight SITL: steps of physics between the passes of the firmware's rate loop."""

import shutil
import tempfile
import time
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller.firmware_settings import FirmwareSettings
from swift_sim_bridge.flight_controller.sitl.cli_lines import command_lines, patient_failsafe
from swift_sim_bridge.flight_controller.sitl.sitl import LOOP_HZ, Sitl
from swift_sim_bridge.physics.integrators import semi_implicit_euler
from swift_sim_bridge.physics.state import stacked, unstacked
from swift_sim_bridge.simulation import simulator
from swift_sim_bridge.simulation.packing import Layout, layout_of

STEP_S = 0.0005  # of physics with gyro sync: four passes of the rate loop at 8 kHz
WALL_CLOCK_STEP_S = 0.002  # without gyro sync: a thread that wakes for shorter steps occupies two cores
PASSES = round(LOOP_HZ * STEP_S)  # of the rate loop in a step
TICK_S = 0.01  # control tick
# Share of a step's length that is the shortest time between two late steps. When the simulation catches up, the
# firmware sees the vehicle move faster by up to 1 / 0.8, a quarter. A larger share catches up more slowly.
MIN_STEP_SHARE = 0.8


@partial(jax.jit, static_argnames=("model_layout", "dt"))
def _move(state, motor_command, model, model_layout: Layout, dt: float):
    """Return (state, Trace) after `dt` s of physics under a motor command (4,) in 0..1.

    `model` is (parameters, world), packed by `model_layout`.
    """
    parameters, world = model_layout.unpack(model)
    state, trace = simulator.move(unstacked(state), motor_command, parameters, world, dt, semi_implicit_euler)
    return stacked(state), trace


def start_sitl_flight(binary, vehicle: Vehicle, settings: FirmwareSettings, parameters, world) -> "SitlFlight":
    """Start the firmware and return the flight of a vehicle that it controls.

    The firmware's settings and log are in a temporary folder, which `close` keeps when the firmware has crashed.

    Args:
        binary: path of the Betaflight SITL program.
        vehicle: the vehicle file; its `controller` section configures the firmware.
        settings: receiver, switches and failsafe of the firmware.
        parameters: physical parameters of the vehicle.
        world: `contact.World`, or None to fly without obstacles.

    Raises:
        UsageError: as `Sitl` and `command_lines`.
    """
    sitl = Sitl(binary, tempfile.mkdtemp(prefix="swift-sitl-"), command_lines(vehicle, settings))
    try:
        if sitl.stepped:
            sitl.set_up([patient_failsafe(settings)])
        sitl.await_calibration()
    except BaseException:
        sitl.close()
        raise
    return SitlFlight(sitl, parameters, world)


class SitlFlight:
    """Runs the physics with the motor outputs of a running firmware.

    With gyro sync, each step of STEP_S contains PASSES passes of the rate loop, whatever time they take. Without it,
    the firmware runs by the wall clock: steps follow the wall clock and a motor command acts one step late.

    Attributes:
        sitl: the running firmware.
        drift_s: s by which the last step was behind the wall clock.
        max_drift_s: largest `drift_s` so far.
    """

    def __init__(self, sitl: Sitl, parameters, world):
        self.sitl = sitl
        self._layout = layout_of((parameters, world))
        self._model = jax.tree.map(jnp.asarray, self._layout.pack((parameters, world)))
        self._step_s = STEP_S if sitl.stepped else WALL_CLOCK_STEP_S
        self._due_s: float | None = None
        self._earliest_s = -np.inf
        self.drift_s = self.max_drift_s = 0.0

    def inherit_priority(self) -> None:
        """Give the firmware the scheduling priority of the calling thread."""
        self.sitl.inherit_priority()

    def close(self) -> None:
        """End the firmware; remove its folder unless it has crashed."""
        running = self.sitl.runs()
        self.sitl.close()
        if running:
            shutil.rmtree(self.sitl.log.parent)

    def compile(self, state) -> tuple:
        """Compile a step. Return as many traces as a tick has, of a vehicle with stopped motors."""
        _, trace = self._moved(state, np.zeros(len(state.rotor_speed)))
        return (trace,) * round(TICK_S / self._step_s)

    def fly(self, state, attitude, specific_force_body, gyro_errors, gyro_gain, running: bool):
        """Fly one tick of 10 ms.

        Args:
            state: state of the vehicle.
            attitude: (4,) x y z w, the firmware's estimate of its attitude.
            specific_force_body: (3,) m/s^2 at the start of the tick.
            gyro_errors: (n, 3) rad/s, added to the measured rates; each row for an n-th of the tick.
            gyro_gain: (3, 3), factor from true to measured rates; None for the identity.
            running: False after a crash: the motors stand still.

        Returns:
            (state, tuple of one `Trace` for each step).
        """
        traces = []
        for error in np.repeat(gyro_errors, round(TICK_S / self._step_s / len(gyro_errors)), axis=0):
            omega_body = np.asarray(state.omega_body)
            gyro = (omega_body if gyro_gain is None else gyro_gain @ omega_body) + error
            motors = self._motors(gyro, attitude, specific_force_body)
            motors = motors if running else np.zeros_like(motors)
            state, trace = self._moved(state, motors)
            specific_force_body = np.asarray(trace.specific_force_body)
            traces.append(trace)
        return state, tuple(traces)

    def _moved(self, state, motors):
        return _move(state, motors, self._model, self._layout, self._step_s)

    def _motors(self, *measured) -> np.ndarray:
        if not self.sitl.stepped:
            self._keep_pace()
            return self.sitl.exchange(*measured)
        for _ in range(PASSES):
            motors = self.sitl.step(*measured)
        return motors

    def _keep_pace(self) -> None:
        """Wait until the next step is due; a late step waits until the shortest time between steps has passed."""
        now_s = time.monotonic()
        if self._due_s is None:
            self._due_s = now_s
        self._earliest_s = max(self._due_s, self._earliest_s, now_s)
        time.sleep(self._earliest_s - now_s)
        self.drift_s = self._earliest_s - self._due_s
        self.max_drift_s = max(self.max_drift_s, self.drift_s)
        self._earliest_s += MIN_STEP_SHARE * self._step_s
        self._due_s += self._step_s
