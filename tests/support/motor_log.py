"""A flight controller's log without a pose, from a second, plain implementation of motors and battery."""

from dataclasses import replace

import numpy as np

from swift_ros.configuration import configuration_folder, load
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import Vehicle

T = np.arange(0.0, 16.0, 0.004)
SHIPPED = load(Vehicle, configuration_folder() / "drone.yaml")
VEHICLE = replace(
    SHIPPED,
    battery=replace(SHIPPED.battery, rc2_resistance=0.0, rc2_time=0.0),
    sensors={"rotor_relative": 0.003, "vbat_v": 0.02, "ibat_a": 0.5, "gyro_rad_s": 0.02},
)


def resonance(speed, current):
    """Return the steady speed, rad/s, that rotors lack at the resonance of their arms, at speeds (4,) rad/s."""
    return 60.0 / (1.0 + ((speed - 1250.0) / 60.0) ** 2)


def worn_plug(seed: int) -> np.ndarray:
    """Return the resistance (n,) ohm of a pack whose plug opens and closes at random, about every 1.5 s."""
    flips = np.random.default_rng([seed, 1]).random(len(T)) < T[1] / 1.5
    return 0.012 + 0.02 * (np.cumsum(flips) % 2)


def log(
    seed: int, lag_s: float = 0.033, resistance: float | np.ndarray = 0.012, lost=None, noise_v: float = 0.02
) -> FlightTable:
    """Return the log of a flight with this motor lag and this resistance of the battery.

    Args:
        seed: seed of commands and noise.
        lag_s: time constant of the motors.
        resistance: ohm, or (n,) of each time.
        lost: function of the rotor speeds (4,), rad/s, and the current, A, to the steady speed, rad/s, that they lack.
        noise_v: of the voltage, V.
    """
    ohm = np.broadcast_to(resistance, len(T))
    rng, pack, c = np.random.default_rng(seed), VEHICLE.battery, VEHICLE.motor.map.coefficients
    swing = sum(np.sin(2 * np.pi * hz * T[:, None] + rng.uniform(0, 6.0, 4)) for hz in (0.3, 0.8, 2.1, 4.7))
    command = np.clip(0.35 + 0.09 * swing, 0.06, 0.95)
    speed, voltage, current = np.full((len(T), 4), 1300.0), np.empty(len(T)), np.empty(len(T))
    charge, rc_voltage, dt = 0.0, 0.0, T[1]
    for k in range(len(T)):
        power_w = VEHICLE.torque_coefficient * np.sum(speed[k] ** 3) / pack.efficiency + pack.avionics_w
        source = pack.open_circuit_full - pack.open_circuit_slope * charge / pack.capacity - rc_voltage
        voltage[k] = 0.5 * (source + np.sqrt(source**2 - 4.0 * ohm[k] * power_w))
        current[k] = power_w / voltage[k]
        charge += current[k] * dt
        rc_voltage += (current[k] * pack.rc_resistance - rc_voltage) * dt / pack.rc_time
        if k + 1 < len(T):
            steady = c[0] + c[1] * voltage[k] + (c[2] + c[4] * voltage[k]) * np.sqrt(command[k]) + c[3] * command[k]
            steady = steady - lost(speed[k], current[k]) if lost else steady
            speed[k + 1] = steady + (speed[k] - steady) * np.exp(-dt / lag_s)

    def noisy(values, sigma):
        return Samples(T, values + sigma * rng.standard_normal(values.shape))

    return FlightTable(
        f"log {seed}",
        {
            "gyro_body": noisy(np.zeros((len(T), 3)), 0.02),
            "motor_command": Samples(T, command),
            "specific_force_body": noisy(np.zeros((len(T), 3)) + [0.0, 0.0, 9.8], 0.5),
            "rotor_speed": noisy(speed, 0.003 * speed.mean()),
            "voltage": noisy(voltage, noise_v),
            "current": noisy(current, 0.5),
        },
    )
