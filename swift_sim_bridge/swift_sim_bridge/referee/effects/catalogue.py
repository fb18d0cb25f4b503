"""The effects that the gap tool knows by name: layer, sizes, how each is planted, and the terms of its equation.

The size of an effect is one number in its `unit`. The detectable size is what the analysis of a 30 s race might show,
the largest size what is plausible for a vehicle in bad condition or badly described; both are chosen by hand.
"""

from swift_sim_bridge.referee.effects import planting, quantities
from swift_sim_bridge.referee.effects.effect import Effect
from swift_sim_bridge.referee.effects.planting import added, one_axis, random_direction, scaled
from swift_sim_bridge.referee.effects.quantities import (
    ACCELEROMETERS,
    ANGULAR_ACCELERATION,
    SPECIFIC_FORCE,
    along_axes,
    cross_product,
    on_any_axis,
    on_channel,
    on_large_axes,
)

EFFECTS = {
    "mass": Effect(
        "force", 0.01, 0.15, "share", scaled("mass"), on_any_axis(along_axes(SPECIFIC_FORCE, quantities.specific_force))
    ),
    "inertia": Effect(
        "moment",
        0.06,
        0.5,
        "share",
        planting.inertia,
        on_large_axes(along_axes(ANGULAR_ACCELERATION, quantities.torque), quantities.inertia_coupling),
    ),
    "com_offset": Effect(
        "moment",
        3e-4,
        8e-3,
        "m",
        random_direction("terms", "com_offset", "position", axes=(1.0, 1.0, 0.0)),
        on_large_axes(cross_product(ANGULAR_ACCELERATION, quantities.specific_force)),
    ),
    "payload": Effect(
        "force",
        0.01,
        0.1,
        "kg",
        planting.payload,
        on_any_axis(
            along_axes(SPECIFIC_FORCE, quantities.specific_force),
            cross_product(ANGULAR_ACCELERATION, quantities.specific_force),
            along_axes(ANGULAR_ACCELERATION, quantities.torque),
        ),
        acts_on_moment=True,
    ),
    "thrust_axis_tilt": Effect(
        "force",
        0.003,
        0.05,
        "rad",
        random_direction("terms", "thrust_axis_tilt", "tilt", axes=(1.0, 1.0)),
        on_large_axes(cross_product(SPECIFIC_FORCE, quantities.thrust)),
    ),
    "thrust_coefficient": Effect(
        "force",
        0.01,
        0.15,
        "share",
        scaled("thrust_coefficient"),
        on_any_axis(
            along_axes(SPECIFIC_FORCE, quantities.thrust), along_axes(ANGULAR_ACCELERATION, quantities.torque, "xy")
        ),
        acts_on_moment=True,
    ),
    "torque_coefficient": Effect(
        "moment",
        0.04,
        0.3,
        "share",
        scaled("torque_coefficient"),
        on_any_axis(
            along_axes(ANGULAR_ACCELERATION, quantities.torque, "z"),
            on_channel(quantities.POWER, quantities.ELECTRICAL_LOAD),
        ),
    ),
    "motor_time_constant": Effect(
        "motor",
        0.03,
        0.4,
        "share",
        planting.motor_lag,
        on_any_axis(on_channel(quantities.ROTOR_SPEED, quantities.SPEED_CHANGE)),
    ),
    "motor_asymmetry": Effect(
        "motor",
        1.5e-3,
        0.02,
        "s",
        added("motor", "time_constant_down"),
        on_any_axis(on_channel(quantities.ROTOR_SPEED, quantities.SPEED_CHANGE)),
    ),
    "motor_map": Effect(
        "motor",
        0.008,
        0.08,
        "share",
        planting.motor_map,
        on_any_axis(on_channel(quantities.ROTOR_SPEED, quantities.STEADY_SPEED)),
    ),
    "rotor_gain": Effect("motor", 0.004, 0.06, "share", planting.rotor_gain, quantities.rotor_own_speed),
    "damaged_propeller": Effect(
        "force", 0.008, 0.2, "share", planting.damaged_propeller, quantities.rotor_own_thrust, acts_on_moment=True
    ),
    "battery_sag": Effect(
        "motor",
        0.002,
        0.03,
        "ohm",
        added("battery", "resistance"),
        on_any_axis(on_channel("voltage", quantities.ELECTRICAL_LOAD)),
    ),
    "axial_inflow": Effect(
        "force",
        6e-6,
        1e-4,
        "N/(rad/s m/s)",
        added("terms", "axial_inflow", "k_z"),
        on_any_axis(
            on_channel(f"{SPECIFIC_FORCE}_z", quantities.SINK_SPEED),
            along_axes(ANGULAR_ACCELERATION, quantities.rate, "xy"),
        ),
        acts_on_moment=True,
    ),
    "translational_lift": Effect(
        "force",
        6e-4,
        1e-2,
        "N/(m/s)^2",
        added("terms", "translational_lift", "k_h"),
        on_any_axis(on_channel(f"{SPECIFIC_FORCE}_z", quantities.LATERAL_SPEED)),
        acts_on_moment=True,
    ),
    "rotor_gyroscopic": Effect(
        "moment",
        3e-6,
        3e-5,
        "kg m^2",
        added("terms", "rotor_gyroscopic", "inertia"),
        on_any_axis(
            on_channel(f"{ANGULAR_ACCELERATION}_x", "sum of spin Omega omega_y"),
            on_channel(f"{ANGULAR_ACCELERATION}_y", "sum of spin Omega omega_x"),
            on_channel(f"{ANGULAR_ACCELERATION}_z", "sum of spin Omega'"),
        ),
    ),
    "rotor_drag": Effect(
        "force",
        2.5e-6,
        9e-5,
        "N/(rad/s m/s)",
        added("terms", "rotor_drag", "k_d"),
        on_any_axis(
            along_axes(SPECIFIC_FORCE, quantities.drag, "xy"), along_axes(ANGULAR_ACCELERATION, quantities.rate, "z")
        ),
        acts_on_moment=True,
    ),
    "linear_drag": Effect(
        "force",
        0.015,
        0.5,
        "N/(m/s)",
        planting.drag("linear_drag"),
        on_any_axis(along_axes(SPECIFIC_FORCE, quantities.drag)),
    ),
    "body_drag": Effect(
        "force",
        1.2e-3,
        0.03,
        "N/(m/s)^2",
        planting.drag("body_drag"),
        on_any_axis(along_axes(SPECIFIC_FORCE, quantities.drag)),
    ),
    "lift_cross": Effect(
        "force",
        2e-3,
        0.03,
        "N/(m/s)^2",
        planting.cross_lift,
        on_any_axis(
            on_channel(f"{SPECIFIC_FORCE}_x", "v_x v_z"),
            on_channel(f"{SPECIFIC_FORCE}_y", "v_y v_z"),
            on_channel(f"{SPECIFIC_FORCE}_z", r"(v_xy|\|v\|) v_z"),
        ),
    ),
    "flapping_moment": Effect(
        "moment",
        5e-8,
        3e-6,
        "N m/(rad/s m/s)",
        added("terms", "flapping_moment", "k_f"),
        on_any_axis(
            on_channel(f"{ANGULAR_ACCELERATION}_x", quantities.drag("y")),
            on_channel(f"{ANGULAR_ACCELERATION}_y", quantities.drag("x")),
        ),
    ),
    "drag_center": Effect(
        "moment",
        2e-3,
        0.03,
        "m",
        random_direction("terms", "drag_center", "position"),
        on_large_axes(cross_product(ANGULAR_ACCELERATION, quantities.drag)),
    ),
    "ground_effect": Effect(
        "force",
        0.4,
        4.0,
        "1",
        added("terms", "ground_effect", "k"),
        on_any_axis(on_channel(f"{SPECIFIC_FORCE}_z", r"thrust \(R/4h\)\^2")),
        path="low",
        acts_on_moment=True,
    ),
    "vortex_ring": Effect(
        "force",
        0.04,
        0.4,
        "share",
        added("terms", "vortex_ring", "loss"),
        on_any_axis(
            on_channel(f"{SPECIFIC_FORCE}_z", quantities.SINK_SPEED),
            along_axes(ANGULAR_ACCELERATION, quantities.rate, "xy"),
        ),
        path="dives",
        acts_on_moment=True,
    ),
    "wind": Effect(
        "force",
        0.2,
        6.0,
        "m/s",
        random_direction("terms", "wind", "velocity", axes=(1.0, 1.0, 0.1)),
        on_any_axis(along_axes(SPECIFIC_FORCE, quantities.wind)),
    ),
    "gust": Effect(
        "force",
        1.5,
        15.0,
        "m/s",
        added("terms", "gust", "wind_20ft"),
        on_any_axis(along_axes(SPECIFIC_FORCE, quantities.draught)),
    ),
    "local_draught": Effect(
        "force", 0.6, 6.0, "m/s", planting.local_draught, on_any_axis(along_axes(SPECIFIC_FORCE, quantities.draught))
    ),
    "command_latency": Effect(
        "command", 2e-3, 0.04, "s", added("terms", "command_latency", "delay"), on_any_axis(quantities.delayed_commands)
    ),
    "dropped_commands": Effect(
        "command",
        0.01,
        0.1,
        "share",
        added("terms", "dropped_commands", "share"),
        on_any_axis(quantities.delayed_commands),
    ),
    "rate_scale": Effect(
        "command",
        0.01,
        0.1,
        "share",
        one_axis("terms", "rate_scale", "scale", base=1.0),
        on_large_axes(quantities.rate_sent),
        idle=1.0,
    ),
    "throttle_curve": Effect(
        "command",
        0.01,
        0.15,
        "share",
        lambda content, size, rng: {("terms", "throttle_curve", "gain"): planting.random_sign(rng) * size},
        on_any_axis(on_channel(quantities.THROTTLE_COMMAND, r"throttle(\^2)?")),
    ),
    "gyro_bias": Effect(
        "imu",
        4e-3,
        0.1,
        "rad/s",
        random_direction("terms", "gyro_bias", "bias"),
        on_large_axes(along_axes(quantities.GYRO, quantities.constant)),
    ),
    "gyro_scale": Effect(
        "imu",
        4e-3,
        0.05,
        "share",
        one_axis("terms", "gyro_scale", "scale"),
        on_large_axes(
            along_axes(quantities.GYRO, quantities.rate), along_axes(ANGULAR_ACCELERATION, quantities.torque)
        ),
    ),
    "imu_lever_arm": Effect(
        "imu",
        2e-3,
        0.05,
        "m",
        random_direction("terms", "imu_lever_arm", "position"),
        on_large_axes(
            cross_product(ACCELEROMETERS, quantities.angular_acceleration), quantities.centripetal(ACCELEROMETERS)
        ),
    ),
    "marker_offset": Effect(
        "imu",
        6e-3,
        0.08,
        "m",
        random_direction("terms", "marker_offset", "position"),
        on_large_axes(
            cross_product(quantities.ACCELEROMETER, quantities.angular_acceleration),
            quantities.centripetal(quantities.ACCELEROMETER),
            cross_product(quantities.VIO_VELOCITY, quantities.rate),
        ),
    ),
    "accel_bias": Effect(
        "imu",
        0.05,
        0.8,
        "m/s^2",
        random_direction("terms", "accel_bias", "bias"),
        on_large_axes(along_axes(ACCELEROMETERS, quantities.constant)),
    ),
    "accel_scale": Effect(
        "imu",
        5e-3,
        0.04,
        "share",
        one_axis("terms", "accel_scale", "scale"),
        on_large_axes(along_axes(ACCELEROMETERS, quantities.specific_force)),
    ),
    "time_offset": Effect(
        "imu",
        1.5e-3,
        0.03,
        "s",
        added("terms", "time_offset", "delay"),
        on_any_axis(
            along_axes(quantities.GYRO, quantities.angular_acceleration),
            along_axes(quantities.ACCELEROMETER, quantities.force_rate),
        ),
    ),
    "clock_drift": Effect(
        "imu",
        60.0,
        500.0,
        "ppm",
        added("terms", "clock_drift", "ppm"),
        on_any_axis(
            along_axes(quantities.GYRO, quantities.growing_with_time(quantities.angular_acceleration)),
            along_axes(quantities.ACCELEROMETER, quantities.growing_with_time(quantities.force_rate)),
        ),
    ),
    "frame_misalignment": Effect(
        "imu",
        3e-3,
        0.04,
        "rad",
        random_direction("terms", "frame_misalignment", "rotation"),
        on_large_axes(
            cross_product(quantities.GYRO, quantities.rate),
            cross_product(quantities.ACCELEROMETER, quantities.specific_force),
            cross_product(quantities.VIO_VELOCITY, quantities.speed),
        ),
    ),
    "vio_scale": Effect(
        "vio",
        0.01,
        0.08,
        "share",
        lambda content, size, rng: {("terms", "vio_scale", "scale"): planting.random_sign(rng) * size},
        on_any_axis(along_axes(quantities.VIO_VELOCITY, quantities.speed)),
    ),
    "propeller_stall": Effect(
        "force",
        0.1,
        3.0,
        "share per unit of advance ratio",
        added("terms", "propeller_stall", "slope"),
        on_any_axis(on_channel(f"{SPECIFIC_FORCE}_z", quantities.LATERAL_SPEED)),
        acts_on_moment=True,
    ),
}
