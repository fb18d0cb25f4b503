"""The rate loop's profile from a vehicle file."""

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller.configuration import dump_profile
from swift_sim_bridge.flight_controller.configuration.controller_section import (
    ControllerKeys,
    DumpedController,
    controller_from_vehicle,
)
from swift_sim_bridge.flight_controller.rate_loop import filters
from swift_sim_bridge.flight_controller.rate_loop.profile import RateLoopProfile


def profile_from_vehicle(vehicle: Vehicle, dtype=None) -> RateLoopProfile:
    """Return the unbatched profile of a vehicle file. Raises UsageError as `controller_from_vehicle`."""
    controller = controller_from_vehicle(vehicle)
    dumped = isinstance(controller, DumpedController)
    profile = dump_profile.profile_from_dump(controller) if dumped else _profile_from_keys(controller)
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype=dtype or jnp.result_type(float)), profile)


def _profile_from_keys(controller: ControllerKeys) -> RateLoopProfile:
    """Return the profile of the `controller` keys: a loop without optional terms."""
    gains = np.array([controller.pid.roll, controller.pid.pitch, controller.pid.yaw]).T
    windup_free = 1.0 - controller.iterm_windup / 100.0
    return RateLoopProfile(
        kp=gains[0] * dump_profile.PTERM_SCALE,
        ki=dump_profile.integral_gains(gains[1]),
        kd=gains[2] * dump_profile.DTERM_SCALE,
        gyro_filters=(filters.Lowpass(controller.gyro_lpf1_static_hz),),
        dterm_filters=tuple(
            filters.Lowpass(hz) for hz in (controller.dterm_lpf1_static_hz, controller.dterm_lpf2_static_hz)
        ),
        iterm_limit=controller.iterm_limit,
        iterm_relax_cutoff_hz=controller.iterm_relax_cutoff,
        windup_inverse=1.0 / windup_free if windup_free > 0 else 1e6,
        pidsum_limit=np.array([controller.pidsum_limit, controller.pidsum_limit, controller.pidsum_limit_yaw]),
        motor_idle=controller.motor_idle / 100.0,
        yaw_direction=1.0 if controller.yaw_motors_reversed else -1.0,
        loop_hz=controller.loop_hz,
        serial_phase_s=controller.serial_phase_s,
    )
