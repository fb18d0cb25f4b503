"""The mapping of ArduPilot's messages in a DataFlash log.

ArduPilot's world is north-east-down and its body forward-right-down. The motors are found among the outputs by their
functions (SERVOn_FUNCTION), where the log has them.
"""

from swift_ros.recording.log_formats.log import Log
from swift_ros.recording.log_mapping.mapping import MAX_ROTORS, ChannelSource, Mapping
from swift_ros.recording.log_mapping.quantities import RANGES

ORDER = (
    "motors have ArduPilot's order; on its quadrotor x that is front right, rear left, front left, rear right, the "
    "first two with counter-clockwise propellers: list the rotors of the vehicle file, or these columns, accordingly"
)
OWN_ESTIMATE = "the pose is the estimate of ArduPilot's own filter, which uses the same gyro and accelerometer"
LOGGED_RATES = "for 50 rows a second and more, add fast attitude, fast IMU and RCOUT to LOG_BITMASK"
FIRST_MOTOR = (33.0, 82.0)  # functions of an output: motors 1 to 8, motors 9 to 12
PULSES = ("MIN", RANGES["us"][0]), ("MAX", RANGES["us"][1])  # of MOT_PWM_, us, where the log does not have them
MOTORS = {1.0: 4, 2.0: 6, 3.0: 8, 4.0: 8, 5.0: 6, 7.0: 3, 12.0: 12}  # by FRAME_CLASS
Q = ("Q2", "Q3", "Q4", "Q1")

# Candidates of each channel in the order of preference: messages and columns.
GYROS = [(name, ("GyrX", "GyrY", "GyrZ")) for name in ("IMU[0]", "IMU", "IMU[1]", "IMU2")]
FORCES = [(name, ("AccX", "AccY", "AccZ")) for name in ("IMU[0]", "IMU", "IMU[1]", "IMU2")]
POSITIONS = [(name, ("PN", "PE", "PD")) for name in ("SIM2", "XKF1[0]", "XKF1", "NKF1[0]", "NKF1", "EKF1")]
VELOCITIES = {name: ("VN", "VE", "VD") for name, _ in POSITIONS}
ATTITUDES = [(name, Q) for name in ("XKQ[0]", "XKQ1", "NKQ1", "AHR2")]
EULER = [("SIM", ("Roll", "Pitch", "Yaw")), ("ATT", ("Roll", "Pitch", "Yaw"))]


def guess(log: Log) -> Mapping:
    """Return the mapping of ArduPilot's messages."""
    channels: dict[str, ChannelSource] = {}
    notes: list[str] = []

    def first(channel: str, candidates, **keys) -> None:
        for topic, columns in candidates:
            present = log.topics[topic].columns if topic in log.topics else {}
            if all(column in present for column in columns) and any(present[column].any() for column in columns):
                channels[channel] = ChannelSource(tuple(columns), topic, **keys)
                return

    first("p_world", POSITIONS, world="NED")
    simulated = "p_world" in channels and channels["p_world"].topic == "SIM2"
    if "p_world" in channels:
        topic = channels["p_world"].topic
        first("v_world", [(topic, VELOCITIES[topic])], world="NED")
    first("q_world_body", EULER[1:], unit="deg", world="NED", body="FRD")
    first("q_world_body", ATTITUDES, world="NED", body="FRD")
    if simulated:
        first("q_world_body", EULER[:1], unit="deg", world="NED", body="FRD")
    elif "q_world_body" in channels:
        notes.append(OWN_ESTIMATE)
    _faster_attitude(log, channels)
    first("gyro_body", GYROS, body="FRD")
    first("specific_force_body", FORCES, body="FRD")
    channels |= _motors(log)
    first("omega_command_body", [("RATE", ("RDes", "PDes", "YDes"))], unit="deg/s", body="FRD")
    first("p_vio", [("VISP", ("PX", "PY", "PZ"))], world="NED")
    if "p_vio" in channels:
        euler = "Roll", "Pitch", "Yaw"
        first("q_vio_body", [("VISP", euler)], unit="deg", world="NED", body="FRD")
    batteries = ("BAT[0]", "BAT", "CURR[0]", "CURR")
    first("voltage", [(name, ("Volt",)) for name in batteries], **_centi(log, "CURR", "Volt"))
    first("current", [(name, ("Curr",)) for name in batteries], **_centi(log, "CURR", "Curr"))
    if "motor_command" in channels or "rotor_speed" in channels:
        notes.append(ORDER)
    return Mapping(channels, notes=tuple(notes))


def _centi(log: Log, topic: str, column: str) -> dict[str, float]:
    """Return the scale of the battery's values: firmware before 2016 wrote hundredths in whole numbers."""
    if any(name.startswith("BAT") for name in log.topics) or topic not in log.topics:
        return {}
    values = log.topics[topic].columns.get(column)
    return {"scale": 0.01} if values is not None and values.dtype.kind in "iu" else {}


def _faster_attitude(log: Log, channels: dict[str, ChannelSource]) -> None:
    """Take ATT's angles where they have more rows than the quaternion: it is often logged faster than the filter."""
    chosen, angles = channels.get("q_world_body"), log.topics.get("ATT")
    if not chosen or not angles or chosen.topic == "SIM" or not set(EULER[1][1]) <= set(angles.columns):
        return
    if len(angles.t) > len(log.topics[chosen.topic].t):
        channels["q_world_body"] = ChannelSource(EULER[1][1], "ATT", "deg", "NED", "FRD")


def _motors(log: Log) -> dict[str, ChannelSource]:
    """Return the sources of motor commands and rotor speeds."""
    found = {}
    topic = next((name for name in ("RCOU[0]", "RCOU") if name in log.topics), None)
    if topic and (columns := _outputs(log, topic)):
        low, high = (log.parameters.get(f"MOT_PWM_{end}") or pulse for end, pulse in PULSES)
        found["motor_command"] = ChannelSource(columns, topic, "us", range=(low, high) if low < high else None)
    escs = [name for name in (f"ESC[{i}]" for i in range(MAX_ROTORS)) if name in log.topics]
    if not escs:
        escs = [name for name in (f"ESC{i}" for i in range(1, MAX_ROTORS + 1)) if name in log.topics]
    if escs and all("RPM" in log.topics[name].columns for name in escs):
        found["rotor_speed"] = ChannelSource(tuple(f"{name}:RPM" for name in escs), unit="rpm")
    return found


def _outputs(log: Log, topic: str) -> tuple[str, ...]:
    """Return the columns of the outputs with motors, in the order of the motors."""
    prefix = "C" if "C1" in log.topics[topic].columns else "Ch" if "Ch1" in log.topics[topic].columns else "Chan"
    by_motor = {}
    for output in range(1, 15):
        function = log.parameters.get(f"SERVO{output}_FUNCTION", 0.0)
        for i, first in enumerate(FIRST_MOTOR):
            if 0 <= function - first < (8, 4)[i]:
                by_motor[function - first + 8 * i] = f"{prefix}{output}"
    count = MOTORS.get(log.parameters.get("FRAME_CLASS", 1.0), 4)
    columns = tuple(by_motor[i] for i in sorted(by_motor)) or tuple(f"{prefix}{i + 1}" for i in range(count))
    return columns if all(column in log.topics[topic].columns for column in columns) else ()
