"""The effects that a vehicle file switches on: one entry of its `terms` each, absent ones are not simulated.

A term is a dataclass of its coefficients (which mirrors the file's entry) and a function of the motion that returns
its wrench. One more effect is one more function in the file where it belongs and one more row here.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np

from swift_ros.configuration import build
from swift_ros.errors import UsageError
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.physics import aerodynamics, rotors
from swift_sim_bridge.sensors.terms import SENSOR_TERMS


class Motion(NamedTuple):
    """What a term sees. v_body (..., 3) m/s: through the air; rotor_acceleration (..., n) rad/s^2; rest as `State`."""

    p_world: jax.Array
    q_world_body: jax.Array
    v_body: jax.Array
    omega_body: jax.Array
    rotor_speed: jax.Array
    rotor_acceleration: jax.Array


@dataclass(frozen=True)
class Term:
    """coefficients: dataclass of the file's entry; wrench(motion, coefficients, parameters) -> force, moment (body)."""

    coefficients: type
    wrench: Callable


WRENCHES = {
    "rotor_drag": Term(aerodynamics.RotorDrag, aerodynamics.rotor_drag),
    "body_drag": Term(aerodynamics.BodyDrag, aerodynamics.body_drag),
    "rotor_gyroscopic": Term(rotors.RotorGyroscopic, rotors.gyroscopic),
}


def coefficients_from_vehicle(vehicle: Vehicle) -> dict:
    """Return the coefficients by name of the vehicle's terms but its sensors' (see `sensors.terms`).

    Raises UsageError for an unknown name or coefficient.
    """
    for name in vehicle.terms:
        if name not in WRENCHES and name not in SENSOR_TERMS:
            known = ", ".join([*WRENCHES, *SENSOR_TERMS])
            raise UsageError(f"the vehicle '{vehicle.name}' has the unknown term '{name}' in terms; known are {known}")
    built = {
        name: build(WRENCHES[name].coefficients, entry, f"the vehicle '{vehicle.name}', terms.{name}")
        for name, entry in vehicle.terms.items()
        if name in WRENCHES
    }
    return jax.tree.map(np.asarray, built, is_leaf=lambda leaf: isinstance(leaf, tuple))


def wrench(motion: Motion, parameters):
    """Return (force_body, moment_body) (..., 3) of thrust and of every term that the parameters switch on."""
    force, moment = rotors.thrust_wrench(motion, parameters.rotors)
    for name, coefficients in parameters.terms.items():
        term_force, term_moment = WRENCHES[name].wrench(motion, coefficients, parameters)
        force, moment = force + term_force, moment + term_moment
    return force, moment
