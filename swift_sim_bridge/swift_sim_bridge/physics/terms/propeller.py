"""A damaged propeller: less thrust, and an imbalance that shakes the airframe once per revolution."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from swift_sim_bridge.effects import FORCE_CHANNELS, Effect, scalar_parameter
from swift_sim_bridge.physics.terms.term import Term
from swift_sim_bridge.physics.terms.vectors import COSINE, SINE, ZERO, Vector, cross, kept, series, total


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DamagedPropeller:
    """Damage of one propeller.

    Attributes:
        rotor: number of the rotor, from 1 in motor order.
        loss: share of its thrust that is lost, 0.02 to 0.2.
        imbalance: kg m, mass times eccentricity, 0 to 5e-6 (0.1 g of blade lost at 5 cm).
    """

    rotor: int
    loss: float
    imbalance: float = 0.0


def rotor_exists(coefficients, vehicle):
    """Raise ValueError when the vehicle has no such rotor."""
    if not 1 <= coefficients.rotor <= len(vehicle.rotors):
        raise ValueError(f"must name a 'rotor' from 1 to {len(vehicle.rotors)}, not {coefficients.rotor}")


def _is_damaged(coefficients, count):
    """Return n factors (...): 1 for the damaged rotor, 0 for the others."""
    return tuple(jnp.where(coefficients.rotor == i + 1, 1.0, 0.0) for i in range(count))


def weaken(parameters, coefficients):
    """Return the parameters with the rotor's thrust coefficient reduced by `loss`; its torque coefficient stays."""
    rotors = parameters.rotors
    damaged = coefficients.rotor[..., None] == np.arange(1, rotors.spin.shape[-1] + 1)
    weaker = rotors.thrust_coefficient * (1.0 - coefficients.loss[..., None] * damaged)
    return replace(parameters, rotors=replace(rotors, thrust_coefficient=weaker))


def start(coefficients, zero, normal, count):
    """Return a blade that points forward, without force."""
    return {"cosine": zero + 1.0, "sine": zero, "force_x": zero, "force_y": zero}


def advance(memory, step, coefficients, parameters):
    """Return the blade's direction after a step, and the imbalance's mean force (N, body) over that step.

    The force m e Omega^2 along the blade is integrated over the rotation: its impulse is correct also when a step is
    longer than a revolution. The vibration within a step is not resolved.
    """
    instant = step.instant
    damaged = _is_damaged(coefficients, len(instant.rotor_speed))
    turn_rate = total(
        share * spin * speed for share, spin, speed in zip(damaged, instant.hubs.spin, instant.rotor_speed, strict=True)
    )
    sine, cosine = kept(_sine_and_cosine(turn_rate * step.dt), parameters)
    was_cosine, was_sine = memory["cosine"], memory["sine"]
    now_cosine, now_sine = was_cosine * cosine - was_sine * sine, was_cosine * sine + was_sine * cosine
    factor = 1.5 - 0.5 * (now_cosine * now_cosine + now_sine * now_sine)  # keeps the direction a unit vector
    now_cosine, now_sine = factor * now_cosine, factor * now_sine
    momentum = coefficients.imbalance * turn_rate / step.dt
    force_x, force_y = momentum * (now_sine - was_sine), momentum * (was_cosine - now_cosine)
    return {"cosine": now_cosine, "sine": now_sine, "force_x": force_x, "force_y": force_y}


def _sine_and_cosine(angle):
    """Return (sine, cosine), exact to 1e-8 within a revolution: series of an eighth of it, doubled three times."""
    eighth = 0.125 * angle
    squared = eighth * eighth
    sine, cosine = eighth * series(squared, SINE[:6]), series(squared, COSINE[:6])
    for _ in range(3):
        sine, cosine = 2.0 * sine * cosine, 1.0 - 2.0 * sine * sine
    return sine, cosine


def shake(instant, coefficients, parameters):
    """Return the wrench of the imbalance's force at the damaged rotor's hub, constant during a step."""
    memory = instant.memory.get("damaged_propeller")
    if not memory:
        return ZERO, ZERO
    damaged = _is_damaged(coefficients, len(instant.rotor_speed))
    hub = Vector(
        *(total(share * r[i] for share, r in zip(damaged, instant.hubs.position, strict=True)) for i in range(3))
    )
    force = Vector(memory["force_x"], memory["force_y"])
    return force, cross(hub, force)


def damage_effects(vehicle, gates):
    """Return one effect for each rotor."""
    return tuple(
        Effect(
            id="damaged_propeller",
            layer="force",
            parameters=(scalar_parameter("loss", "", "damaged_propeller", step=0.005, low=0.0, high=0.6),),
            equation="T_i (1 - loss)",
            sentence=f"propeller {number} gives {{loss:.2%}} less thrust",
            manoeuvre="throttle punches with yaw steps",
            channels=(*FORCE_CHANNELS, "single_rotor_speeds"),
            idle={"damaged_propeller": {"rotor": number, "loss": 0.0}},
            part="rotor",
            variant=str(number),
        )
        for number in range(1, len(vehicle.rotors) + 1)
    )


TERMS = {
    "damaged_propeller": Term(
        DamagedPropeller,
        airframe=weaken,
        wrench=shake,
        start=start,
        advance=advance,
        check=rotor_exists,
        idle={"rotor": 1, "loss": 0.0},
        example={"rotor": 2, "loss": 0.1, "imbalance": 2e-6},
        effects=damage_effects,
        units={"rotor": "", "imbalance": "kg m"},
    ),
}
