"""Conversion between the four outputs of the actor and commands, for training and flight."""

from array_api_compat import array_namespace


def clip(raw):
    """Return the action: raw outputs (..., 4) of the actor, clipped to [-1, 1]."""
    xp = array_namespace(raw)
    return xp.clip(raw, -1.0, 1.0)


def to_command(action, max_thrust: float, max_rates):
    """Return thrust (...) m/s^2 and omega_body (..., 3) rad/s of an action.

    Args:
        action: (..., 4), in [-1, 1].
        max_thrust: mass-normalised collective thrust at action +1, m/s^2; it is zero at -1.
        max_rates: body rates (3,) at action 1, rad/s.
    """
    xp = array_namespace(action)
    thrust = 0.5 * (action[..., 0] + 1.0) * max_thrust
    return thrust, action[..., 1:] * xp.asarray(max_rates, dtype=action.dtype)


def from_command(thrust, omega_body, max_thrust: float, max_rates):
    """Return the action (..., 4) of a command: the inverse of `to_command`."""
    xp = array_namespace(omega_body)
    rates = omega_body / xp.asarray(max_rates, dtype=omega_body.dtype)
    return xp.concat([(2.0 * thrust / max_thrust - 1.0)[..., None], rates], axis=-1)
