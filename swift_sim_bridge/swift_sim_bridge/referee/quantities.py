"""What an equation must go by that stands for an effect without a name: regular expressions over a report's terms,
"channel: quantity" each.

They follow from the effects' equations (`plant`, `instruments`), for channels as the tool calls them. A quantity stands
for what is like it in flight, too: a speed for its powers and its products with rotor speed or thrust, a modelled drag
for the speed that makes it. Of a vector those numbers count that are at least half of its largest, each on the axes on
which it acts.
"""

import re
from collections.abc import Callable, Iterable

AXES, TURNED = "xyz", ("xyz", "yzx", "zxy")
SUBSTANTIAL = 0.5
FORCE, TURN, GYRO = "specific force", "angular acceleration", "pose's less gyro's rate"
ACCELERATION, VELOCITY = "pose's less accelerometer's force", "VIO's less the pose's velocity"
FELT = f"({FORCE}|{ACCELERATION})"  # where the accelerometer is read
ROTOR, POWER, RATES = r"rotor \d speed", "electrical power", {"x": "roll", "y": "pitch", "z": "yaw"}

THRUST = r"thrust( of rotor \d)?"
SINKING = r"((\|v\||Omega|thrust) )?v_z|min\(v_z, 0\)|thrust sink \(2 - sink\)"
SIDEWAYS = r"v_xy\^2|\|v\|"
STEADY = r"u|(U )?sqrt\(u\)|Omega"  # what a motor's steady speed goes by
CHANGING = r"Omega'|min\(Omega', 0\)"
LOAD = r"current|sum Omega\^3"

Quantity = Callable[[str], str]  # along an axis; empty where there is none
Part = Callable[[str, str, str], Iterable[str]]  # expressions for what lies along the first of three axes, in turn
Shows = Callable[[dict], list[str]]  # expressions for the changes of an effect's numbers, by path


def speed(axis: str) -> str:
    """Return what goes by the speed through the air along an axis."""
    return rf"((\|v\||Omega|thrust) )?v_{axis}" + (r"|min\(v_z, 0\)" if axis == "z" else "")


def drag(axis: str) -> str:
    """Return what goes by the speed, and by the drag that the file has."""
    return speed(axis) + (f"|modelled force {axis}" if axis != "z" else "")


def thrust(axis: str) -> str:
    """Return what goes by the thrust, which has but one axis."""
    return THRUST if axis == "z" else ""


def push(axis: str) -> str:
    """Return what goes by the whole specific force."""
    return thrust(axis) or drag(axis)


def jerk(axis: str) -> str:
    """Return what goes by the slope of the specific force."""
    return f"rate of modelled force {axis}"


def turning(axis: str) -> str:
    """Return what goes by the angular acceleration."""
    return f"modelled turn {axis}"


def torque(axis: str) -> str:
    """Return what goes by the rotors' torque."""
    return rf"modelled turn {axis}|thrust of rotor \d"


def rate(axis: str) -> str:
    """Return what goes by the body rate."""
    return f"omega_{axis}"


def constant(axis: str) -> str:
    """Return what is always the same."""
    return "1"


def wind(axis: str) -> str:
    """Return what goes by air that moves along the world's axes, seen from the body."""
    return f"(east|north|up)_{axis}"


def draught(axis: str) -> str:
    """Return what goes by such air, everywhere or at one place."""
    return wind(axis) + "( within .*)?"


def growing(quantity: Quantity) -> Quantity:
    """Return a quantity times the time."""
    return lambda axis: f"t {quantity(axis)}"


def _on(channel: str, axis: str, quantity: str) -> list[str]:
    return [f"{channel} {axis}: ({quantity})"] if quantity else []


def at(channel: str, quantity: str) -> Part:
    """Expect one channel to go by one quantity."""
    return lambda a, b, c: [f"{channel}: ({quantity})"]


def along(channel: str, quantity: Quantity, axes: str = AXES) -> Part:
    """Expect each of the axes to go by the quantity along it."""
    return lambda a, b, c: _on(channel, a, quantity(a)) if a in axes else []


def across(channel: str, quantity: Quantity) -> Part:
    """Expect a cross product with a quantity: what lies along one axis acts on the second by the third's, and the other
    way round."""
    return lambda a, b, c: [*_on(channel, b, quantity(c)), *_on(channel, c, quantity(b))]


def product(a: str, b: str) -> str:
    """Return what goes by two body rates."""
    return " ".join(f"omega_{axis}" for axis in sorted((a, b)))


def swung(channel: str) -> Part:
    """Expect omega x (omega x r) of an arm r."""
    return lambda a, b, c: [
        *_on(channel, a, f"{product(b, b)}|{product(c, c)}"),
        *_on(channel, b, product(a, b)),
        *_on(channel, c, product(a, c)),
    ]


def coupled(a: str, b: str, c: str) -> list[str]:
    """Expect omega x J omega of a moment of inertia, which acts on the axes that are not its own."""
    return [*_on(TURN, b, product(a, c)), *_on(TURN, c, product(a, b))]


def rate_sent(a: str, b: str, c: str) -> list[str]:
    """Expect rates to be bent."""
    return [rf"{RATES[a]} rate received less sent: rate sent {a}(\^3)?"]


def late(a: str, b: str, c: str) -> list[str]:
    """Expect slopes: so much is missing of a command that comes late, or not at all."""
    return [f"{RATES[a]} rate received less sent: slope of rate sent {a}", "throttle received less sent: slope of throttle"]


def whole(*parts: Part) -> Shows:
    """Expect an effect on any of its axes."""
    expressions = [expression for part in parts for axes in TURNED for expression in part(*axes)]
    return lambda changes: expressions


def vector(*parts: Part) -> Shows:
    """Expect an effect on the axes on which the larger numbers of its vector act."""
    return lambda changes: [expression for part in parts for i in large(changes) for expression in part(*TURNED[i])]


def large(changes: dict) -> list[int]:
    """Return the places in a list of the numbers that change at least half as much as the one that changes most."""
    least = SUBSTANTIAL * max(abs(change) for change in changes.values())
    return [int(re.search(r"\[(\d+)\]$", path)[1]) for path, change in changes.items() if abs(change) >= least]


def fast_rotor(changes: dict) -> list[str]:
    """Expect a rotor's own speed."""
    return [f"rotor {i + 1} speed: ({STEADY})" for i in large(changes)]


def weak_rotor(changes: dict) -> list[str]:
    """Expect the thrust of one rotor, also in what turns the vehicle."""
    own = rf"thrust( of rotor {changes['terms.damaged_propeller.rotor']:.0f})?"
    return [f"{FORCE} z: {own}", f"{TURN} [xy]: {own}"]
