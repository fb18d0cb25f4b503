"""What the referee conceals: for each effect its layer, how large it may be, and how it stands in a vehicle file.

Sizes are of one number an effect (`unit`): from what a careful tool might detect in a 30 s race to what is plausible
and bad. mismatch.md, sections 3 and 6, from which the sizes are taken.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from swift_sim_bridge.referee import quantities as by
from swift_sim_bridge.referee.quantities import FELT, FORCE, TURN, across, along, at, vector, whole


@dataclass(frozen=True)
class Effect:
    """layer; detectable, largest: sizes in `unit`; planted(content, size, rng) -> {path: value}, what the true vehicle
    file holds; shows: what an equation in its place must go by (see `quantities`); path: kind of path that shows it,
    any where empty; turns: it acts at the hubs, or off the centre, and so in the moment layer as well; idle: what its
    numbers are where a file holds none."""

    layer: str
    detectable: float
    largest: float
    unit: str
    planted: Callable
    shows: Callable
    path: str = ""
    turns: bool = False
    idle: float = 0.0

    @property
    def layers(self) -> set[str]:
        """Where it acts."""
        return {self.layer, "moment"} if self.turns else {self.layer}


def scaled(*path):
    """Plant by scaling what the file holds by 1 + size or 1 - size."""
    return lambda content, size, rng: {path: got(content, path) * (1.0 + sign(rng) * size)}


def grown(*path):
    """Plant by adding the size to what the file holds, nothing where it holds nothing."""
    return lambda content, size, rng: {path: got(content, path) + size}


def pointing(*path, axes=(1.0, 1.0, 1.0)):
    """Plant a vector of length size in a random direction, its axes weighted, beside what the file holds."""

    def planted(content, size, rng):
        direction = np.array(axes) * rng.standard_normal(len(axes))
        direction /= np.linalg.norm(direction)
        return {(*path, i): got(content, (*path, i)) + size * float(x) for i, x in enumerate(direction) if axes[i]}

    return planted


def one_axis(*path, base=0.0):
    """Plant +size or -size on one axis of three."""

    def planted(content, size, rng):
        axis, value = int(rng.integers(3)), sign(rng) * size
        return {(*path, i): base + value * (i == axis) for i in range(3)}

    return planted


def sign(rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _inertia(content, size, rng):
    axis = int(rng.integers(3))
    return {("inertia", axis): content["inertia"][axis] * (1.0 + sign(rng) * size)}


def _drag(name):
    """Plant drag on the two lateral axes alike and on z half as much again."""

    def planted(content, size, rng):
        return {
            ("terms", name, "c", i): got(content, ("terms", name, "c", i)) + size * share
            for i, share in enumerate((1.0, 1.0, 1.5))
        }

    return planted


def _lift(content, size, rng):
    return {("terms", "lift_cross", "a"): sign(rng) * size, ("terms", "lift_cross", "b"): sign(rng) * size}


def _lag(content, size, rng):
    up = content["motor"]["time_constant_up"] * (1.0 + sign(rng) * size)
    return {("motor", "time_constant_up"): up, ("motor", "time_constant_down"): up}


def _map(content, size, rng):
    top, way = content["rotor_speed_range"][1], sign(rng)
    root, linear = ("motor", "map", "coefficients", 2), ("motor", "map", "coefficients", 3)
    return {root: got(content, root) - 0.5 * way * size * top, linear: got(content, linear) + way * size * top}


def _one_rotor(content, size, rng):
    chosen, value = int(rng.integers(len(content["rotors"]))), sign(rng) * size
    return {("terms", "rotor_gain", "gain", i): value * (i == chosen) for i in range(len(content["rotors"]))}


def _propeller(content, size, rng):
    chosen = int(rng.integers(len(content["rotors"]))) + 1
    return {("terms", "damaged_propeller", "rotor"): chosen, ("terms", "damaged_propeller", "loss"): size}


def _payload(content, size, rng):
    at = rng.uniform([-0.04, -0.03, -0.04], [0.04, 0.03, 0.02])
    return {("terms", "payload", "mass"): size} | {
        ("terms", "payload", "position", i): float(x) for i, x in enumerate(at)
    }


def _draught(content, size, rng):
    angle = rng.uniform(0.0, 2 * np.pi)
    values = {"radius": float(rng.uniform(2.0, 3.5))}
    velocity, center = (size * np.cos(angle), size * np.sin(angle), 0.0), (0.0, 0.0, 0.0)  # moved onto the path later
    return (
        {("terms", "local_draught", key): value for key, value in values.items()}
        | {("terms", "local_draught", "velocity", i): float(x) for i, x in enumerate(velocity)}
        | {("terms", "local_draught", "center", i): x for i, x in enumerate(center)}
    )


EFFECTS = {
    "mass": Effect("force", 0.01, 0.15, "share", scaled("mass"), whole(along(FORCE, by.push))),
    "inertia": Effect("moment", 0.06, 0.5, "share", _inertia, vector(along(TURN, by.torque), by.coupled)),
    "com_offset": Effect(
        "moment",
        3e-4,
        8e-3,
        "m",
        pointing("terms", "com_offset", "position", axes=(1.0, 1.0, 0.0)),
        vector(across(TURN, by.push)),
    ),
    "payload": Effect(
        "force",
        0.01,
        0.1,
        "kg",
        _payload,
        whole(along(FORCE, by.push), across(TURN, by.push), along(TURN, by.torque)),
        turns=True,
    ),
    "thrust_axis_tilt": Effect(
        "force",
        0.003,
        0.05,
        "rad",
        pointing("terms", "thrust_axis_tilt", "tilt", axes=(1.0, 1.0)),
        vector(across(FORCE, by.thrust)),
    ),
    "thrust_coefficient": Effect(
        "force",
        0.01,
        0.15,
        "share",
        scaled("thrust_coefficient"),
        whole(along(FORCE, by.thrust), along(TURN, by.torque, "xy")),
        turns=True,
    ),
    "torque_coefficient": Effect(
        "moment",
        0.04,
        0.3,
        "share",
        scaled("torque_coefficient"),
        whole(along(TURN, by.torque, "z"), at(by.POWER, by.LOAD)),
    ),
    "motor_time_constant": Effect("motor", 0.03, 0.4, "share", _lag, whole(at(by.ROTOR, by.CHANGING))),
    "motor_asymmetry": Effect(
        "motor", 1.5e-3, 0.02, "s", grown("motor", "time_constant_down"), whole(at(by.ROTOR, by.CHANGING))
    ),
    "motor_map": Effect("motor", 0.008, 0.08, "share", _map, whole(at(by.ROTOR, by.STEADY))),
    "rotor_gain": Effect("motor", 0.004, 0.06, "share", _one_rotor, by.fast_rotor),
    "damaged_propeller": Effect("force", 0.008, 0.2, "share", _propeller, by.weak_rotor, turns=True),
    "battery_sag": Effect("motor", 0.002, 0.03, "ohm", grown("battery", "resistance"), whole(at("voltage", by.LOAD))),
    "axial_inflow": Effect(
        "force",
        6e-6,
        1e-4,
        "N/(rad/s m/s)",
        grown("terms", "axial_inflow", "k_z"),
        whole(at(f"{FORCE} z", by.SINKING), along(TURN, by.rate, "xy")),
        turns=True,
    ),
    "translational_lift": Effect(
        "force",
        6e-4,
        1e-2,
        "N/(m/s)^2",
        grown("terms", "translational_lift", "k_h"),
        whole(at(f"{FORCE} z", by.SIDEWAYS)),
        turns=True,
    ),
    "rotor_gyroscopic": Effect(
        "moment",
        3e-6,
        3e-5,
        "kg m^2",
        grown("terms", "rotor_gyroscopic", "inertia"),
        whole(
            at(f"{TURN} x", "sum of spin Omega omega_y"),
            at(f"{TURN} y", "sum of spin Omega omega_x"),
            at(f"{TURN} z", "sum of spin Omega'"),
        ),
    ),
    "rotor_drag": Effect(
        "force",
        2.5e-6,
        9e-5,
        "N/(rad/s m/s)",
        grown("terms", "rotor_drag", "k_d"),
        whole(along(FORCE, by.drag, "xy"), along(TURN, by.rate, "z")),
        turns=True,
    ),
    "linear_drag": Effect("force", 0.015, 0.5, "N/(m/s)", _drag("linear_drag"), whole(along(FORCE, by.drag))),
    "body_drag": Effect("force", 1.2e-3, 0.03, "N/(m/s)^2", _drag("body_drag"), whole(along(FORCE, by.drag))),
    "lift_cross": Effect(
        "force",
        2e-3,
        0.03,
        "N/(m/s)^2",
        _lift,
        whole(at(f"{FORCE} x", "v_x v_z"), at(f"{FORCE} y", "v_y v_z"), at(f"{FORCE} z", r"(v_xy|\|v\|) v_z")),
    ),
    "flapping_moment": Effect(
        "moment",
        5e-8,
        3e-6,
        "N m/(rad/s m/s)",
        grown("terms", "flapping_moment", "k_f"),
        whole(at(f"{TURN} x", by.drag("y")), at(f"{TURN} y", by.drag("x"))),
    ),
    "drag_center": Effect(
        "moment", 2e-3, 0.03, "m", pointing("terms", "drag_center", "position"), vector(across(TURN, by.drag))
    ),
    "ground_effect": Effect(
        "force",
        0.4,
        4.0,
        "1",
        grown("terms", "ground_effect", "k"),
        whole(at(f"{FORCE} z", r"thrust \(R/4h\)\^2")),
        path="low",
        turns=True,
    ),
    "vortex_ring": Effect(
        "force",
        0.04,
        0.4,
        "share",
        grown("terms", "vortex_ring", "loss"),
        whole(at(f"{FORCE} z", by.SINKING), along(TURN, by.rate, "xy")),
        path="dives",
        turns=True,
    ),
    "wind": Effect(
        "force",
        0.2,
        6.0,
        "m/s",
        pointing("terms", "wind", "velocity", axes=(1.0, 1.0, 0.1)),
        whole(along(FORCE, by.wind)),
    ),
    "gust": Effect("force", 1.5, 15.0, "m/s", grown("terms", "gust", "wind_20ft"), whole(along(FORCE, by.draught))),
    "local_draught": Effect("force", 0.6, 6.0, "m/s", _draught, whole(along(FORCE, by.draught))),
    "command_latency": Effect("command", 2e-3, 0.04, "s", grown("terms", "command_latency", "delay"), whole(by.late)),
    "dropped_commands": Effect(
        "command", 0.01, 0.1, "share", grown("terms", "dropped_commands", "share"), whole(by.late)
    ),
    "rate_scale": Effect(
        "command",
        0.01,
        0.1,
        "share",
        one_axis("terms", "rate_scale", "scale", base=1.0),
        vector(by.rate_sent),
        idle=1.0,
    ),
    "throttle_curve": Effect(
        "command",
        0.01,
        0.15,
        "share",
        lambda content, size, rng: {("terms", "throttle_curve", "gain"): sign(rng) * size},
        whole(at("throttle received less sent", r"throttle(\^2)?")),
    ),
    "gyro_bias": Effect(
        "imu", 4e-3, 0.1, "rad/s", pointing("terms", "gyro_bias", "bias"), vector(along(by.GYRO, by.constant))
    ),
    "gyro_scale": Effect(
        "imu",
        4e-3,
        0.05,
        "share",
        one_axis("terms", "gyro_scale", "scale"),
        vector(along(by.GYRO, by.rate), along(TURN, by.torque)),
    ),
    "imu_lever_arm": Effect(
        "imu",
        2e-3,
        0.05,
        "m",
        pointing("terms", "imu_lever_arm", "position"),
        vector(across(FELT, by.turning), by.swung(FELT)),
    ),
    "marker_offset": Effect(
        "imu",
        6e-3,
        0.08,
        "m",
        pointing("terms", "marker_offset", "position"),
        vector(across(by.ACCELERATION, by.turning), by.swung(by.ACCELERATION), across(by.VELOCITY, by.rate)),
    ),
    "accel_bias": Effect(
        "imu", 0.05, 0.8, "m/s^2", pointing("terms", "accel_bias", "bias"), vector(along(FELT, by.constant))
    ),
    "accel_scale": Effect(
        "imu", 5e-3, 0.04, "share", one_axis("terms", "accel_scale", "scale"), vector(along(FELT, by.push))
    ),
    "time_offset": Effect(
        "imu",
        1.5e-3,
        0.03,
        "s",
        grown("terms", "time_offset", "delay"),
        whole(along(by.GYRO, by.turning), along(by.ACCELERATION, by.jerk)),
    ),
    "clock_drift": Effect(
        "imu",
        60.0,
        500.0,
        "ppm",
        grown("terms", "clock_drift", "ppm"),
        whole(along(by.GYRO, by.growing(by.turning)), along(by.ACCELERATION, by.growing(by.jerk))),
    ),
    "frame_misalignment": Effect(
        "imu",
        3e-3,
        0.04,
        "rad",
        pointing("terms", "frame_misalignment", "rotation"),
        vector(across(by.GYRO, by.rate), across(by.ACCELERATION, by.push), across(by.VELOCITY, by.speed)),
    ),
    "vio_scale": Effect(
        "vio",
        0.01,
        0.08,
        "share",
        lambda content, size, rng: {("terms", "vio_scale", "scale"): sign(rng) * size},
        whole(along(by.VELOCITY, by.speed)),
    ),
}
CONFUSABLE = (
    ("mass", "thrust_coefficient", "accel_scale"),
    ("motor_time_constant", "command_latency", "time_offset"),
    ("rotor_drag", "linear_drag", "body_drag"),
    ("wind", "accel_bias", "thrust_axis_tilt", "com_offset"),
    ("com_offset", "damaged_propeller", "payload"),
    ("imu_lever_arm", "marker_offset", "accel_bias", "lift_cross"),
    ("axial_inflow", "body_drag", "vortex_ring", "translational_lift"),
    ("inertia", "thrust_coefficient", "motor_time_constant"),
    ("rate_scale", "gyro_scale", "gyro_bias"),
    ("dropped_commands", "command_latency"),
)
ROUTES = {  # where an effect's own list of numbers is longer than the axes that are planted
    "com_offset": ("terms", "com_offset", "position"),
}


def got(content: dict, path: tuple, idle: float = 0.0):
    """Return what a vehicle file's content holds at a path, `idle` where it holds nothing."""
    for step in path:
        if isinstance(content, dict):
            if step not in content:
                return idle
            content = content[step]
        else:
            content = content[step]
    return content


def conceal(content: dict, values: dict) -> dict:
    """Return the content with values {path: value} in it; lists grow to three entries where a path needs them."""
    content = copy.deepcopy(content)
    for path, value in values.items():
        place = content
        for step, after in zip(path[:-1], path[1:], strict=True):
            if isinstance(place, dict):
                place = place.setdefault(step, [] if isinstance(after, int) else {})
            else:
                place = place[step]
        if isinstance(place, list):
            place.extend([0.0] * (path[-1] + 1 - len(place)))
        place[path[-1]] = value
    for path in ROUTES.values():
        place = got(content, path)
        if isinstance(place, list):
            place.extend([0.0] * (3 - len(place)))
    return content


def written(path: tuple) -> str:
    """Return a path as a reader sees it: terms.body_drag.c[0]."""
    text = ""
    for step in path:
        text += f"[{step}]" if isinstance(step, int) else f".{step}" if text else step
    return text
