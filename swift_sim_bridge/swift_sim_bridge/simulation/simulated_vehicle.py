"""The simulated vehicle on its track: physics, flight controller and sensors in ticks of 10 ms. No ROS.

A flight is a function of configuration, seed and the MSP bytes that its flight controller receives between the ticks.
"""

import hashlib
import itertools
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros import configuration, geometry
from swift_ros.track import Track
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge import seeds
from swift_sim_bridge.flight_controller.configuration.vehicle_profile import profile_from_vehicle
from swift_sim_bridge.flight_controller.firmware import FlightController, Readings, Setpoint
from swift_sim_bridge.flight_controller.firmware_settings import FirmwareSettings
from swift_sim_bridge.flight_controller.rate_loop.stick_path import ReceiverFrame, Sticks
from swift_sim_bridge.flight_controller.sitl.msp_proxy import SitlController
from swift_sim_bridge.physics import battery, contact, motors
from swift_sim_bridge.physics.state import BATTERY, parameters_from_vehicle
from swift_sim_bridge.physics.trace import Trace
from swift_sim_bridge.sensors import imu_calibration, imu_errors
from swift_sim_bridge.sensors.attitude import AttitudeEstimate, AttitudeSettings
from swift_sim_bridge.sensors.clock import Moving
from swift_sim_bridge.sensors.imu_errors import ImuTruth
from swift_sim_bridge.sensors.suite import Sensed, Sensors
from swift_sim_bridge.sensors.terms import sensor_terms
from swift_sim_bridge.sensors.world import flown_track
from swift_sim_bridge.simulation import simulator
from swift_sim_bridge.simulation.checks import refuse_impossible
from swift_sim_bridge.simulation.packing import Layout, layout_of
from swift_sim_bridge.simulation.sitl_vehicle import start_sitl_flight

TICK_NS = 10_000_000  # one control tick at 100 Hz
SUBSTEPS, SUBSTEP_S = 5, 0.002  # physics steps in a tick; one pass of the plain rate loop each
VOLTAGE_ITERATIONS = 30  # of voltage and load in `thrust_to_weight`; each reduces the error about tenfold


@dataclass(frozen=True)
class _TickEnd(Trace):
    """Values at the end of a tick as NumPy arrays and plain numbers.

    Attributes:
        drawn: A s drawn from the pack.
    """

    drawn: float = 0.0


@cache
def _compiled_tick(flight_layout: Layout, model_layout: Layout, sampled: bool):
    """Return `_fly_tick` for all vehicles of these layouts, compiled at the first call."""
    return jax.jit(partial(_fly_tick, flight_layout=flight_layout, model_layout=model_layout, sampled=sampled))


@cache
def _compiled_full_thrust(flight_layout: Layout, model_layout: Layout):
    """Return `_full_thrust` for all vehicles of these layouts, compiled at the first call."""
    return jax.jit(partial(_full_thrust, flight_layout=flight_layout, model_layout=model_layout))


def _full_thrust(flight, model, voltage, flight_layout: Layout, model_layout: Layout):
    """Return the thrust (N) of all rotors at full command, at which the pack sags from `voltage` (V)."""
    state, p = flight_layout.unpack(flight).state, model_layout.unpack(model).parameters

    def full_speed(voltage):
        return motors.steady_speed(jnp.ones_like(state.rotor_speed), voltage, p.motors)

    def sagged(_, voltage):
        load_w = battery.power(full_speed(voltage), p.rotors.torque_coefficient, p.battery)
        memory = state.memory.get(BATTERY)
        return battery.voltage_and_current(load_w, state.charge, state.rc_voltage, p.battery, memory)[0]

    voltage = jax.lax.fori_loop(0, VOLTAGE_ITERATIONS, sagged, jnp.asarray(voltage))
    return jnp.sum(p.rotors.thrust_coefficient * full_speed(voltage) ** 2)


def _fly_tick(flight, model, command, flight_layout: Layout, model_layout: Layout, sampled: bool):
    """Fly one tick.

    Args:
        flight: vectors of the `simulator.Flight`, packed by `flight_layout`.
        model: vectors of the `simulator.FlightModel`, packed by `model_layout`.
        command: one vector, packed by `SimulatedVehicle._fly`.
        flight_layout: layout of the flight.
        model_layout: layout of the model.
        sampled: whether to return the values of each sub-step.

    Returns:
        (packed flight, `_tick_end` vector, (rates, specific force, rotor speeds) of each sub-step or ()).
    """
    flight, model = flight_layout.unpack(flight), model_layout.unpack(model)
    sticks = None if model.profile.airmode is None else Sticks(command[-4:-1], command[-1] > 0)
    frame = ReceiverFrame(command[:3], command[3], command[4] > 0, sticks)
    gyro_noise = command[5:-4].reshape(SUBSTEPS, 3)
    flight, trace = simulator.advance(flight, frame, model, simulator.Stepping(SUBSTEPS, SUBSTEP_S), gyro_noise)
    samples = (trace.omega_body, trace.specific_force_body, trace.rotor_speed) if sampled else ()
    return flight_layout.pack(flight), _tick_end(flight.state, trace), samples


@jax.jit
def _end_tick(state, traces):
    """Return (`_tick_end` vector, samples) as `_fly_tick`, from the traces of steps shorter than a sub-step."""
    trace = jax.tree.map(lambda *rows: jnp.stack(rows), *traces)
    stride = len(traces) // SUBSTEPS
    samples = (trace.omega_body, trace.specific_force_body, trace.rotor_speed)
    return _tick_end(state, trace), tuple(rows[stride - 1 :: stride] for rows in samples)


def _tick_end(state, trace):
    """Return the values at the end of a tick in one vector: fetching each array separately costs 0.02 ms."""
    touched = trace.contact
    first = jnp.argmax(touched.crashed)
    parts = (
        state.p_world,
        state.q_world_body,
        state.v_world,
        state.omega_body,
        trace.specific_force_body[-1],
        state.rotor_speed,
        trace.motor_command[-1],
        trace.voltage[-1],
        trace.current.mean(),
        state.charge,
        touched.crashed[first],
        touched.gate[first],
        touched.impact[first],
    )
    return jnp.concatenate([jnp.ravel(part).astype(state.p_world.dtype) for part in parts])


class SimulatedVehicle:
    """A vehicle, initially at rest on its podium with its flight controller just powered on.

    Attributes:
        vehicle: the vehicle file.
        flight_controller: receives MSP bytes by `feed`.
        track: the gates at their true places, which terms may displace from the map.
        sensor_terms: see `sensors.terms`.
        firmware: the real firmware that flies the vehicle; None where the firmware is simulated.
        tick: number of ticks flown.
        crash: sentence that says what was hit and when; None before a crash.
        impact_m_s: m/s, closing speed of the crash; None before one.
        crash_s: s of the crash; None before one.
        disarmed_s: s of the last disarming; None before.
    """

    def __init__(self, folder: Path, seed: int, sitl: str = ""):
        """Load the vehicle.

        Args:
            folder: configuration folder.
            seed: seed of the race.
            sitl: path of a Betaflight SITL binary that flies the vehicle; empty for the simulated firmware. A flight
                by SITL is not reproducible to the bit.

        Raises:
            UsageError: the vehicle, the track or a setting cannot be simulated.
        """
        self.vehicle = configuration.load(Vehicle, folder / "drone.yaml")
        refuse_impossible(self.vehicle)
        self.sensor_terms = sensor_terms(self.vehicle)
        self.track = flown_track(configuration.load(Track, folder / "track.yaml"), self.sensor_terms)
        self._parameters = parameters_from_vehicle(self.vehicle)
        self._profile = profile_from_vehicle(self.vehicle)
        self._world = contact.world_from_track(self.track, self.vehicle.hull_height)
        start_pose = (jnp.asarray(part) for part in self.track.start_pose)
        key = jax.random.key(int(seeds.generator(seed, "physics").integers(2**31)))
        flight = simulator.initial_flight(*start_pose, len(self.vehicle.rotors), self._profile, self._parameters, key)
        self._make_sensors(folder / "simulation.yaml", seed)
        model = simulator.FlightModel(self._parameters, self._profile, self._world, self._gyro_gain)
        self._layout, model_layout = layout_of(flight), layout_of(model)
        self._packed, self._model = self._layout.pack(flight), jax.tree.map(jnp.asarray, model_layout.pack(model))
        self._fly_tick = _compiled_tick(self._layout, model_layout, self._sensors.distorts_imu)
        self._full_thrust = _compiled_full_thrust(self._layout, model_layout)
        self._tick_end = self._at_rest()
        settings = configuration.load_section(FirmwareSettings, folder / "simulation.yaml", "flight_controller")
        controller = SitlController if sitl else FlightController
        self.flight_controller = controller(settings, self.vehicle, self._readings())
        self.firmware = None
        if sitl:
            self.firmware = start_sitl_flight(sitl, self.vehicle, settings, self._parameters, self._world)
        self.tick = 0
        self.crash: str | None = None
        self.impact_m_s: float | None = None
        self.crash_s: float | None = None
        self.disarmed_s: float | None = None
        self._armed = False
        self._truth = hashlib.sha256()

    def _make_sensors(self, path: Path, seed: int) -> None:
        noise = self.vehicle.sensors
        self._gyro_noise, self._rng = noise.get("gyro_rad_s", 0.0), seeds.generator(seed, "flight_controller")
        self._meter_noise = (noise.get("vbat_v", 0.0), noise.get("ibat_a", 0.0))
        self._sensors = Sensors(path, self.vehicle, self.sensor_terms, seed)
        self._samples: ImuTruth | None = None
        # The rate loop uses the same gyro, without clipping, vibration and g-sensitivity.
        gain, self._gyro_bias = (
            part(self.sensor_terms, "gyro") for part in (imu_calibration.gain_matrix, imu_calibration.bias)
        )
        self._gyro_gain = None if np.array_equal(gain, np.eye(3)) else gain
        attitude = configuration.load_section(AttitudeSettings, path, "attitude_estimate")
        self._attitude = AttitudeEstimate(attitude, seeds.generator(seed, "attitude_estimate"))

    @property
    def _flight(self) -> simulator.Flight:
        return self._layout.unpack(tuple(map(np.asarray, self._packed)))

    def _at_rest(self) -> _TickEnd:
        state, zero = self._flight.state, np.zeros(3)
        idle_w = battery.power(state.rotor_speed, 0.0, self._parameters.battery)
        voltage, current = battery.voltage_and_current(idle_w, state.charge, state.rc_voltage, self._parameters.battery)
        q_world_body = np.asarray(state.q_world_body)
        return _TickEnd(
            p_world=np.asarray(state.p_world),
            q_world_body=q_world_body,
            v_world=zero,
            omega_body=zero,
            specific_force_body=geometry.rotate_inverse(q_world_body, np.array([0.0, 0.0, GRAVITY])),
            rotor_speed=np.zeros(len(self.vehicle.rotors)),
            motor_command=np.zeros(len(self.vehicle.rotors)),
            voltage=float(voltage),
            current=float(current),
        )

    def sense(self, stamp_ns: int) -> Sensed:
        """Return the measurements of all sensors at this time, stamped `stamp_ns`. Call it once in each tick."""
        now = self._tick_end
        moving = Moving(now.p_world, now.q_world_body, now.v_world, now.omega_body)
        samples = (self._samples or self._samples_at_rest()) if self._sensors.distorts_imu else None
        sensed = self._sensors.sense(stamp_ns, 1e-9 * TICK_NS * self.tick, moving, now.specific_force_body, samples)
        truth = sensed.truth
        self._truth.update(stamp_ns.to_bytes(8, "little"))
        for value in (truth.p_world, truth.q_world_body, truth.v_body, truth.omega_body):
            self._truth.update(np.ascontiguousarray(value, dtype="<f8").tobytes())
        return sensed

    def _samples_at_rest(self) -> ImuTruth:
        now = self._tick_end
        rows = (now.omega_body, np.zeros(3), now.specific_force_body, now.rotor_speed)
        return ImuTruth(SUBSTEP_S, *(np.array([row]) for row in rows))

    def compile(self) -> None:
        """Compile the functions of a tick and of the report: the compiler would hold up the flight for a second."""
        self.thrust_to_weight(self.pack)
        if self.firmware is not None:
            _end_tick(self._flight.state, self.firmware.compile(self._flight.state))
            return
        self._fly(Setpoint(np.zeros(3), 0.0, False, np.zeros(3), False), False, np.zeros((SUBSTEPS, 3)))

    def advance(self) -> None:
        """Fly one tick with the commands that the flight controller has received. After a crash the motors stay off."""
        readings = self._readings()
        setpoint = self.flight_controller.update(self.tick * TICK_NS, readings)
        armed = self.flight_controller.arming.armed
        if self._armed and not armed:
            self.disarmed_s = round(1e-9 * self.tick * TICK_NS, 3)
        self._armed = armed
        gyro_noise = self._gyro_noise * self._rng.standard_normal((SUBSTEPS, 3)) + self._gyro_bias
        if self.firmware is not None:
            self._packed, tick_end, samples = self._fly_firmware(readings, gyro_noise)
        else:
            self._packed, tick_end, samples = self._fly(setpoint, armed and self.crash is None, gyro_noise)
        if samples:
            omega_body, specific_force_body, rotor_speed = (np.asarray(rows) for rows in samples)
            alpha_body = imu_errors.angular_acceleration(omega_body, SUBSTEP_S, self._tick_end.omega_body)
            self._samples = ImuTruth(SUBSTEP_S, omega_body, alpha_body, specific_force_body, rotor_speed)
        self._take_tick_end(np.asarray(tick_end))

    def _take_tick_end(self, tick_end: np.ndarray) -> None:
        """Store the values of a `_tick_end` vector and note a first crash."""
        rotors = len(self.vehicle.rotors)
        bounds = itertools.accumulate((3, 4, 3, 3, 3, rotors, rotors), initial=0)
        arrays = [tick_end[begin:end] for begin, end in itertools.pairwise(bounds)]
        voltage, current, drawn, crashed, gate, speed = tick_end[-6:].tolist()
        self.flight_controller.take_motor_state(arrays[6], arrays[5])
        self._tick_end = _TickEnd(*arrays, voltage, current, drawn=drawn)
        self.tick += 1
        if crashed and self.crash is None:
            obstacle = f"gate {gate + 1:.0f}" if gate >= 0 else "the ground"
            self.impact_m_s = round(speed, 2)
            self.crash_s = round(1e-9 * self.tick * TICK_NS, 3)
            self.crash = f"hit {obstacle} at {speed:.1f} m/s after {self.crash_s:.2f} s"

    def _fly(self, setpoint: Setpoint, armed: bool, gyro_noise):
        throttle, sticks = (setpoint.throttle, armed), (*setpoint.deflection, setpoint.levelled)
        command = np.concatenate((setpoint.omega_body, throttle, gyro_noise.ravel(), sticks))
        return self._fly_tick(self._packed, self._model, command)

    def _fly_firmware(self, readings: Readings, gyro_errors):
        measured = (readings.q_world_body, self._tick_end.specific_force_body, gyro_errors, self._gyro_gain)
        flight = self._flight
        state, traces = self.firmware.fly(flight.state, *measured, running=self.crash is None)
        tick_end, samples = _end_tick(state, traces)
        packed = self._layout.pack(replace(flight, state=state))
        return packed, tick_end, samples if self._sensors.distorts_imu else ()

    def _readings(self) -> Readings:
        now, noise = self._tick_end, self._rng.standard_normal(2)
        omega_body = now.omega_body if self._gyro_gain is None else self._gyro_gain @ now.omega_body
        return Readings(
            q_world_body=self._attitude.measure(now.q_world_body, 1e-9 * TICK_NS),
            omega_body=omega_body + self._gyro_bias,
            voltage=now.voltage + self._meter_noise[0] * noise[0],
            current=now.current + self._meter_noise[1] * noise[1],
            drawn=now.drawn,
            motor_command=now.motor_command,
            rotor_speed=now.rotor_speed,
            **self._runaway_readings(),
        )

    def _runaway_readings(self) -> dict:
        """Return the rate loop's signals for runaway-takeoff prevention, where a CLI dump switches it on."""
        if not self._profile.watch_runaway:
            return {}
        terms = self._flight.loop.terms
        return {"pid_sum": np.asarray(terms["pid_sum"]), "runaway": bool(terms["runaway"])}

    @property
    def truth_sha256(self) -> str:
        """Hash of the ground truth so far: stamps, positions, attitudes, velocities and rates as doubles."""
        return self._truth.hexdigest()

    @property
    def speed_m_s(self) -> float:
        """Speed of the vehicle, m/s."""
        return float(np.linalg.norm(self._tick_end.v_world))

    @property
    def pack(self) -> tuple:
        """The battery's state for `thrust_to_weight`: the vectors of the flight, as only it needs to unpack them."""
        return tuple(map(np.array, self._packed))

    def thrust_to_weight(self, pack: tuple) -> float:
        """Return the thrust of all rotors at full command over the weight, with a `pack` that sags under that load."""
        return float(self._full_thrust(pack, self._model, self.vehicle.battery.reference_voltage)) / (
            self.vehicle.mass * GRAVITY
        )
