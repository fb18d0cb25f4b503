"""The battery under the load of its rotors, and the motors that it supplies: a replay without a measured voltage."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from swift_sim_bridge.physics import battery, motors
from swift_sim_bridge.physics.terms import registry
from swift_sim_bridge.physics.terms.quantities import Load
from swift_sim_bridge.physics.terms.vectors import stack


class _Pack(NamedTuple):
    """The state of the battery.

    Attributes:
        charge: A s delivered.
        rc_voltage: V.
        remembered: other states, see `battery.start`.
    """

    charge: jax.Array
    rc_voltage: jax.Array
    remembered: dict


def _initial_pack(parameters, used) -> _Pack:
    """Return the battery after a delivered charge (A s), at rest."""
    return _Pack(used, jnp.zeros_like(used), battery.start(parameters.battery, jnp.zeros_like(used)))


def _pack_step(parameters, pack: _Pack, speed, dt) -> tuple[_Pack, tuple]:
    """Return the battery after dt s under rotors at these speeds (r,), and its voltage and current before."""
    power_w = battery.power(speed, parameters.rotors.torque_coefficient, parameters.battery)
    voltage, current = battery.voltage_and_current(
        power_w, pack.charge, pack.rc_voltage, parameters.battery, pack.remembered
    )
    added = registry.supply_voltage(Load(current, pack.charge, tuple(speed)), parameters)
    voltage, current = battery.with_added_voltage(voltage, current, power_w, added)
    charge, rc_voltage = battery.discharge(pack.charge, pack.rc_voltage, current, dt, parameters.battery)
    remembered = battery.advance_memory(pack.remembered, power_w, current, dt, parameters.battery)
    return _Pack(charge, rc_voltage, remembered), (voltage, current)


@jax.jit
def discharged(parameters, used, inputs):
    """Return voltage V and current A (n,) of a battery that has delivered `used` A s.

    Args:
        parameters: of one vehicle.
        used: A s.
        inputs: durations (n,) s and rotor speeds (n, r) rad/s.
    """

    def step(pack, now):
        dt, speed = now
        return _pack_step(parameters, pack, speed, dt)

    return jax.lax.scan(step, _initial_pack(parameters, jnp.asarray(used)), inputs)[1]


@jax.jit
def driven(parameters, first, used, inputs):
    """Return rotor speeds (n, r) rad/s, voltage V and current A (n,) under motor commands.

    Args:
        parameters: of one vehicle.
        first: (r,) rad/s at the start.
        used: A s that the battery has delivered.
        inputs: durations (n,) s and motor commands (n, r).
    """
    factor = jnp.ones_like(first)
    for factors in registry.motor_factors({}, parameters):
        factor = factor * stack(factors)

    def step(state, now):
        speed, pack = state
        dt, command = now
        pack, (voltage, current) = _pack_step(parameters, pack, speed, dt)
        target = factor * motors.steady_speed(command, voltage, parameters.motors)
        target = target + stack(registry.added_speeds(tuple(speed), tuple(command), voltage, parameters), like=voltage)
        after_lag = stack(motors.lag(tuple(speed), tuple(target), dt, parameters.motors))
        return (after_lag, pack), (speed, voltage, current)

    return jax.lax.scan(step, (first, _initial_pack(parameters, jnp.asarray(used))), inputs)[1]


@jax.jit
def driven_from_full(parameters, first, inputs):
    """Return rotor speeds (n, b, r) rad/s of b vehicles, whose batteries are full at the start; see `driven`."""
    speeds = jax.vmap(lambda one: driven(one, first, jnp.zeros_like(one.mass), inputs)[0])(parameters)
    return jnp.moveaxis(speeds, 0, 1)
