"""A vehicle of which the rate loop receives commands late, distorted or not at all, for tests of the command link."""

from dataclasses import replace

import numpy as np

from swift_ros.configuration import configuration_folder, load
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.gap.recording import rate_pid

RATE_HZ, SECONDS, TICK_S = 500.0, 12.0, 0.01
GAINS = {
    "type": "rate_pid",
    "rate_hz": RATE_HZ,
    "rate_kp": [15.0, 15.0, 8.0],
    "rate_ki": [20.0, 20.0, 10.0],
    "rate_kd": [0.1, 0.1, 0.0],
    "d_cutoff_hz": 80.0,
    "idle": 0.04,
}


def vehicle() -> Vehicle:
    return replace(load(Vehicle, configuration_folder() / "drone.yaml"), controller=GAINS)


def flight(delay_s=0.0, lost=0.0, jitter_s=0.0, scale=(1.0, 1.0, 1.0), offset=0.0, gain=0.0) -> FlightTable:
    """Return commands, and the motor commands of a loop that receives them late, with jitter, distorted or not at all.

    The vehicle follows its rates.
    """
    rng, loop, dt = np.random.default_rng(4), rate_pid.rate_pid_from_vehicle(vehicle()), 1.0 / RATE_HZ
    t, stamps = np.arange(0.0, SECONDS, dt), np.arange(0.0, SECONDS, TICK_S)
    hz, phase = rng.uniform(0.3, 4.0, (4, 5)), rng.uniform(0.0, 6.0, (4, 5))
    waves = np.sin(2 * np.pi * hz * stamps[:, None, None] + phase).sum(axis=2)
    rates, thrust = 0.25 * waves[:, :3], GRAVITY * (1.3 + 0.08 * waves[:, 3])
    arrived = rng.random(len(stamps)) >= lost
    arrived[0] = True
    late = np.maximum(delay_s + np.sqrt(12.0) * jitter_s * (rng.random(len(stamps)) - 0.5 if jitter_s else 0.0), 0.0)
    due = np.where(arrived, stamps + late, np.inf)
    received = np.array([np.flatnonzero(due <= max(now, due[0]) + 1e-9)[-1] for now in t])
    wanted, total, slope, before = np.array(scale) * rates[received] + offset, np.zeros(3), np.zeros(3), np.zeros(3)
    gyro, motors = np.zeros((len(t), 3)), np.zeros((len(t), 4))
    keep = dt / (dt + 1 / (2 * np.pi * loop.d_cutoff_hz))
    allocation, omega = np.linalg.pinv(loop.mixer), np.zeros(3)
    for i in range(len(t)):
        gyro[i] = omega + 0.02 * rng.standard_normal(3)
        before = gyro[i] if i == 0 else before
        error = wanted[i] - gyro[i]
        total = total + dt * error
        slope = slope + keep * ((gyro[i] - before) / dt - slope)
        before = gyro[i]
        turning = loop.kp * error + loop.ki * total - loop.kd * slope
        torque = loop.inertia @ turning + np.cross(gyro[i], loop.inertia @ gyro[i])
        thrusts = allocation @ np.append(loop.mass * (1 + gain) * thrust[received[i]], torque)
        missing = np.sqrt(np.maximum(thrusts, 0.0) / loop.lift) - loop.shape[0]
        root = 2 * missing / (loop.shape[1] + np.sqrt(loop.shape[1] ** 2 + 4 * loop.shape[2] * missing))
        motors[i] = np.clip(root**2, loop.idle, 1.0)
        omega = omega + dt * np.clip(turning, -80.0, 80.0)
    return FlightTable(
        "flight",
        {
            "gyro_body": Samples(t, gyro),
            "motor_command": Samples(t, motors),
            "omega_command_body": Samples(stamps, rates),
            "thrust_command": Samples(stamps, thrust),
        },
    )


def rms(values) -> np.ndarray:
    return np.sqrt(np.mean(np.square(values), axis=0))
