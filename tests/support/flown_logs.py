"""A known flight, and the bytes of logs of it: PX4 ULog, ArduPilot DataFlash, ROS 2 bags and CSV tables.

The logs are written by the specifications of their formats: nothing of the readers is used.
"""

import struct
from dataclasses import dataclass
from functools import cache
from io import BytesIO

import numpy as np
from mcap.writer import CompressionType, Writer

from swift_ros import geometry
from swift_ros.messages.motion import to_imu
from swift_ros.messages.serialization import serialize
from swift_ros.recording.mcap_format.message_definitions import schema_text

RATE_HZ, SECONDS, BEGIN_S = 200.0, 12.0, 30.0
GRAVITY = 9.80665
# Places (forward, left) and spins of PX4's and ArduPilot's quadrotor x: front right, rear left, front left, rear right
PLACES = np.array([(1, -1), (-1, 1), (1, 1), (-1, -1)])
SPINS = np.array([1, 1, -1, -1])
ENU_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FRD = np.array([1.0, -1.0, -1.0])
Q_NED_ENU = geometry.quaternion_from_matrix(ENU_NED)
Q_FLU_FRD = geometry.quaternion_from_matrix(np.diag(FRD))


@dataclass(frozen=True)
class Flight:
    """A flight in this project's frames: t (n,), p, v, gyro, force (n, 3), q (n, 4), motors (n, 4), volts (n,)."""

    t: np.ndarray
    p: np.ndarray
    v: np.ndarray
    q: np.ndarray
    gyro: np.ndarray
    force: np.ndarray
    motors: np.ndarray
    volts: np.ndarray

    @property
    def q_ned_frd(self) -> np.ndarray:
        """Attitudes of forward-right-down in north-east-down (n, 4)."""
        return geometry.quaternion_multiply(Q_NED_ENU[None], geometry.quaternion_multiply(self.q, Q_FLU_FRD[None]))


@cache
def flight() -> Flight:
    """Return a flight of 12 s whose channels agree: a path of sines, with an attitude of sines of its own."""
    rng = np.random.default_rng(5)
    t = np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
    sines = (0.4, 3.1, 0.2), (0.3, 4.3, 1.0), (0.8, 1.7, 0.4)
    angles = np.stack([size * np.sin(pulse * t + begin) for size, pulse, begin in sines], axis=-1)
    angles += 0.02 * np.stack([np.sin(w * t) for w in (23.0, 29.0, 17.0)], axis=-1)
    q = _from_angles(angles + [0.0, 0.0, 0.7])
    fine = geometry.quaternion_multiply(geometry.quaternion_conjugate(q[:-1]), q[1:])
    gyro = geometry.rotation_vector_from_quaternion(fine) * RATE_HZ
    gyro = np.concatenate([gyro, gyro[-1:]])
    size, pulse = np.array([3.0, 2.0, 1.0]), np.array([1.3, 1.9, 0.9])
    p = size * np.sin(pulse * t[:, None]) + [0.0, 0.0, 4.0]
    v = size * pulse * np.cos(pulse * t[:, None])
    a = -size * pulse**2 * np.sin(pulse * t[:, None])
    force = geometry.rotate_inverse(q, a + [0.0, 0.0, GRAVITY])
    turn = np.gradient(gyro, 1.0 / RATE_HZ, axis=0)
    mixed = turn @ np.stack([PLACES[:, 1], -PLACES[:, 0], -SPINS])
    motors = np.clip(0.5 + 0.2 * mixed / np.abs(mixed).max() + 0.003 * rng.standard_normal((len(t), 4)), 0.0, 1.0)
    gyro = gyro + 2e-3 * rng.standard_normal(gyro.shape)
    force = force + 0.05 * rng.standard_normal(force.shape)
    return Flight(t, p, v, q, gyro, force, motors, 16.0 - 0.05 * t + 0.01 * rng.standard_normal(len(t)))


def _from_angles(angles) -> np.ndarray:
    """Return quaternions of roll, pitch, yaw (n, 3) rad."""
    turns = [angles[:, i : i + 1] * np.eye(3)[i] for i in range(3)]
    roll, pitch, yaw = (geometry.quaternion_from_rotation_vector(turn) for turn in turns)
    return geometry.quaternion_multiply(yaw, geometry.quaternion_multiply(pitch, roll))


def ned(vectors) -> np.ndarray:
    return np.asarray(vectors) @ ENU_NED.T


def roll_pitch_yaw(q) -> np.ndarray:
    """Return roll, pitch, yaw (n, 3) rad of attitudes."""
    x, y, z, w = q.T
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(2 * (w * y - z * x))
    return np.stack([roll, pitch, np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))], axis=-1)


# PX4 ULog


def message(kind: str, content: bytes) -> bytes:
    return struct.pack("<HB", len(content), ord(kind)) + content


# Every how many rows of the flight PX4 logs a topic by its default profile; other topics have every row
DEFAULT_PROFILE = {"vehicle_attitude": 10, "vehicle_local_position": 20, "actuator_motors": 20}
DEFAULT_PROFILE |= {"vehicle_thrust_setpoint": 4, "battery_status": 40}


@cache
def ulog(rows: int | None = None, default_profile: bool = False) -> bytes:
    """Return a ULog file of the flight, or of its first rows; with every row, or by the default profile."""
    flown = flight()
    strides = DEFAULT_PROFILE if default_profile else {}
    thrust = np.mean(flown.motors, axis=1, keepdims=True) * [0.0, 0.0, -1.0]
    q = flown.q_ned_frd[:, [3, 0, 1, 2]]
    topics = {
        "sensor_combined": (
            "float[3] gyro_rad;float[3] accelerometer_m_s2;",
            [flown.gyro * FRD, flown.force * FRD],
        ),
        "vehicle_attitude": ("float[4] q;", [q]),
        "vehicle_local_position": ("float x;float y;float z;float vx;float vy;float vz;", [ned(flown.p), ned(flown.v)]),
        "actuator_motors": ("float[12] control;", [flown.motors, np.full((len(q), 8), np.nan)]),
        "battery_status": ("float voltage_v;float current_a;", [flown.volts[:, None], 0.0 * flown.volts[:, None]]),
        "vehicle_thrust_setpoint": ("float[3] xyz;", [thrust]),
    }
    stream = BytesIO()
    stream.write(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", int(BEGIN_S * 1e6)))
    stream.write(message("B", bytes(40)))
    stream.write(message("I", bytes([15]) + b"char[3] sys_name"[:15] + b"PX4"))
    for name, (fields, _) in topics.items():
        stream.write(message("F", f"{name}:uint64_t timestamp;{fields}".encode()))
    stream.write(message("P", bytes([16]) + b"int32_t PWM_MIN_" + struct.pack("<i", 1000)))
    for number, name in enumerate(topics):
        stream.write(message("A", struct.pack("<BH", 0, number) + name.encode()))
    contents = [np.concatenate(values, axis=1).astype("<f4") for _, values in topics.values()]
    for i, t in enumerate(flown.t[:rows]):
        stamp = int(round((BEGIN_S + t) * 1e6))
        for number, (name, values) in enumerate(zip(topics, contents, strict=True)):
            if i % strides.get(name, 1) == 0:
                stream.write(message("D", struct.pack("<HQ", number, stamp) + values[i].tobytes()))
    return stream.getvalue()


# ArduPilot DataFlash

KINDS = {  # number, types, columns
    "IMU": (130, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "ATT": (131, "Qccc", "TimeUS,Roll,Pitch,Yaw"),
    "XKF1": (132, "QBffffff", "TimeUS,C,VN,VE,VD,PN,PE,PD"),
    "RCOU": (133, "QHHHH", "TimeUS,C1,C2,C3,C4"),
    "BAT": (134, "QBf", "TimeUS,Instance,Volt"),
    "PARM": (135, "QNf", "TimeUS,Name,Value"),
}
SIZES = {"Q": 8, "B": 1, "f": 4, "c": 2, "H": 2, "N": 16}
CODES = {"N": "16s", "c": "h"}


def dataflash_rows(rows: int | None = None):
    """Yield (kind, values) of a DataFlash log of the flight, or of its first rows."""
    flown = flight()
    angles = np.degrees(roll_pitch_yaw(flown.q_ned_frd))
    for name, value in (("MOT_PWM_MIN", 1100.0), ("MOT_PWM_MAX", 1900.0)):
        yield "PARM", (int(BEGIN_S * 1e6), name.encode(), value)
    for i, t in enumerate(flown.t[:rows]):
        us = int(round((BEGIN_S + t) * 1e6))
        yield "IMU", (us, 0, *(flown.gyro[i] * FRD), *(flown.force[i] * FRD))
        yield "ATT", (us, *(round(100 * angle) for angle in angles[i]))
        yield "XKF1", (us, 0, *ned(flown.v[i]), *ned(flown.p[i]))
        yield "RCOU", (us, *(round(1100 + 800 * u) for u in flown.motors[i]))
        if i % 20 == 0:
            yield "BAT", (us, 0, flown.volts[i])


@cache
def dataflash(rows: int | None = None) -> bytes:
    """Return a binary DataFlash log of the flight."""
    found = [_fmt(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")]
    for name, (number, types, columns) in KINDS.items():
        found.append(_fmt(number, 3 + sum(SIZES[c] for c in types), name, types, columns))
    for name, values in dataflash_rows(rows):
        number, types, _ = KINDS[name]
        found.append(
            b"\xa3\x95" + bytes([number]) + struct.pack("<" + "".join(CODES.get(c, c) for c in types), *values)
        )
    return b"".join(found)


def _fmt(number: int, length: int, name: str, types: str, columns: str) -> bytes:
    texts = (name.encode(), types.encode(), columns.encode())
    return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", number, length, *texts)


@cache
def dataflash_text(rows: int | None = None) -> bytes:
    """Return the same log as text."""
    lines = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns"]
    for name, (number, types, columns) in KINDS.items():
        lines.append(f"FMT, {number}, {3 + sum(SIZES[c] for c in types)}, {name}, {types}, {columns}")
    for name, values in dataflash_rows(rows):
        texts = [value.decode() if isinstance(value, bytes) else f"{value:.7g}" for value in values[1:]]
        if name == "ATT":
            texts = [f"{value / 100:.2f}" for value in values[1:]]  # text logs hold degrees
        lines.append(", ".join([name, str(values[0]), *texts]))
    return ("\n".join(lines) + "\n").encode()


# Bags

PX4_MOTORS = "uint64 timestamp\nfloat32[12] control\n"  # px4_msgs is not installed: the bag's own definition


def bag(imus: tuple[str, ...] = ("/drone/imu",), seconds: float = SECONDS) -> bytes:
    """Return an MCAP bag of the flight with topics of standard types, and motors in a type that is not installed."""
    from geometry_msgs.msg import PoseStamped, TwistStamped
    from sensor_msgs.msg import BatteryState

    flown, stream = flight(), BytesIO()
    writer = Writer(stream, compression=CompressionType.NONE)
    writer.start(profile="ros2")
    kinds = dict.fromkeys(imus, "sensor_msgs/msg/Imu")
    kinds |= {
        "/vrpn/drone/pose": "geometry_msgs/msg/PoseStamped",
        "/vrpn/drone/twist": "geometry_msgs/msg/TwistStamped",
    }
    kinds |= {"/battery": "sensor_msgs/msg/BatteryState"}
    texts = {kind: schema_text(kind).encode() for kind in kinds.values()} | {
        "px4_msgs/msg/ActuatorMotors": PX4_MOTORS.encode()
    }
    schemas = {kind: writer.register_schema(kind, "ros2msg", text) for kind, text in texts.items()}
    channels = {name: writer.register_channel(name, "cdr", schemas[kind]) for name, kind in kinds.items()}
    motors = writer.register_channel("/fmu/out/actuator_motors", "cdr", schemas["px4_msgs/msg/ActuatorMotors"])
    for i in range(round(seconds * RATE_HZ)):
        stamp = int(round((1.7e9 + flown.t[i]) * 1e9))
        pose = PoseStamped()
        pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = flown.p[i].tolist()
        o = pose.pose.orientation
        o.x, o.y, o.z, o.w = flown.q[i].tolist()
        twist = TwistStamped()
        twist.twist.linear.x, twist.twist.linear.y, twist.twist.linear.z = flown.v[i].tolist()
        battery = BatteryState(voltage=float(flown.volts[i]), current=-10.0)
        found = dict.fromkeys(imus, to_imu(stamp, flown.gyro[i], flown.force[i]))
        found |= {"/vrpn/drone/pose": pose, "/vrpn/drone/twist": twist, "/battery": battery}
        for name, one in found.items():
            messages_stamp(one, stamp)
            writer.add_message(channels[name], stamp, serialize(one), stamp)
        # PX4's own clock, in microseconds since it was switched on
        control = np.concatenate([flown.motors[i], np.full(8, np.nan)])
        data = b"\x00\x01\x00\x00" + struct.pack("<Q12f", int((BEGIN_S + flown.t[i]) * 1e6), *control)
        writer.add_message(motors, stamp, data, stamp)
    writer.finish()
    return stream.getvalue()


def messages_stamp(one, stamp: int) -> None:
    one.header.stamp.sec, one.header.stamp.nanosec = divmod(stamp, 10**9)


# Tables


def columns() -> dict[str, np.ndarray]:
    """Return the flight as columns with plain names that are no columns of a flight table."""
    flown = flight()
    found = {"timestamp": flown.t}
    groups = {"pos": flown.p, "vel": flown.v, "gyro": flown.gyro, "acc": flown.force}
    for name, values in groups.items():
        found |= {f"{name}_{axis}": values[:, i] for i, axis in enumerate("xyz")}
    found |= {f"quat_{axis}": flown.q[:, i] for i, axis in enumerate("xyzw")}
    return found | {f"motor_{i + 1}": flown.motors[:, i] for i in range(4)}


def csv(values: dict[str, np.ndarray]) -> bytes:
    stream = BytesIO()
    np.savetxt(stream, np.column_stack(list(values.values())), "%.12g", ",", header=",".join(values), comments="")
    return stream.getvalue()
