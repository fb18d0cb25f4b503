"""Residual channels: what a recording allows to compare with the model, in groups that are computed together."""

from dataclasses import dataclass

from swift_sim_bridge.gap.recording import betaflight_log, command_link, command_timing, gate_observations
from swift_sim_bridge.gap.recording.recording import Recording

AXES = "xyz"
SPECIFIC_FORCE, ANGULAR_ACCELERATION = "specific_force", "angular_acceleration"
ACCELEROMETER, GYRO, VIO_VELOCITY = "accelerometer", "gyro", "vio_velocity"
ROTOR_SPEED, VOLTAGE, ELECTRICAL_POWER = "rotor_speed", "voltage", "electrical_power"
GATES = {"largest": "largest gate", "next": "next gate"}


@dataclass(frozen=True)
class Channel:
    """One residual: one scalar signal over time, measured minus modelled.

    Attributes:
        layer: motor, force, moment, imu, camera, vio or command.
        quantity: what is compared, such as "specific_force"; shared by the components of a vector.
        part: component of the quantity: "x", "y" or "z" of a body vector, "1" for the first rotor, "roll" for a loop's
            axis; empty for a scalar.
        name: for a reader.
        unit: SI unit, empty for a ratio.
        negligible: standard deviation below which a residual has no practical meaning, in `unit`.
    """

    layer: str
    quantity: str
    part: str
    name: str
    unit: str
    negligible: float = 0.0

    @property
    def id(self) -> str:
        """The stable identifier, such as "specific_force_x"."""
        return f"{self.quantity}_{self.part}" if self.part else self.quantity

    def as_json(self) -> dict:
        """Return the entry of the channel in report.json, by its id."""
        return {
            "name": self.name,
            "unit": self.unit,
            "layer": self.layer,
            "quantity": self.quantity,
            "axis": self.axis,
        }

    @property
    def axis(self) -> str:
        """The body axis "x", "y" or "z" of a vector's component, empty for all else."""
        return self.part if self.part in tuple(AXES) else ""


def vector(layer: str, quantity: str, name: str, unit: str) -> list[Channel]:
    """Return the three channels of a body vector, in the order of AXES."""
    return [Channel(layer, quantity, axis, f"{name} {axis}", unit) for axis in AXES]


def residual_groups(recording: Recording) -> dict[str, tuple[Channel, ...]]:
    """Return the residual channels that the recording's signals allow, by the group that computes them."""
    found = {}
    gyro, accelerometer = recording.has("p_world", "q_world_body", "gyro_body"), recording.has("specific_force_body")
    pose = recording.has_motion
    if recording.motor_record is not None:
        found["rotors"] = [
            Channel("motor", ROTOR_SPEED, f"{i + 1}", f"rotor {i + 1} speed", "rad/s")
            for i in range(recording.rotor_speed.shape[1])
        ]
    if recording.has("voltage", "rotor_speed"):
        power = Channel("motor", ELECTRICAL_POWER, "", "electrical power", "W")
        found["pack"] = [
            Channel("motor", VOLTAGE, "", "voltage", "V"),
            *([power] if recording.has("current") else []),
        ]
    if pose and recording.has("rotor_speed"):
        found["force"] = vector("force", SPECIFIC_FORCE, "specific force", "m/s^2")
    if pose and recording.has("single_rotor_speeds"):
        found["moment"] = vector("moment", ANGULAR_ACCELERATION, "angular acceleration", "rad/s^2")
    if gyro and accelerometer:
        found["accelerometer"] = vector("imu", ACCELEROMETER, "accelerometer vs pose,", "m/s^2")
    if gyro:
        found["gyro"] = vector("imu", GYRO, "gyro vs pose,", "rad/s")
    if gyro and recording.has("gate_observations"):
        found["camera"] = _gate_corners()
    if gyro and recording.has("p_vio", "q_vio_body"):
        found["vio"] = vector("vio", VIO_VELOCITY, "VIO velocity vs pose,", "m/s")
    if recording.command_link:
        found["command"] = _commands()
    if recording.rate_loop:
        found["rate loop"] = [
            Channel(
                "command",
                "rate_loop_demand",
                axis,
                f"{axis} demand of the rate loop",
                "",
                betaflight_log.NEGLIGIBLE_DEMAND,
            )
            for axis in betaflight_log.AXES
        ]
    return {name: tuple(group) for name, group in found.items()}


def _gate_corners() -> list[Channel]:
    """Return the channels of the corners of the gates that are compared in one image."""
    return [
        Channel(
            "camera",
            "gate_corner",
            f"{size}_{corner.replace(' ', '_')}_{direction}",
            f"{corner} corner of the {gate}, {direction}",
            "px",
        )
        for size, gate in tuple(GATES.items())[: gate_observations.GATES_PER_IMAGE]
        for corner in gate_observations.CORNERS
        for direction in ("across", "down")
    ]


def _commands() -> list[Channel]:
    """Return the channels of the commanded rates and throttle: received by the rate loop, less sent."""
    found = []
    for (part, unit), negligible in zip(command_link.UNITS.items(), command_timing.NEGLIGIBLE, strict=True):
        axis = "" if part == "throttle" else part
        quantity, name = ("rate_command", f"{axis} rate") if axis else ("throttle_command", part)
        found.append(Channel("command", quantity, axis, f"{name}, received vs sent", unit, negligible))
    return found
