"""A damaged propeller: less thrust, and an imbalance that shakes the airframe once a revolution."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from swift_sim_bridge.physics.terms.vectors import COSINE, SINE, ZERO, Vector, cross, kept, series, total


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DamagedPropeller:
    """rotor: its number, from 1 in motor order; loss: share of its thrust, 0.02..0.2; imbalance: kg m, mass times
    eccentricity, 0..5e-6 (0.1 g of blade lost at 5 cm)."""

    rotor: int
    loss: float
    imbalance: float = 0.0


def exists(coefficients, vehicle):
    """Raise ValueError when the vehicle has no such rotor."""
    if not 1 <= coefficients.rotor <= len(vehicle.rotors):
        raise ValueError(f"must name a 'rotor' from 1 to {len(vehicle.rotors)}, not {coefficients.rotor}")


def _chosen(coefficients, count):
    """Return n shares (...): 1 for the damaged rotor, 0 for the others."""
    return tuple(jnp.where(coefficients.rotor == i + 1, 1.0, 0.0) for i in range(count))


def weaken(parameters, coefficients):
    """Return the parameters with the rotor's thrust coefficient less by `loss`; its torque coefficient stays."""
    rotors = parameters.rotors
    chosen = coefficients.rotor[..., None] == np.arange(1, rotors.spin.shape[-1] + 1)
    weaker = rotors.thrust_coefficient * (1.0 - coefficients.loss[..., None] * chosen)
    return replace(parameters, rotors=replace(rotors, thrust_coefficient=weaker))


def start(coefficients, zero, normal, count):
    """Return a blade that points forward and does not shake yet."""
    return {"cosine": zero + 1.0, "sine": zero, "force_x": zero, "force_y": zero}


def advance(remembered, passed, coefficients, parameters):
    """Return the blade's direction a step later, and the imbalance's mean force (N, body) over that step.

    Force m e Omega^2 along the blade, integrated over the turn: its impulse is right also where a step is longer than a
    revolution; what an accelerometer makes of it between two steps is not told.
    """
    instant = passed.instant
    chosen = _chosen(coefficients, len(instant.rotor_speed))
    turn_rate = total(
        one * spin * speed for one, spin, speed in zip(chosen, instant.hubs.spin, instant.rotor_speed, strict=True)
    )
    sine, cosine = kept(_sine_and_cosine(turn_rate * passed.dt), parameters)
    was_cosine, was_sine = remembered["cosine"], remembered["sine"]
    now_cosine, now_sine = was_cosine * cosine - was_sine * sine, was_cosine * sine + was_sine * cosine
    one = 1.5 - 0.5 * (now_cosine * now_cosine + now_sine * now_sine)  # keeps the direction's length at one
    now_cosine, now_sine = one * now_cosine, one * now_sine
    momentum = coefficients.imbalance * turn_rate / passed.dt
    force_x, force_y = momentum * (now_sine - was_sine), momentum * (was_cosine - now_cosine)
    return {"cosine": now_cosine, "sine": now_sine, "force_x": force_x, "force_y": force_y}


def _sine_and_cosine(angle):
    """Return (sine, cosine), right to 1e-8 within a turn: the series of an eighth of it, doubled thrice."""
    eighth = 0.125 * angle
    squared = eighth * eighth
    sine, cosine = eighth * series(squared, SINE[:6]), series(squared, COSINE[:6])
    for _ in range(3):
        sine, cosine = 2.0 * sine * cosine, 1.0 - 2.0 * sine * sine
    return sine, cosine


def shake(instant, coefficients, parameters):
    """Return the wrench of the imbalance's force at the damaged rotor's hub, held through a step."""
    remembered = instant.memory.get("damaged_propeller")
    if not remembered:
        return ZERO, ZERO
    chosen = _chosen(coefficients, len(instant.rotor_speed))
    hub = Vector(*(total(one * r[i] for one, r in zip(chosen, instant.hubs.position, strict=True)) for i in range(3)))
    force = Vector(remembered["force_x"], remembered["force_y"])
    return force, cross(hub, force)
