"""State and parameters of the vehicle: pytrees whose leaves are arrays.

Every leaf may have leading batch dimensions: states are batched and parameters are randomised in the same way.
"""

from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.physics import battery
from swift_sim_bridge.physics.terms import registry
from swift_sim_bridge.physics.terms.vectors import parts, quaternion, stack, vector

BATTERY = "battery"  # key of the pack in the state's memory


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class State:
    """A moving quadrotor (Methods, eq. 1) with its battery.

    Attributes:
        p_world: (..., 3) m.
        q_world_body: (..., 4), x y z w.
        v_world: (..., 3) m/s.
        omega_body: (..., 3) rad/s.
        rotor_speed: (..., n) rad/s.
        charge: (...) A s drawn from the full pack.
        rc_voltage: (...) V over the RC branch.
        memory: memory of the terms by name, see `start_memory`; empty where no term has one.
    """

    p_world: jax.Array
    q_world_body: jax.Array
    v_world: jax.Array
    omega_body: jax.Array
    rotor_speed: jax.Array
    charge: jax.Array
    rc_voltage: jax.Array
    memory: dict[str, Any] = field(default_factory=dict)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Rotors:
    """The rotors.

    Attributes:
        position: (..., n, 3) m from the centre of mass.
        spin: (..., n), +1 counter-clockwise seen from above.
        thrust_coefficient: (..., n) N s^2/rad^2.
        torque_coefficient: (..., n) N m s^2/rad^2.
        radius: (...) m.
    """

    position: jax.Array
    spin: jax.Array
    thrust_coefficient: jax.Array
    torque_coefficient: jax.Array
    radius: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Motors:
    """The motors.

    Attributes:
        time_constant_up: (...) s while speeding up.
        time_constant_down: (...) s while slowing down.
        map_coefficients: (..., 5), c0 to c4 of `swift_ros.vehicle.MotorMap`.
        min_speed: (...) rad/s at any command above 0.
        max_speed: (...) rad/s.
    """

    time_constant_up: jax.Array
    time_constant_down: jax.Array
    map_coefficients: jax.Array
    min_speed: jax.Array
    max_speed: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Battery:
    """The section `battery` of the vehicle file: every value (...), the curve (..., k); None is not simulated."""

    open_circuit_full: jax.Array
    open_circuit_slope: jax.Array
    capacity: jax.Array
    resistance: jax.Array
    rc_resistance: jax.Array
    rc_time: jax.Array
    efficiency: jax.Array
    avionics_w: jax.Array
    open_circuit_curve: jax.Array | None = None
    rc2_resistance: jax.Array | None = None
    rc2_time: jax.Array | None = None
    energy: jax.Array | None = None
    temperature: jax.Array | None = None
    temperature_slope: jax.Array | None = None
    heat_capacity: jax.Array | None = None


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Parameters:
    """A vehicle.

    Attributes:
        mass: (...) kg.
        inertia: (..., 3, 3) kg m^2.
        inertia_inverse: (..., 3, 3) 1/(kg m^2).
        gravity: (...) m/s^2.
        hull_radius: (...) m, of the disc that touches ground and gates.
        hull_height: (...) m.
        rotors: of the vehicle.
        motors: of the vehicle.
        battery: of the vehicle.
        terms: coefficients by name of term (see `terms.registry.PHYSICS`); an absent term is not simulated.
    """

    mass: jax.Array
    inertia: jax.Array
    inertia_inverse: jax.Array
    gravity: jax.Array
    hull_radius: jax.Array
    hull_height: jax.Array
    rotors: Rotors
    motors: Motors
    battery: Battery
    terms: dict[str, Any]


def parameters_from_vehicle(vehicle: Vehicle, dtype=None, asarray=jnp.asarray) -> Parameters:
    """Return the unbatched parameters of a vehicle file.

    Args:
        vehicle: the vehicle file.
        dtype: of the arrays; JAX's default where None.
        asarray: makes the arrays; NumPy's is faster where many vehicles are built.

    Raises:
        UsageError: a term is unknown, or a coefficient is wrong.
    """
    count = len(vehicle.rotors)
    described: Any = vehicle  # its numbers become arrays below
    parameters = Parameters(
        mass=described.mass,
        inertia=described.inertia_matrix,
        inertia_inverse=_leaf(np.linalg.inv(vehicle.inertia_matrix)),
        gravity=_leaf(GRAVITY),
        hull_radius=described.hull_radius,
        hull_height=described.hull_height,
        rotors=Rotors(
            position=_leaf(np.array([rotor.position for rotor in vehicle.rotors])),
            spin=_leaf(np.array([rotor.spin for rotor in vehicle.rotors], dtype=float)),
            thrust_coefficient=_leaf(np.full(count, vehicle.thrust_coefficient)),
            torque_coefficient=_leaf(np.full(count, vehicle.torque_coefficient)),
            radius=described.rotor_radius,
        ),
        motors=Motors(
            time_constant_up=described.motor.time_constant_up,
            time_constant_down=described.motor.time_constant_down,
            map_coefficients=_leaf(np.array(vehicle.motor.map.coefficients)),
            min_speed=described.rotor_speed_range[0],
            max_speed=described.rotor_speed_range[1],
        ),
        battery=_battery(vehicle.battery),
        terms=registry.coefficients_from_vehicle(vehicle),
    )
    parameters = jax.tree.map(lambda leaf: asarray(leaf, dtype=dtype or jnp.result_type(float)), parameters)
    return registry.with_airframe(parameters)


def _leaf(value) -> Any:
    """Return a value that the last step of `parameters_from_vehicle` converts into an array of its kind."""
    return value


def _battery(described) -> Battery:
    """Return the pack of a vehicle file; optional keys that are zero or empty become None."""
    values = {name: getattr(described, name) for name in Battery.__dataclass_fields__}
    for name in ("open_circuit_curve", "rc2_resistance", "rc2_time", "energy", "temperature_slope", "heat_capacity"):
        values[name] = np.array(values[name]) if values[name] else None
    return Battery(**values)


def state_at_rest(p_world, q_world_body, rotors: int = 4, parameters: Parameters | None = None, key=None) -> State:
    """Return the state of a vehicle at rest with a full, rested pack.

    Args:
        p_world: (..., 3) m.
        q_world_body: (..., 4).
        rotors: number of rotors.
        parameters: of the vehicle; needed where its terms have a memory.
        key: JAX key of the terms' random numbers; a fixed one where None.
    """
    p_world, q_world_body = jnp.asarray(p_world), jnp.asarray(q_world_body)
    zero = jnp.zeros_like(p_world[..., 0])
    return State(
        p_world=p_world,
        q_world_body=q_world_body.astype(p_world.dtype),
        v_world=jnp.zeros_like(p_world),
        omega_body=jnp.zeros_like(p_world),
        rotor_speed=jnp.broadcast_to(zero[..., None], (*zero.shape, rotors)),
        charge=zero,
        rc_voltage=zero,
        memory={} if parameters is None else start_memory(parameters, zero, key),
    )


def start_memory(parameters: Parameters, like, key=None) -> dict:
    """Return the first memory of the vehicle's terms and of its pack, in arrays shaped as `like` (...)."""
    memory = registry.start_memory(parameters, like, key)
    pack = battery.start(parameters.battery, jnp.zeros_like(like))
    return memory | {BATTERY: pack} if pack else memory


def unstacked(state: State) -> State:
    """Return the state by components: Vectors, a Quaternion, a tuple of rotor speeds."""
    return replace(
        state,
        p_world=vector(state.p_world),
        q_world_body=quaternion(state.q_world_body),
        v_world=vector(state.v_world),
        omega_body=vector(state.omega_body),
        rotor_speed=parts(state.rotor_speed),
    )


def stacked(state: State) -> State:
    """Return a state by components as arrays."""
    names = ("p_world", "q_world_body", "v_world", "omega_body", "rotor_speed")
    return replace(state, **{name: stack(getattr(state, name)) for name in names})
