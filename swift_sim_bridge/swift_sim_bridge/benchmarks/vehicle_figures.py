"""The vehicle compared with the paper's: hover and full throttle of the model, thrust and power of recorded races."""

from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import full_name
from swift_ros.messages.stamps import from_time
from swift_ros.recording import bags
from swift_ros.recording.race_bag import read_record
from swift_ros.text import align
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.physics import battery, motors
from swift_sim_bridge.physics.state import BATTERY, parameters_from_vehicle, start_memory

ROTORS, PACK = "betaflight/rotors", "battery"
BISECTIONS = 40  # halve an interval of 1 to below 1e-12; also the iterations of voltage and load


@dataclass(frozen=True)
class OperatingPoint:
    """A steady state at rest in still air.

    Attributes:
        motor_command: 0..1.
        rotor_speed: rad/s.
        thrust: N, of all rotors.
        voltage: V, of the battery.
        current: A, of the battery.
    """

    motor_command: float
    rotor_speed: float
    thrust: float
    voltage: float
    current: float

    @property
    def power(self) -> float:
        """Electrical power, W."""
        return self.voltage * self.current


def at_command(vehicle: Vehicle, motor_command: float) -> OperatingPoint:
    """Return the operating point of a full, rested battery with all motors at one command (0..1)."""
    with jax.enable_x64(True):
        p = parameters_from_vehicle(vehicle)
        memory = start_memory(p, jnp.zeros(())).get(BATTERY)
        commands, voltage = jnp.full(len(vehicle.rotors), motor_command), jnp.asarray(p.battery.open_circuit_full)
        for _ in range(BISECTIONS):  # the load lowers the voltage, which lowers the load
            speed = motors.steady_speed(commands, voltage, p.motors)
            load_w = battery.power(speed, p.rotors.torque_coefficient, p.battery)
            voltage, current = battery.voltage_and_current(load_w, 0.0, 0.0, p.battery, memory)
        thrust = jnp.sum(p.rotors.thrust_coefficient * speed * speed)
        return OperatingPoint(motor_command, float(speed[0]), float(thrust), float(voltage), float(current))


def hover(vehicle: Vehicle) -> OperatingPoint:
    """Return the operating point at which the thrust equals the weight; the vehicle must be able to hover."""
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if at_command(vehicle, middle).thrust < vehicle.mass * GRAVITY else (low, middle)
    return at_command(vehicle, high)


def race_means(bag: Path, vehicle: Vehicle) -> dict[str, float]:
    """Return means of a recorded race, from the start signal to the end.

    Args:
        bag: of the race.
        vehicle: its thrust coefficient converts rotor speeds.

    Returns:
        {"thrust_n": of the rotors, from telemetry; "power_w": electrical, measured; "speed_m_s", "path_m": of ground
        truth}.

    Raises:
        UsageError: a topic is missing, or the race did not start and end.
    """
    for topic in (ROTORS, PACK):
        bags.require(bag, full_name(topic))
    record = read_record(bag)
    if record.start_ns is None or record.end_ns is None:
        raise UsageError(f"{bag} holds no race from start to end; leave its folder out")
    during = [
        pose for pose in record.odometry["ground_truth/odometry"] if record.start_ns <= pose.stamp_ns <= record.end_ns
    ]
    positions = np.array([pose.p_world for pose in during])
    path = float(np.sum(np.linalg.norm(np.diff(positions, axis=0), axis=1)))
    thrusts, powers = [], []
    for topic, message, _ in bags.read(bag, [full_name(ROTORS), full_name(PACK)]):
        if not record.start_ns <= from_time(message.header.stamp) <= record.end_ns:
            continue
        if topic == full_name(ROTORS):
            thrusts.append(vehicle.thrust_coefficient * float(np.sum(np.square(message.speed))))
        else:
            powers.append(abs(message.voltage * message.current))
    duration = 1e-9 * (during[-1].stamp_ns - during[0].stamp_ns)
    return {
        "thrust_n": float(np.mean(thrusts)),
        "power_w": float(np.mean(powers)),
        "speed_m_s": path / duration,
        "path_m": path,
    }


# The paper's fastest race against humans, on its own vehicle (Methods; extended data).
PAPER = {"thrust_n": 29.16, "power_w": 866.0, "speed_m_s": 13.11, "path_m": 228.85}


def figures(vehicle: Vehicle, races: list[dict[str, float]]) -> dict:
    """Return {"hover", "full": operating points, "thrust_to_weight", "races": mean and range by quantity}."""
    at_hover, full = hover(vehicle), at_command(vehicle, 1.0)
    rows = {
        key: {"mean": float(np.mean(values)), "low": min(values), "high": max(values), "paper": PAPER[key]}
        for key in PAPER
        if (values := [race[key] for race in races])
    }
    return {
        "hover": vars(at_hover) | {"power": at_hover.power},
        "full": vars(full) | {"power": full.power},
        "thrust_to_weight": full.thrust / (vehicle.mass * GRAVITY),
        "races": rows,
    }


def table(result: dict) -> str:
    """Return the figures as text."""
    rows = [("at rest, full pack", "motor command", "rotor rad/s", "thrust N", "V", "A", "W")]
    for name in ("hover", "full"):
        w = result[name]
        rows.append(
            (
                name,
                f"{w['motor_command']:.3f}",
                f"{w['rotor_speed']:.0f}",
                f"{w['thrust']:.2f}",
                f"{w['voltage']:.2f}",
                f"{w['current']:.1f}",
                f"{w['power']:.0f}",
            )
        )
    blocks = [align(rows), f"thrust-to-weight {result['thrust_to_weight']:.2f} (paper: 4.1, 35 N)"]
    if result["races"]:
        race_rows = [("mean over a race", "ours", "range over races", "paper")]
        names = {"thrust_n": "thrust N", "power_w": "power W", "speed_m_s": "speed m/s", "path_m": "path m"}
        race_rows += [
            (names[key], f"{row['mean']:.2f}", f"{row['low']:.2f} to {row['high']:.2f}", f"{row['paper']}")
            for key, row in result["races"].items()
        ]
        blocks.append(align(race_rows))
    return "\n\n".join(blocks)
