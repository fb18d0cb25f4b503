"""The vehicle with the real firmware at its motors: physics in short steps between the passes of its rate loop."""

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

STEP_S = 0.0005
WALL_CLOCK_STEP_S = 0.002  # as the simulated firmware's: shorter ones, each woken for, fill two cores
PASSES = round(LOOP_HZ * STEP_S)
TICK_S = 0.01
CATCH_UP = 0.8  # of a step's length, the shortest from one late step to the next: the firmware sees the world speed up


@partial(jax.jit, static_argnames=("standing", "dt"))
def _move(state, motor_command, described, standing: Layout, dt: float):
    """Return (state, Trace) after `dt` s of physics under a motor command (4,) in 0..1.

    described: parameters and world, as the layout `standing` packs them.
    """
    parameters, world = standing.unpack(described)
    state, trace = simulator.move(unstacked(state), motor_command, parameters, world, dt, semi_implicit_euler)
    return stacked(state), trace


def start(binary, vehicle: Vehicle, settings: FirmwareSettings, parameters, world) -> "SitlFlight":
    """Return the flight of a vehicle by a firmware that is started now, set up as its file and `settings` say.

    Its settings and log lie in a temporary folder, which `close` leaves there when the firmware has died.
    Raises UsageError as `Sitl` and `command_lines` do.
    """
    sitl = Sitl(binary, tempfile.mkdtemp(prefix="swift-sitl-"), command_lines(vehicle, settings))
    try:
        if sitl.stepped:
            sitl.set_up([patient_failsafe(settings)])
        sitl.rest()
    except BaseException:
        sitl.close()
        raise
    return SitlFlight(sitl, parameters, world)


class SitlFlight:
    """Flies the physics by the motors of a running firmware.

    With gyro sync every step of STEP_S is PASSES passes of its loop, however long they take. Without, steps keep to the
    wall clock, by which the firmware flies, and a motor command acts one step late; drift_s is how far the last step
    was behind that clock, worst_s the most so far.
    """

    def __init__(self, sitl: Sitl, parameters, world):
        self.sitl = sitl
        self._standing = layout_of((parameters, world))
        self._described = jax.tree.map(jnp.asarray, self._standing.pack((parameters, world)))
        self._step_s = STEP_S if sitl.stepped else WALL_CLOCK_STEP_S
        self._due_s: float | None = None
        self._soonest_s = -np.inf
        self.drift_s = self.worst_s = 0.0

    def hurry(self) -> None:
        """Let the firmware run as urgently as the calling thread."""
        self.sitl.hurry()

    def close(self) -> None:
        """End the firmware."""
        sound = self.sitl.runs()
        self.sitl.close()
        if sound:
            shutil.rmtree(self.sitl.log.parent)

    def compile(self, state) -> tuple:
        """Compile a step; return as many traces as a tick has, of a vehicle that does not turn its motors."""
        _, trace = self._moved(state, np.zeros(len(state.rotor_speed)))
        return (trace,) * round(TICK_S / self._step_s)

    def fly(self, state, attitude, specific_force_body, gyro_errors, gyro_gain, running: bool):
        """Return (state, traces) after 10 ms: a tuple of one `Trace` a step.

        attitude (4,): what the firmware takes its own for; specific_force_body (3,) m/s^2, at the start; gyro_errors:
        (n, 3) rad/s on top of gyro_gain (None or (3, 3)) times the true rates, each for an nth of the 10 ms;
        running: false: the motors are broken and stand.
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
        return _move(state, motors, self._described, self._standing, self._step_s)

    def _motors(self, *measured) -> np.ndarray:
        if not self.sitl.stepped:
            self._keep_pace()
            return self.sitl.exchange(*measured)
        for _ in range(PASSES):
            motors = self.sitl.step(*measured)
        return motors

    def _keep_pace(self) -> None:
        """Wait until the next step is due, and where it is late, no longer than steps may follow each other."""
        now_s = time.monotonic()
        if self._due_s is None:
            self._due_s = now_s
        self._soonest_s = max(self._due_s, self._soonest_s, now_s)
        time.sleep(self._soonest_s - now_s)
        self.drift_s = self._soonest_s - self._due_s
        self.worst_s = max(self.worst_s, self.drift_s)
        self._soonest_s += CATCH_UP * self._step_s
        self._due_s += self._step_s
