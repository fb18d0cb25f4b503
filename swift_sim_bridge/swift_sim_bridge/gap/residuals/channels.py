"""What of a recording can be held against what: a channel for each residual, in groups that come together. Pure."""

from dataclasses import dataclass

from swift_sim_bridge.gap.recording import betaflight_log, command_link, command_timing, gate_observations
from swift_sim_bridge.gap.recording.recording import Recording

AXES = "xyz"
GATES = ("largest gate", "next gate")[: gate_observations.SLOTS]


@dataclass(frozen=True)
class Channel:
    """One residual. layer: motor, force, moment, imu, camera, vio or command; name and unit: for a reader; least: what
    nobody cares for."""

    layer: str
    name: str
    unit: str
    least: float = 0.0


def groups_of(recording: Recording) -> dict[str, tuple[Channel, ...]]:
    """Return the residuals that the recording's channels allow, by what tells them together."""
    found = {}
    pose, imu = recording.has("p_world", "q_world_body", "gyro_body"), recording.has("specific_force_body")
    if recording.drive is not None:
        found["rotors"] = [
            Channel("motor", f"rotor {i + 1} speed", "rad/s") for i in range(recording.rotor_speed.shape[1])
        ]
    if recording.has("voltage", "rotor_speed"):
        power = [Channel("motor", "electrical power", "W")] if recording.has("current") else []
        found["pack"] = [Channel("motor", "voltage", "V"), *power]
    if pose and imu and recording.has("rotor_speed"):
        found["force"] = [Channel("force", f"specific force {axis}", "m/s^2") for axis in AXES]
    if pose and recording.has("single_rotor_speeds"):
        found["moment"] = [Channel("moment", f"angular acceleration {axis}", "rad/s^2") for axis in AXES]
    if pose and imu:
        found["accelerometer"] = [Channel("imu", f"pose's less accelerometer's force {axis}", "m/s^2") for axis in AXES]
    if pose:
        found["gyro"] = [Channel("imu", f"pose's less gyro's rate {axis}", "rad/s") for axis in AXES]
    if pose and recording.has("sightings"):
        found["camera"] = [
            Channel("camera", f"{corner} corner of the {gate}, {axis}", "px")
            for gate in GATES
            for corner in gate_observations.CORNERS
            for axis in ("across", "down")
        ]
    if pose and recording.has("p_vio", "q_vio_body"):
        found["vio"] = [Channel("vio", f"VIO's less the pose's velocity {axis}", "m/s") for axis in AXES]
    if recording.heard:
        found["command"] = [
            Channel("command", f"{name} heard less sent", unit, least)
            for (name, unit), least in zip(command_link.UNITS.items(), command_timing.LEAST, strict=True)
        ]
    if recording.rate_loop:
        found["rate loop"] = [
            Channel("command", f"{axis} demand of the rate loop", "", betaflight_log.LEAST)
            for axis in betaflight_log.AXES
        ]
    return {name: tuple(group) for name, group in found.items()}
