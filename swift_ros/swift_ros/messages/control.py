"""Commands of the policy, and what the flight controller that gets them reports."""

import math

import numpy as np
from sensor_msgs.msg import BatteryState

from swift_msgs.msg import BetaflightLink, PolicyStep, Rotors
from swift_msgs.msg import BodyRateThrust as BodyRateThrustMessage
from swift_ros.messages.stamps import from_time, to_time
from swift_ros.messages.vectors import from_xyz, to_vector
from swift_ros.types import BodyRateThrust


def to_policy_step(state_stamp_ns: int, observation, action, next_gate: int, lap: int) -> PolicyStep:
    """Return swift_msgs/PolicyStep for the state with a stamp (ns): observation (31,), action (4,)."""
    message = PolicyStep(next_gate=int(next_gate), lap=int(lap))
    message.header.stamp = to_time(state_stamp_ns)
    message.header.frame_id = "map"
    message.observation = np.asarray(observation, dtype=np.float32)
    message.action = np.asarray(action, dtype=np.float32)
    return message


def to_command(command: BodyRateThrust) -> BodyRateThrustMessage:
    """Return swift_msgs/BodyRateThrust."""
    message = BodyRateThrustMessage(thrust=float(command.thrust), body_rate=to_vector(command.omega_body))
    message.header.stamp = to_time(command.stamp_ns)
    message.header.frame_id = "base_link"
    return message


def from_command(message: BodyRateThrustMessage) -> BodyRateThrust:
    """Return the command of a message."""
    return BodyRateThrust(from_time(message.header.stamp), message.thrust, from_xyz(message.body_rate))


def to_link(now_ns: int, command_stamp_ns: int, **fields) -> BetaflightLink:
    """Return swift_msgs/BetaflightLink.

    Args:
        now_ns: header stamp, ns.
        command_stamp_ns: stamp of the answered command, ns.
        fields: all other fields of the message.
    """
    message = BetaflightLink(command_stamp=to_time(command_stamp_ns), **fields)
    message.header.stamp = to_time(now_ns)
    message.header.frame_id = "base_link"
    return message


def to_rotors(now_ns: int, speed, motor) -> Rotors:
    """Return swift_msgs/Rotors from speeds (n,) rad/s, NaN when unknown, and motor commands (n,) 0..1."""
    message = Rotors(speed=[float(v) for v in speed], motor=[float(v) for v in motor])
    message.header.stamp = to_time(now_ns)
    message.header.frame_id = "base_link"
    return message


def to_battery(now_ns: int, voltage: float, current: float, drawn_ah: float, capacity_ah: float) -> BatteryState:
    """Return sensor_msgs/BatteryState.

    Args:
        now_ns: header stamp, ns.
        voltage: V.
        current: A, positive while discharging.
        drawn_ah: drawn charge, Ah.
        capacity_ah: capacity, Ah; 0 when unknown.
    """
    message = BatteryState(voltage=voltage, current=-current, present=voltage > 0, capacity=capacity_ah or math.nan)
    message.header.stamp = to_time(now_ns)
    message.header.frame_id = "base_link"
    message.design_capacity = message.capacity
    message.charge = message.capacity - drawn_ah
    message.percentage = max(0.0, 1.0 - drawn_ah / capacity_ah) if capacity_ah else math.nan
    message.temperature = math.nan
    message.power_supply_technology = BatteryState.POWER_SUPPLY_TECHNOLOGY_LIPO
    message.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
    return message
