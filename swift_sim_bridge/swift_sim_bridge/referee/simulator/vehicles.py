"""Random vehicles: contents of vehicle files."""

import numpy as np

from swift_sim_bridge.referee.simulator.flight import LOOP_HZ
from swift_sim_bridge.referee.simulator.plant import GRAVITY

ROTOR_SIGNS = ((-1, -1), (1, -1), (-1, 1), (1, 1))  # of x and y: rear right, front right, rear left, front left
SPINS = (-1, 1, 1, -1)
SHEET = {  # noise sheet: range of the standard deviation of a sample
    "position_m": (3e-4, 1e-3),
    "velocity_m_s": (0.005, 0.02),
    "attitude_rad": (1e-3, 2.5e-3),
    "gyro_rad_s": (0.01, 0.03),
    "accel_m_s2": (0.2, 0.6),
    "vibration_m_s2": (0.2, 1.0),
    "rotor_relative": (0.002, 0.006),
    "vbat_v": (0.01, 0.03),
    "ibat_a": (0.2, 0.6),
}


def draw_vehicle(rng: np.random.Generator, name: str) -> dict:
    """Return the content of the vehicle file of a five-inch racer, or a similar one, with rotor and body drag."""
    mass, x, y = rng.uniform(0.6, 1.1), rng.uniform(0.065, 0.09), rng.uniform(0.08, 0.11)
    top_speed, thrust_to_weight = rng.uniform(2400.0, 3000.0), rng.uniform(3.5, 5.0)
    lift = thrust_to_weight * mass * GRAVITY / (4 * top_speed**2)
    hover_current = rng.uniform(13.0, 20.0)
    battery = _battery(rng)
    hover_speed = top_speed / np.sqrt(thrust_to_weight)
    torque = (hover_current * 16.0 - battery["avionics_w"]) * battery["efficiency"] / (4 * hover_speed**3)
    lag = rng.uniform(0.022, 0.045)
    quadratic = rng.uniform(
        0.08, 0.25
    )  # share of the speed that does not depend on voltage: the map's terms in sqrt(u) and u
    shares = {"c2": quadratic * rng.uniform(0.3, 1.0), "c3": quadratic * rng.uniform(0.3, 1.0)}
    voltage = battery["reference_voltage"]
    rest = 1.0 - shares["c2"] - shares["c3"]
    coefficients = [0.0, 0.0, shares["c2"] * top_speed, shares["c3"] * top_speed, rest * top_speed / voltage]
    terms = {
        "rotor_drag": {"k_d": rng.uniform(2e-5, 5e-5)},
        "body_drag": {"c": rng.uniform([0.003, 0.003, 0.006], [0.008, 0.008, 0.014])},
    }
    controller = _controller(rng, lag, thrust_to_weight)
    return plain(
        {
            "name": name,
            "mass": mass,
            "inertia": mass * rng.uniform([2.7e-3, 2.4e-3, 4.8e-3], [4.2e-3, 3.6e-3, 7.0e-3]),
            "rotors": [
                {"position": [ax * x, ay * y, 0.0], "spin": s} for (ax, ay), s in zip(ROTOR_SIGNS, SPINS, strict=True)
            ],
            "rotor_radius": 0.0635,
            "thrust_coefficient": lift,
            "torque_coefficient": torque,
            "rotor_speed_range": [150.0, 1.08 * top_speed],
            "motor": {
                "time_constant_up": lag,
                "time_constant_down": lag,
                "map": {"form": "speed = c0 + c1 U + c2 sqrt(u) + c3 u + c4 U sqrt(u)", "coefficients": coefficients},
            },
            "battery": battery,
            "rates": {"max": [12.0, 12.0, 6.0]},
            "controller": controller,
            "terms": terms,
            "sensors": {key: rng.uniform(*limits) for key, limits in SHEET.items()},
        }
    )


def _battery(rng) -> dict:
    """Return the battery of a vehicle file."""
    return {
        "reference_voltage": 15.9,
        "open_circuit_full": 16.8,
        "open_circuit_slope": rng.uniform(1.2, 2.0),
        "capacity": rng.uniform(4000.0, 6500.0),
        "resistance": rng.uniform(0.008, 0.02),
        "rc_resistance": 0.003,
        "rc_time": rng.uniform(3.0, 8.0),
        "efficiency": 0.85,
        "avionics_w": 12.0,
    }


def _controller(rng, lag: float, thrust_to_weight: float) -> dict:
    """Return the controller of a vehicle file, for motors with a time constant `lag`, s."""
    # each loop is slower than the one below it, and all are slow enough for the motors
    rate_kp = rng.uniform(0.4, 0.6) / lag
    attitude_kp = rng.uniform(0.4, 0.55) * rate_kp
    velocity_kp = rng.uniform(0.4, 0.55) * attitude_kp
    return {
        "type": "rate_pid",
        "rate_hz": float(LOOP_HZ),
        "rate_kp": rate_kp * np.array([1.0, 1.0, 0.5]),
        "rate_ki": rng.uniform([10.0, 10.0, 5.0], [40.0, 40.0, 20.0]),
        "rate_kd": rng.uniform([0.05, 0.05, 0.0], [0.15, 0.15, 0.0]),
        "d_cutoff_hz": rng.uniform(60.0, 100.0),
        "idle": 0.04,
        "outer_hz": 100.0,
        "position_kp": velocity_kp**2 * rng.uniform(0.35, 0.5),
        "velocity_kp": velocity_kp,
        "attitude_kp": attitude_kp,
        "max_thrust": 0.8 * thrust_to_weight * GRAVITY,
    }


def plain(content):
    """Return the content with Python numbers of six digits, so that the file has exactly the values that are flown."""
    if isinstance(content, dict):
        return {key: plain(value) for key, value in content.items()}
    if isinstance(content, list | tuple | np.ndarray):
        return [plain(value) for value in content]
    return float(f"{content:.6g}") if isinstance(content, float | np.floating) else content


def top_thrust(content: dict) -> float:
    """Return the largest collective thrust (m/s^2) for a vehicle file's content."""
    lift = content["thrust_coefficient"] * content["rotor_speed_range"][1] ** 2
    return len(content["rotors"]) * lift / content["mass"]
