"""The terms that an equation must contain to describe an effect that was knocked out of the tool's catalogue.

A term is "CHANNEL: QUANTITY", of the `channel` and `quantity` of an entry of the report. An expectation is a list of
regular expressions over such terms. They follow from the effects' equations (`plant`, `instruments`), with the tool's
identifiers of channels. A quantity also accepts those
that are similar in flight: for a speed its powers and its products with rotor speed or thrust, for a modelled drag the
speed that causes it. Of a vector, those entries count that are at least half of the largest, each on the axes on which
it acts.
"""

import re
from collections.abc import Callable, Iterable

AXES, AXIS_CYCLES = "xyz", ("xyz", "yzx", "zxy")
MIN_SHARE_OF_LARGEST = 0.5  # of a vector's largest change: smaller entries need not be found
# quantities of channels; the identifier of a vector's channel is QUANTITY_AXIS
SPECIFIC_FORCE, ANGULAR_ACCELERATION, GYRO = "specific_force", "angular_acceleration", "gyro"
ACCELEROMETER, VIO_VELOCITY = "accelerometer", "vio_velocity"
ACCELEROMETERS = f"({SPECIFIC_FORCE}|{ACCELEROMETER})"  # channels that read the accelerometer
ROTOR_SPEED, POWER, THROTTLE_COMMAND = r"rotor_speed_\d", "electrical_power", "throttle_command"
RATES = {"x": "roll", "y": "pitch", "z": "yaw"}

THRUST = r"thrust( of rotor \d)?"
SINK_SPEED = r"((\|v\||Omega|thrust) )?v_z|min\(v_z, 0\)|thrust sink \(2 - sink\)"
LATERAL_SPEED = r"v_xy\^2|\|v\|"
STEADY_SPEED = r"u|(U )?sqrt\(u\)|Omega"  # quantities on which a motor's steady speed depends
SPEED_CHANGE = r"Omega'|min\(Omega', 0\)"
ELECTRICAL_LOAD = r"current|sum Omega\^3"
# quantities of the laws in `simulator.blind`: velocity alone, or with rotor speed or thrust; of a rotor's gyroscopic
# moment and thrust; of the thrust, or of what pulls along x
AIR_VELOCITY = (
    r"((Omega|thrust) )?(\|v\| )?(\|v\||v_[xyz]|v_xy\^2|v_xy v_z|v_[xyz] v_[xyz]|min\(v_z, 0\))|modelled force [xy]"
)
TURNING_ROTOR = rf"{THRUST}|(sum of spin Omega )?omega_[xy]"
THRUST_OR_PULL = rf"1|{THRUST}|((thrust|Omega|\|v\|) )?v_x|modelled force x"

Quantity = Callable[[str], str]  # expression for an axis; empty where there is none
Expectation = Callable[[str, str, str], Iterable[str]]  # expressions for the first of three axes in cyclic order
ExpectedTerms = Callable[[dict], list[str]]  # expressions for the changes of an effect's parameters, by path


def speed(axis: str) -> str:
    """Return quantities that depend on the airspeed along an axis."""
    return rf"((\|v\||Omega|thrust) )?v_{axis}" + (r"|min\(v_z, 0\)" if axis == "z" else "")


def drag(axis: str) -> str:
    """Return quantities that depend on the airspeed, or on the drag of the vehicle file."""
    return speed(axis) + (f"|modelled force {axis}" if axis != "z" else "")


def thrust(axis: str) -> str:
    """Return quantities that depend on the thrust, which acts along z."""
    return THRUST if axis == "z" else ""


def specific_force(axis: str) -> str:
    """Return quantities that depend on the specific force."""
    return thrust(axis) or drag(axis)


def force_rate(axis: str) -> str:
    """Return quantities that depend on the time derivative of the specific force."""
    return f"rate of modelled force {axis}"


def angular_acceleration(axis: str) -> str:
    """Return quantities that depend on the angular acceleration."""
    return f"modelled turn {axis}"


def torque(axis: str) -> str:
    """Return quantities that depend on the rotors' torque."""
    return rf"modelled turn {axis}|thrust of rotor \d"


def rate(axis: str) -> str:
    """Return quantities that depend on the body rate."""
    return f"omega_{axis}"


def constant(axis: str) -> str:
    """Return the constant quantity."""
    return "1"


def wind(axis: str) -> str:
    """Return quantities of a wind along the world's axes, in the body frame."""
    return f"(east|north|up)_{axis}"


def draught(axis: str) -> str:
    """Return quantities of a wind everywhere or at one place."""
    return wind(axis) + "( within .*)?"


def growing_with_time(quantity: Quantity) -> Quantity:
    """Return a quantity times the time."""
    return lambda axis: f"t {quantity(axis)}"


def _expression(channel: str, axis: str, quantity: str) -> list[str]:
    """Return the expression of a quantity on an axis of a channel, none if the quantity is empty."""
    return [f"{channel}_{axis}: ({quantity})"] if quantity else []


def on_channel(channel: str, quantity: str) -> Expectation:
    """Expect one channel to depend on one quantity."""
    return lambda a, b, c: [f"{channel}: ({quantity})"]


def along_axes(channel: str, quantity: Quantity, axes: str = AXES) -> Expectation:
    """Expect each axis of a channel to depend on the quantity along it."""
    return lambda a, b, c: _expression(channel, a, quantity(a)) if a in axes else []


def cross_product(channel: str, quantity: Quantity) -> Expectation:
    """Expect a cross product with a quantity.

    An entry along one axis acts on the second axis with the third's quantity, and on the third with the second's.
    """
    return lambda a, b, c: [*_expression(channel, b, quantity(c)), *_expression(channel, c, quantity(b))]


def product(a: str, b: str) -> str:
    """Return the quantity of two body rates' product."""
    return " ".join(f"omega_{axis}" for axis in sorted((a, b)))


def centripetal(channel: str) -> Expectation:
    """Expect the centripetal acceleration omega x (omega x r) of a lever arm r."""
    return lambda a, b, c: [
        *_expression(channel, a, f"{product(b, b)}|{product(c, c)}"),
        *_expression(channel, b, product(a, b)),
        *_expression(channel, c, product(a, c)),
    ]


def inertia_coupling(a: str, b: str, c: str) -> list[str]:
    """Expect omega x J omega of a moment of inertia, which acts on the two other axes."""
    return [*_expression(ANGULAR_ACCELERATION, b, product(a, c)), *_expression(ANGULAR_ACCELERATION, c, product(a, b))]


def rate_sent(a: str, b: str, c: str) -> list[str]:
    """Expect commanded rates with a scale error."""
    return [rf"rate_command_{RATES[a]}: rate sent {a}(\^3)?"]


def delayed_commands(a: str, b: str, c: str) -> list[str]:
    """Expect the time derivative of the command, to which the error of a late or lost command is proportional."""
    return [
        f"rate_command_{RATES[a]}: slope of rate sent {a}",
        f"{THROTTLE_COMMAND}: slope of throttle",
    ]


def on_any_axis(*parts: Expectation) -> ExpectedTerms:
    """Expect an effect on any of its axes."""
    expressions = [expression for part in parts for axes in AXIS_CYCLES for expression in part(*axes)]
    return lambda changes: expressions


def on_large_axes(*parts: Expectation) -> ExpectedTerms:
    """Expect an effect on the axes on which the large entries of its vector act."""
    return lambda changes: [
        expression for part in parts for i in large_entries(changes) for expression in part(*AXIS_CYCLES[i])
    ]


def large_entries(changes: dict) -> list[int]:
    """Return the indices of entries whose change is at least half of the largest."""
    least = MIN_SHARE_OF_LARGEST * max(abs(change) for change in changes.values())
    return [int(re.search(r"\[(\d+)\]$", path)[1]) for path, change in changes.items() if abs(change) >= least]


def rotor_own_speed(changes: dict) -> list[str]:
    """Expect the speed of the rotor with the effect."""
    return [f"rotor_speed_{i + 1}: ({STEADY_SPEED})" for i in large_entries(changes)]


def rotor_own_thrust(changes: dict) -> list[str]:
    """Expect the thrust of the damaged rotor, in force and moment."""
    own = rf"thrust( of rotor {changes['terms.damaged_propeller.rotor']:.0f})?"
    return [f"{SPECIFIC_FORCE}_z: {own}", f"{ANGULAR_ACCELERATION}_[xy]: {own}"]
