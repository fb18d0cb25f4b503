"""The effects that the referee conceals: layer, sizes, how each is planted, and the terms of its equation.

The size of an effect is one number in its `unit`. The detectable size is what the analysis of a 30 s race might show,
the largest size what is plausible for a vehicle in bad condition or badly described; both are chosen by hand.
"""

from swift_sim_bridge.referee import planting, quantities
from swift_sim_bridge.referee.effect import Effect
from swift_sim_bridge.referee.planting import added, one_axis, random_direction, scaled
from swift_sim_bridge.referee.quantities import (
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

# Physics that no effect of the gap tool names, see `simulator.strange`; the tool must answer with an equation.
STRANGE = {
    "vortex_bump": Effect(
        "force",
        0.04,
        0.4,
        "share",
        added("strange", "vortex_bump"),
        on_any_axis(on_channel(f"{SPECIFIC_FORCE}_z", quantities.SINK_SPEED)),
        path="dives",
        acts_on_moment=True,
    ),
    "pad": Effect(
        "force",
        0.02,
        0.3,
        "share",
        planting.pad,
        on_any_axis(on_channel(f"{SPECIFIC_FORCE}_z", r"\w+_z within .*")),
        acts_on_moment=True,
    ),
    "lift": Effect(
        "force",
        2e-3,
        0.03,
        "N/(m/s)^2",
        added("strange", "lift"),
        on_any_axis(on_channel(f"{SPECIFIC_FORCE}_y", "v_x v_z")),
    ),
    "stall": Effect(
        "force",
        2.0,
        40.0,
        "share per square of advance ratio",
        added("strange", "stall"),
        on_any_axis(on_channel(f"{SPECIFIC_FORCE}_z", quantities.LATERAL_SPEED)),
        acts_on_moment=True,
    ),
    "cross_drag": Effect(
        "force",
        0.015,
        0.5,
        "N/(m/s)",
        added("strange", "cross_drag"),
        on_any_axis(
            on_channel(f"{SPECIFIC_FORCE}_x", quantities.drag("y")),
            on_channel(f"{SPECIFIC_FORCE}_y", quantities.drag("x")),
        ),
    ),
    "weathercock": Effect(
        "moment",
        1e-5,
        1e-3,
        "N m/(m/s)^2",
        added("strange", "weathercock"),
        on_any_axis(on_channel(f"{ANGULAR_ACCELERATION}_z", quantities.drag("y"))),
    ),
}


def _blind(layer: str, name: str, draw, channel: str, quantity: str) -> Effect:
    """Return a law of `simulator.blind` as an effect that acts on one channel; its author's size is 1."""
    expected = on_any_axis(on_channel(channel, quantity))
    return Effect(layer, BLIND_DETECTABLE, 1.0, "of the author's size", planting.law(name, draw), expected, path="race")


# Physics by an author who had not read the tool. What is expected was written before the first diagnosis. A law with
# memory acts by a present quantity times something that no equation of present quantities gives: the right answer is
# *unknown* in its layer and on its axis, with the present quantity.
BLIND_DETECTABLE = 1 / 3  # by hand, so that every case of the author's size is asked for
BLIND = {
    "bistable_wake": _blind(
        "force", "bistable_wake", planting.bistable_wake, f"{SPECIFIC_FORCE}_y", quantities.AIR_VELOCITY
    ),
    "twisting_arm": _blind(
        "moment", "twisting_arm", planting.twisting_arm, f"{ANGULAR_ACCELERATION}_z", quantities.TURNING_ROTOR
    ),
    "sliding_battery": _blind(
        "moment", "sliding_battery", planting.sliding_battery, f"{ANGULAR_ACCELERATION}_y", quantities.THRUST_OR_PULL
    ),
    "arm_resonance": _blind(
        "motor", "arm_resonance", planting.arm_resonance, quantities.ROTOR_SPEED, quantities.STEADY_SPEED
    ),
    "fretting_connector": _blind(
        "motor", "fretting_connector", planting.fretting_connector, "voltage", quantities.ELECTRICAL_LOAD
    ),
}
RELATED = {"vortex_bump": ("vortex_ring",), "stall": ("propeller_stall",)}  # effects that would name a law, nearly

# What a pilot may have changed, for recordings of pose and motor commands alone: effect, how it is planted, and its
# smallest and largest size in the effect's unit.
CHANGES = {
    "cut propeller": ("damaged_propeller", planting.damaged_propeller, (0.05, 0.3)),
    "hung weight": ("payload", planting.load([-0.02, -0.02, -0.12], [0.02, 0.02, -0.06]), (0.03, 0.15)),
    "heavier battery": ("payload", planting.load([-0.01, -0.01, -0.04], [0.01, 0.01, -0.02]), (0.04, 0.15)),
    "weaker pack": ("battery_sag", added("battery", "resistance"), (0.01, 0.04)),
}
CHANGES_OF_ROTORPY = ("hung weight", "heavier battery")

# Numbers of the file that may be wrong by a large factor: effect, and paths of the numbers.
FAR = {
    "motor_time_constant": (("motor", "time_constant_up"), ("motor", "time_constant_down")),
    "body_drag": tuple(("terms", "body_drag", "c", i) for i in range(3)),
    "rotor_drag": (("terms", "rotor_drag", "k_d"),),
    "battery_sag": (("battery", "resistance"),),
}
FACTORS = (3.0, 10.0, 30.0)
