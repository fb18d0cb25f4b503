"""What the actor's four outputs mean, shared by training and flight."""

from array_api_compat import array_namespace


def clip(raw):
    """Return the actor's raw outputs (..., 4) clipped to [-1, 1]: the action that is applied and observed next."""
    xp = array_namespace(raw)
    return xp.clip(raw, -1.0, 1.0)


def to_command(action, max_thrust: float, max_rates):
    """Return (thrust (...) m/s^2, omega_body (..., 3) rad/s) of clipped actions (..., 4).

    max_thrust: m/s^2, mass-normalised collective at action +1 (zero at -1); max_rates: (3,) rad/s at action 1.
    """
    xp = array_namespace(action)
    thrust = 0.5 * (action[..., 0] + 1.0) * max_thrust
    return thrust, action[..., 1:] * xp.asarray(max_rates, dtype=action.dtype)


def from_command(thrust, omega_body, max_thrust: float, max_rates):
    """Return the action (..., 4) whose command this is, the inverse of `to_command`."""
    xp = array_namespace(omega_body)
    rates = omega_body / xp.asarray(max_rates, dtype=omega_body.dtype)
    return xp.concat([(2.0 * thrust / max_thrust - 1.0)[..., None], rates], axis=-1)
