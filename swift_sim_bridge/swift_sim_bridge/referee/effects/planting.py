"""Functions that plant an effect in a vehicle file: (content, size, rng) -> {path: value} of the true vehicle file."""

import copy

import numpy as np

MIN_LIST_LENGTHS = {("terms", "com_offset", "position"): 3}  # of lists of which fewer entries are planted


def scaled(*path):
    """Plant by scaling the value in the file by 1 + size or 1 - size."""
    return lambda content, size, rng: {path: value_at(content, path) * (1.0 + random_sign(rng) * size)}


def added(*path):
    """Plant by adding the size to the value in the file, 0 if it has none."""
    return lambda content, size, rng: {path: value_at(content, path) + size}


def random_direction(*path, axes=(1.0, 1.0, 1.0)):
    """Plant by adding a vector of length size in a random direction, its axes weighted."""

    def plant(content, size, rng):
        direction = np.array(axes) * rng.standard_normal(len(axes))
        direction /= np.linalg.norm(direction)
        return {(*path, i): value_at(content, (*path, i)) + size * float(x) for i, x in enumerate(direction) if axes[i]}

    return plant


def one_axis(*path, base=0.0):
    """Plant +size or -size on one axis of three."""

    def plant(content, size, rng):
        axis, value = int(rng.integers(3)), random_sign(rng) * size
        return {(*path, i): base + value * (i == axis) for i in range(3)}

    return plant


def random_sign(rng) -> float:
    """Return 1 or -1."""
    return float(rng.choice([-1.0, 1.0]))


def inertia(content, size, rng):
    """Plant a change of the inertia about one axis."""
    axis = int(rng.integers(3))
    return {("inertia", axis): content["inertia"][axis] * (1.0 + random_sign(rng) * size)}


def drag(name):
    """Plant equal drag on the lateral axes and 1.5 times as much on z."""

    def plant(content, size, rng):
        return {
            ("terms", name, "c", i): value_at(content, ("terms", name, "c", i)) + size * share
            for i, share in enumerate((1.0, 1.0, 1.5))
        }

    return plant


def cross_lift(content, size, rng):
    """Plant both coefficients of the body's lift, each with a random sign."""
    return {
        ("terms", "lift_cross", "a"): random_sign(rng) * size,
        ("terms", "lift_cross", "b"): random_sign(rng) * size,
    }


def motor_lag(content, size, rng):
    """Plant a change of both time constants of the motors by one factor."""
    up = content["motor"]["time_constant_up"] * (1.0 + random_sign(rng) * size)
    return {("motor", "time_constant_up"): up, ("motor", "time_constant_down"): up}


def motor_map(content, size, rng):
    """Plant a change of two coefficients of the motor map, of opposite signs."""
    top, way = content["rotor_speed_range"][1], random_sign(rng)
    root, linear = ("motor", "map", "coefficients", 2), ("motor", "map", "coefficients", 3)
    return {
        root: value_at(content, root) - 0.5 * way * size * top,
        linear: value_at(content, linear) + way * size * top,
    }


def rotor_gain(content, size, rng):
    """Plant a change of one motor's speed."""
    chosen, value = int(rng.integers(len(content["rotors"]))), random_sign(rng) * size
    return {("terms", "rotor_gain", "gain", i): value * (i == chosen) for i in range(len(content["rotors"]))}


def damaged_propeller(content, size, rng):
    """Plant a loss of thrust of one propeller."""
    chosen = int(rng.integers(len(content["rotors"]))) + 1
    return {("terms", "damaged_propeller", "rotor"): chosen, ("terms", "damaged_propeller", "loss"): size}


def load(low, high):
    """Plant a payload of `size` kg at a random position between two corners, m."""

    def plant(content, size, rng):
        at = rng.uniform(low, high)
        return {("terms", "payload", "mass"): size} | {
            ("terms", "payload", "position", i): float(x) for i, x in enumerate(at)
        }

    return plant


payload = load([-0.04, -0.03, -0.04], [0.04, 0.03, 0.02])


def local_draught(content, size, rng):
    """Plant a horizontal local draught; its center is moved onto the path later."""
    angle = rng.uniform(0.0, 2 * np.pi)
    values = {"radius": float(rng.uniform(2.0, 3.5))}
    velocity, center = (size * np.cos(angle), size * np.sin(angle), 0.0), (0.0, 0.0, 0.0)
    return (
        {("terms", "local_draught", key): value for key, value in values.items()}
        | {("terms", "local_draught", "velocity", i): float(x) for i, x in enumerate(velocity)}
        | {("terms", "local_draught", "center", i): x for i, x in enumerate(center)}
    )


def pad(content, size, rng):
    """Plant a raised place; its center is moved onto the path later."""
    return {("strange", "pad"): size} | {("strange", "center", i): 0.0 for i in range(3)}


def law(name, draw):
    """Plant all numbers of a law of `simulator.blind`, which draw(size, rng) returns by name."""

    def plant(content, size, rng):
        numbers = draw(size, rng).items()
        return {("blind", name, key, *at): float(one) for key, value in numbers for at, one in np.ndenumerate(value)}

    return plant


def bistable_wake(size, rng):
    """Return the numbers of a wake."""
    return {
        "lift_area": size * rng.uniform(0.0045, 0.0100),  # m^2
        "slip_gain": rng.uniform(1.6, 3.0),
        "bias": random_sign(rng) * rng.uniform(0.02, 0.06),
        "relaxation_length": rng.uniform(0.6, 1.4),  # m
        "critical_speed": rng.uniform(3.0, 5.0),  # m/s
    }


def twisting_arm(size, rng):
    """Return the numbers of four arms, one of which is soft in torsion."""
    soft = np.arange(4) == rng.integers(4)
    return {
        "softness": size / rng.uniform(7.5, 12.0) * soft,  # rad/(N m)
        "rotor_inertia": rng.uniform(5.5e-6, 8.0e-6),  # kg m^2
        "shear_offset": random_sign(rng) * rng.uniform(0.001, 0.004),  # m
    }


def sliding_battery(size, rng):
    """Return the numbers of a loose pack."""
    return {
        "battery": size * rng.uniform(0.18, 0.25),  # kg
        "slack": rng.uniform(0.009, 0.016),  # m, each way
        "height": rng.uniform(0.02, 0.035),  # m over the centre of mass
        "preload": rng.uniform(0.6, 1.5),  # m/s^2
        "friction": rng.uniform(0.05, 0.12),
        "mobility": rng.uniform(0.010, 0.030),  # m/s per m/s^2
    }


def arm_resonance(size, rng):
    """Return the numbers of four arms that resonate with their rotors."""
    mode = rng.uniform(1400.0, 2000.0) * (1.0 + rng.uniform(-0.05, 0.05, 4))  # rad/s
    damping = rng.uniform(0.10, 0.15)
    sag = size * rng.uniform(0.035, 0.070) * rng.uniform(0.7, 1.15, 4)  # of the rotor speed, at a motor lag of 35 ms
    return {"mode": mode, "damping": damping, "peak": sag * mode / 0.035}  # rad/s^2


def fretting_connector(size, rng):
    """Return the numbers of a worn connector."""
    return {
        "resistance": size * rng.uniform(0.014, 0.030),  # ohm
        "threshold": rng.uniform(13.0, 19.0),  # m/s^2
        "opening_rate": rng.uniform(0.8, 2.0),  # 1/s per m/s^2
        "healing_time": rng.uniform(0.25, 0.80),  # s
    }


def value_at(content: dict, path: tuple, idle: float = 0.0):
    """Return the value at a path of a vehicle file's content, `idle` if it has none."""
    for step in path:
        if isinstance(content, dict):
            if step not in content:
                return idle
            content = content[step]
        else:
            content = content[step]
    return content


def conceal(content: dict, values: dict) -> dict:
    """Return a vehicle file's content with values {path: value}; lists grow to the entries that a path needs."""
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
    for path, length in MIN_LIST_LENGTHS.items():
        place = value_at(content, path)
        if isinstance(place, list):
            place.extend([0.0] * (length - len(place)))
    return content


def path_text(path: tuple) -> str:
    """Return a path as text: terms.body_drag.c[0]."""
    text = ""
    for step in path:
        text += f"[{step}]" if isinstance(step, int) else f".{step}" if text else step
    return text
