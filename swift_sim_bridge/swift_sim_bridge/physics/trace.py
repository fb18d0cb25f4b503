"""The record of a simulated flight: the motion and what drives it at the end of each step."""

from dataclasses import dataclass

import jax

from swift_sim_bridge.physics.contact import Contact


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Trace:
    """Values at the end of each step, with a leading axis of steps: the sub-steps of a tick, or a whole flight.

    Attributes:
        p_world: (..., 3) m.
        q_world_body: (..., 4), x y z w.
        v_world: (..., 3) m/s.
        omega_body: (..., 3) rad/s.
        specific_force_body: (..., 3) m/s^2, mean over the step of what an ideal accelerometer at the centre of mass
            measures: +9.81 on z at rest.
        rotor_speed: (..., n) rad/s.
        motor_command: (..., n), 0 to 1, held through the step.
        voltage: (...) V of the pack.
        current: (...) A from the pack.
        contact: contact with ground, podium and gates; None where it is not recorded.
    """

    p_world: jax.Array
    q_world_body: jax.Array
    v_world: jax.Array
    omega_body: jax.Array
    specific_force_body: jax.Array
    rotor_speed: jax.Array
    motor_command: jax.Array
    voltage: jax.Array
    current: jax.Array
    contact: Contact | None = None
