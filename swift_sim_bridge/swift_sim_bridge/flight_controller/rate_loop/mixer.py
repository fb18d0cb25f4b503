"""The firmware's mixer for a quad X: axis demands and throttle to motor commands (Betaflight 4.5, mixer.c).

Motors 1-4: rear right, front right, rear left, front left. At saturation body rates have priority over throttle.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

PID_MIXER_SCALING = 1000.0  # PID units of the full motor range
MIX = np.array([[-1.0, -1.0, 1.0, 1.0], [1.0, -1.0, 1.0, -1.0], [-1.0, 1.0, 1.0, -1.0]])  # roll, pitch, yaw of quad X
TYPES = ("LEGACY", "LINEAR", "DYNAMIC")  # the fourth, EZLANDING, is not simulated
CELL_FULL_V = 4.2  # sensors/battery.h, CELL_VOLTAGE_FULL_CV


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SagCompensation:
    """Compensation of battery sag.

    Attributes:
        share: (...), 0 to 1.5, of the full compensation.
        low_cell_v: (...) V per cell at which it ends.
        cells: (...), number of cells in series.
        lowpass_hz: (...) Hz of the low-pass on the voltage.
    """

    share: jax.Array
    low_cell_v: jax.Array
    cells: jax.Array
    lowpass_hz: jax.Array


def range_lost_to_sag(voltage, term: SagCompensation):
    """Return the share (...) of the motors' range that is not used at a pack voltage (...) V.

    A full pack then flies as an empty one (`calculateThrottleAndCurrentMotorEndpoints`).
    """
    span_v = CELL_FULL_V - term.low_cell_v
    fullness = 1.0 - jnp.clip((CELL_FULL_V - voltage / term.cells) / span_v, 0.0, 1.0)
    return span_v / CELL_FULL_V * fullness * term.share


def mix(pid_sum, throttle, profile, range_lost=None):
    """Mix axis demands and throttle.

    With airmode, motor differences are scaled only when their range exceeds that of the motors, and the throttle is
    shifted into the range that they leave.

    Args:
        pid_sum: (..., 3) PID units.
        throttle: (...), 0 to 1.
        profile: profile of the loop.
        range_lost: (...), share of the motors' range that voltage compensation takes from the top; None for none.

    Returns:
        (motor_command (..., 4) in 0..1, range (...) of the differences).
    """
    demand = jnp.clip(pid_sum, -profile.pidsum_limit, profile.pidsum_limit) / PID_MIXER_SCALING
    roll, pitch, yaw = (demand[..., i, None] for i in range(3))
    roll_mix, pitch_mix, yaw_mix = (jnp.asarray(row, dtype=demand.dtype) for row in MIX)
    differences = roll * roll_mix + pitch * pitch_mix + profile.yaw_direction[..., None] * yaw * yaw_mix
    low, high = jnp.min(differences, axis=-1), jnp.max(differences, axis=-1)
    mix_range = high - low
    scale = 1.0 / jnp.maximum(mix_range, 1.0)
    if profile.airmode is not None and not profile.airmode.enabled:
        scale = scale * jnp.where(throttle < 0.5, 0.5 + throttle, 1.0)
    if profile.mixer_type == "LEGACY":
        output = differences * scale[..., None]
        throttle = jnp.clip(throttle, -low * scale, 1.0 - high * scale)
    else:
        output = _shifted_by_throttle(differences, throttle, mix_range, profile) * scale[..., None]
        low, high = jnp.min(output, axis=-1), jnp.maximum(jnp.max(output, axis=-1), 0.0)
        throttle = jnp.maximum(jnp.minimum(throttle, 1.0 - high), -low)  # the lower bound has priority
    return _motor_command(output + throttle[..., None], profile, range_lost), mix_range


def _shifted_by_throttle(differences, throttle, mix_range, profile):
    """Return differences (..., 4) that only add at zero throttle and only subtract at full (`..AdjustmentLinear`)."""
    if profile.mixer_type == "DYNAMIC":
        reach = jnp.abs(differences)
    else:
        reach = 0.5 * mix_range[..., None]
        if profile.airmode is not None and not profile.airmode.enabled:
            reach = reach * jnp.where(throttle < 0.5, 0.5 + throttle, 1.0)[..., None]
    return differences + reach * (1.0 - 2.0 * throttle[..., None])


def _motor_command(output, profile, range_lost):
    """Return (..., 4) in 0..1, from idle to the top that limit and compensation leave (`applyMixToMotors`)."""
    if profile.thrust_linear is not None:
        output = output * (1.0 + profile.thrust_linear.amount[..., None] * (1.0 - output) ** 2)
    idle = profile.motor_idle[..., None]
    span = 1.0 - idle
    if profile.motor_output_limit is not None:
        span = span * profile.motor_output_limit[..., None]
    if range_lost is not None:
        span = span * (1.0 - range_lost[..., None])
    return idle + span * jnp.clip(output, 0.0, 1.0)
