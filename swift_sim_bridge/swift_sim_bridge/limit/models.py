"""The vehicle as the limit sees it: rates of change of its state, and bounds, from the physics of the simulator.

full thrust   every rotor gives any thrust up to the vehicle file's largest at once; no air, no battery
as flown      every term of the vehicle file by its mean, the pack's voltage, the motors' lag and range

Both have the limits of the body rates. The flight controller's mixer passes on any motor commands from idle to full: it
bounds single motors. What the rate loop takes from the thrust to follow jerky commands depends on the pilot; `headroom`
is a share of the motors' commands that is left to it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import jax
import jax.numpy as jnp
import numpy as np

from swift_ros.vehicle import Battery, Vehicle
from swift_sim_bridge.limit.symbolic import symbolic
from swift_sim_bridge.physics import battery, motors
from swift_sim_bridge.physics.integrators import Body, Drive
from swift_sim_bridge.physics.state import parameters_from_vehicle
from swift_sim_bridge.physics.terms import registry, vectors
from swift_sim_bridge.physics.terms.vectors import Quaternion, Vector, parts, rotate_inverse

FULL_THRUST, AS_FLOWN = "full_thrust", "as_flown"
TITLES = {FULL_THRUST: "full thrust", AS_FLOWN: "as flown"}
P, V, Q, OMEGA = slice(0, 3), slice(3, 6), slice(6, 10), slice(10, 13)  # of a state; rotors and pack follow
POSE = 13  # entries of these
SETTLING = 30  # iterations of voltage and current under load; each reduces the error to a tenth or less
PACK = ("charge", "rc_voltage")  # of the pack, and the keys of its memory
SCALES = {"charge": 100.0, "rc_voltage": 0.1, "rc2_voltage": 0.1, "energy": 1000.0, "celsius": 10.0}


@dataclass(frozen=True)
class Model:
    """A vehicle as a control problem.

    The state begins with p_world and v_world; of a rigid body q_world_body, omega_body, rotor speeds and pack follow.

    Attributes:
        rates: (state, control) -> time derivative of the state.
        room: (state, control) -> (any number), each from 0 to 1 or more: what is left to a bound.
        scale, low, high: (k) of the state's entries.
        control_scale, control_low, control_high: (c) of the controls.
        rest: (k) state at rest; NaN where the course gives it, or it is free.
        loaded: (k) state when a flying lap begins, of the pack alone, which is full and under load; elsewhere NaN.
        returning: entries of the state that a flying lap ends with as it began, beside the attitude.
        attitude: whether the state has an attitude.
        observed: (state, control) -> specific force in the body frame (3) m/s^2, rotor speeds (n) rad/s, voltage (V);
            None for a point mass.
    """

    rates: ca.Function
    room: ca.Function
    scale: np.ndarray
    low: np.ndarray
    high: np.ndarray
    control_scale: np.ndarray
    control_low: np.ndarray
    control_high: np.ndarray
    rest: np.ndarray
    loaded: np.ndarray
    returning: np.ndarray
    attitude: bool = True
    observed: ca.Function | None = None

    def first_state(self, begin: np.ndarray | None) -> np.ndarray:
        """Return the first state (k), NaN where it is free, for the `begin` of a course."""
        if begin is None:
            return self.loaded
        state = self.rest.copy()
        known = min(len(state), len(begin)) if self.attitude else Q.start
        state[:known] = begin[:known]
        return state


def make_model(vehicle: Vehicle, kind: str, headroom: float = 0.0) -> Model:
    """Return the model of a vehicle.

    Args:
        vehicle: the vehicle file.
        kind: FULL_THRUST or AS_FLOWN.
        headroom: share of the motor commands that AS_FLOWN leaves to the rate loop.

    Raises:
        UsageError: a term is unknown or a coefficient is wrong.
    """
    return _full_thrust(vehicle) if kind == FULL_THRUST else _as_flown(vehicle, headroom)


def _full_thrust(vehicle: Vehicle) -> Model:
    rigid = replace(vehicle, terms={})
    parameters = parameters_from_vehicle(rigid, np.float64, np.asarray)
    count = len(vehicle.rotors)

    def drive_of(values):
        speeds = values[POSE:]
        return Drive(lambda time: speeds, speeds, parameters, {})

    def rates(*values):
        return _moving(values, drive_of(values))

    def observed(*values):
        drive = drive_of(values)
        return (*_specific_force(_body(values), drive, parameters), *drive.targets, vehicle.battery.reference_voltage)

    state, control, functions = _functions(POSE, count, {"rates": rates, "observed": observed})
    room = ca.Function("room", [state, control], [ca.SX(0, 1)])
    return _model(vehicle, functions | {"room": room}, 0, {}, {})


def _as_flown(vehicle: Vehicle, headroom: float) -> Model:
    parameters = parameters_from_vehicle(vehicle, np.float64, np.asarray)
    unbounded = replace(parameters.motors, min_speed=np.float64(0.0), max_speed=np.float64(np.inf))
    full = battery.start(parameters.battery, np.float64(0.0))
    pack_names = (*PACK, *sorted(full))
    count = len(vehicle.rotors)
    torque = parts(parameters.rotors.torque_coefficient)
    factors = registry.motor_factors({}, parameters)
    fastest = vehicle.rotor_speed_range[1]

    def load(values):
        """Return (pack by name, power W, voltage V, current A)."""
        pack = dict(zip(pack_names, values[POSE + count : POSE + count + len(pack_names)], strict=True))
        memory = {name: pack[name] for name in full}
        power = battery.power_of(values[POSE : POSE + count], torque, parameters.battery)
        charge, rc_voltage = (pack[name] for name in PACK)
        return pack, power, *battery.voltage_and_current(power, charge, rc_voltage, parameters.battery, memory)

    def drive_of(values):
        speeds, targets = values[POSE : POSE + count], values[POSE + count + len(pack_names) :]
        return Drive(lambda time: speeds, targets, parameters, {})

    def rates(*values):
        drive = drive_of(values)
        pack, power, _, current = load(values)

        def discharged(dt):
            charge, rc_voltage = battery.discharge(*(pack[name] for name in PACK), current, dt, parameters.battery)
            memory = {name: pack[name] for name in full}
            memory = battery.advance_memory(memory, power, current, dt, parameters.battery)
            return (charge, rc_voltage, *(memory[name] for name in sorted(full)))

        _, pack_rates = jax.jvp(discharged, (0.0,), (1.0,))
        turning = motors.accelerations(drive.speeds(0.0), drive.targets, parameters.motors)
        return (*_moving(values, drive), *turning, *pack_rates)

    def room(*values):
        _, _, voltage, _ = load(values)
        bounds = motors.steady_speeds((1.0 - headroom,) * count, voltage, unbounded)
        for factor in factors:
            bounds = tuple(one * bound for one, bound in zip(factor, bounds, strict=True))
        return tuple((bound - target) / fastest for bound, target in zip(bounds, drive_of(values).targets, strict=True))

    def observed(*values):
        drive = drive_of(values)
        _, _, voltage, _ = load(values)
        return (*_specific_force(_body(values), drive, parameters), *drive.speeds(0.0), voltage)

    hooks = {"rates": rates, "room": room, "observed": observed}
    _, _, functions = _functions(POSE + count + len(pack_names), count, hooks)
    at_rest = {name: float(full.get(name, 0.0)) for name in pack_names}
    return _model(vehicle, functions, count, at_rest, at_rest | _loaded_branches(vehicle.battery, parameters))


def _loaded_branches(described: Battery, parameters) -> dict[str, float]:
    """Return the voltages (V) of the full pack's RC branches after a long time at full command."""
    names = {"rc_voltage": described.rc_resistance}
    if described.rc2_resistance:
        names["rc2_voltage"] = described.rc2_resistance
    torque, current = parts(parameters.rotors.torque_coefficient), 0.0
    with jax.enable_x64(True):
        for _ in range(SETTLING):
            voltage = described.open_circuit_full - current * (described.resistance + sum(names.values()))
            speeds = motors.steady_speeds((1.0,) * len(torque), voltage, parameters.motors)
            current = float(battery.power_of(speeds, torque, parameters.battery)) / voltage
    return {name: current * resistance for name, resistance in names.items()}


def _model(vehicle: Vehicle, functions: dict, rotors: int, pack: dict[str, float], loaded: dict[str, float]) -> Model:
    """Return the model with the bounds that follow from the vehicle file.

    Args:
        vehicle: the vehicle file.
        functions: `rates`, `room` and `observed`.
        rotors: number of rotor speeds in the state; without them the controls are the rotors' speeds.
        pack, loaded: values of the pack's entries at rest and under load, by name.
    """
    count, (slowest, fastest) = len(vehicle.rotors), vehicle.rotor_speed_range
    if rotors:
        idle = 0.01 * float(vehicle.controller.get("motor_idle", 0.0))  # an armed flight controller stops no motor
        slowest = float(np.clip(vehicle.motor_speed(idle), slowest, fastest))
    pack_scale = np.array([SCALES[name] for name in pack])
    free, rates = np.full(Q.stop, np.inf), np.array(vehicle.rates.max)
    first = POSE + rotors  # entry of the pack
    return Model(
        **functions,
        scale=np.r_[np.full(6, 10.0), np.ones(4), np.full(3, 5.0), np.full(rotors, fastest), pack_scale],
        low=np.r_[-free, -rates, np.zeros(rotors), np.full(len(pack), -np.inf)],
        high=np.r_[free, rates, np.full(rotors, fastest), np.full(len(pack), np.inf)],
        control_scale=np.full(count, fastest),
        control_low=np.full(count, slowest),
        control_high=np.full(count, fastest),
        rest=np.r_[np.full(POSE, np.nan), np.full(rotors, slowest), list(pack.values())],
        loaded=np.r_[np.full(first, np.nan), list(loaded.values())],
        returning=np.r_[P, V, OMEGA, POSE:first],
    )


def _functions(size: int, count: int, hooks: dict[str, Callable]) -> tuple[ca.SX, ca.SX, dict[str, ca.Function]]:
    """Return symbols of state and control, and CasADi functions of both for functions of their scalars."""
    state, control = ca.SX.sym("state", size), ca.SX.sym("control", count)
    scalars = [*ca.vertsplit(state), *ca.vertsplit(control)]
    functions = {
        name: ca.Function(name, [state, control], [ca.cse(ca.vertcat(*symbolic(hook, scalars)))])
        for name, hook in hooks.items()
    }
    return state, control, functions


def _body(values) -> Body:
    """Return the body; a quaternion that collocation lengthens by its error must not scale the forces."""
    p, v, q, omega = (values[part] for part in (P, V, Q, OMEGA))
    return Body(Vector(*p), vectors.normalize(Quaternion(*q)), Vector(*v), Vector(*omega))


def _moving(values, drive: Drive) -> tuple:
    """Return the time derivative of position, velocity, attitude and body rates."""
    body = _body(values)
    v_rate, omega_rate, _ = drive.rates(body, 0.0)
    turn = Quaternion(*body.omega_body, jnp.zeros_like(body.omega_body.x))
    q_rate = (0.5 * part for part in vectors.multiply(Quaternion(*values[Q]), turn))
    return (*body.v_world, *v_rate, *q_rate, *omega_rate)


def _specific_force(body: Body, drive: Drive, parameters) -> Vector:
    """Return the acceleration without gravity in the body frame, m/s^2: what an ideal accelerometer measures."""
    v_rate, _, _ = drive.rates(body, 0.0)
    return rotate_inverse(body.q_world_body, v_rate._replace(z=v_rate.z + parameters.gravity))
