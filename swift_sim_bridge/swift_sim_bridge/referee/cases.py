"""Sealed cases: what is concealed in which flight of which vehicle, all drawn from a family and a seed."""

from dataclasses import dataclass, field, replace

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.recording.flight_channels import CHANNELS
from swift_ros.recording.flight_table import FlightTable
from swift_sim_bridge.referee.catalogue import CONFUSABLE, EFFECTS, conceal, got, written
from swift_sim_bridge.referee.simulator import instruments, paths, vehicles
from swift_sim_bridge.referee.simulator.flight import Order, Truth
from swift_sim_bridge.referee.simulator.rotorpy_flight import HIDES, without_pack

SECONDS = 30.0
MULTIPLES = (0.5, 1.0, 2.0, 4.0, 10.0)
TESTS, REVIEW = range(1_000, 10_000), range(10_000, 1_000_000)  # seeds; those below are for development
LACKING = {  # what a recording may lack
    "no_rotors": ("rotor_speed",),
    "no_velocity": ("v_world",),
    "no_battery": ("voltage", "current"),
    "no_pose": ("p_world", "q_world_body", "v_world"),
    "no_imu": ("gyro_body", "specific_force_body"),
    "no_commands": ("thrust_command", "omega_command_body"),
}
FAMILIES = {
    "null": "nothing concealed",
    "null_sheet": "nothing concealed, and a noise sheet that is wrong by half or double",
    "null_pilot": "nothing concealed, flown with other gains than the vehicle file names",
    "single": "one effect, at 0.5 to 10 times what should be detectable",
    "pair": "two effects",
    "triple": "three effects",
    "confusable": "one effect of a confusable group, in flight that excites all axes",
    "poor": "one effect of a confusable group, in a hover that tells little",
    "knockout": "one effect, taken out of the tool's library",
    "lacking": "one effect, in a recording that lacks channels",
    "sheet": "one effect, and a noise sheet that is wrong by half or double",
    "gusty": "one effect, in rough air",
    "null_slow": "nothing concealed, in a hover or low over the ground",
}
ROUGHNESS, ROUGH = (0.1, 0.6), 4.0  # of the process noise
OTHER_GAINS = ("position_kp", "velocity_kp", "attitude_kp")


@dataclass(frozen=True)
class Hidden:
    """One concealed effect: its name; size in the catalogue's unit; multiple of the detectable size; parameters:
    {path as written: value in the true vehicle file}; nominal: alike in the file that the tool gets."""

    effect: str
    size: float
    multiple: float
    parameters: dict[str, float]
    nominal: dict[str, float]


@dataclass(frozen=True)
class Case:
    """family; seed; vehicle: content of the file that the tool gets; order: the flight, whose content is the true
    vehicle; hidden; removed: effects to take out of the tool's library; channels of the recording; held_out: another
    flight of the true vehicle, for what a repaired file is worth."""

    family: str
    seed: int
    vehicle: dict
    order: Order
    hidden: tuple[Hidden, ...]
    held_out: Order
    removed: tuple[str, ...] = ()
    channels: tuple[str, ...] = ()
    lacking: str = ""
    notes: dict = field(default_factory=dict)

    def record(self, truth: Truth, name: str, number: int = 1) -> FlightTable:
        """Return what instruments wrote of a flight, the case's first, or another of the same vehicle; its name must
        not tell what is hidden."""
        rng = np.random.default_rng([self.seed, 10 + number])
        return instruments.record(truth, self.order.content, rng, channels=self.channels, name=name)

    @property
    def answer(self) -> dict:
        """What is sealed: as JSON has it."""
        return {
            "family": self.family,
            "seed": self.seed,
            "lacking": self.lacking,
            "removed": list(self.removed),
            "hidden": [vars(one) for one in self.hidden],
            **self.notes,
        }


def check_seed(seed: int, review: bool) -> None:
    """Raise UsageError for a seed that is kept for a review."""
    if seed < 0 or seed >= REVIEW.stop:
        raise UsageError(f"the seed {seed} is not from 0 to {REVIEW.stop - 1}")
    if seed >= REVIEW.start and not review:
        raise UsageError(
            f"the seed {seed} is kept for reviews; use 0 to 999 to develop, 1000 to 9999 to test, or say --review"
        )


def draw(family: str, seed: int, effect: str = "", multiple: float = 0.0, plain_pack: bool = False) -> Case:
    """Return the case of a family and a seed; effect and multiple: in place of what would be drawn first.

    plain_pack: the vehicle is one that RotorPy can fly, and so are the effects. Raises UsageError for an unknown family
    or effect.
    """
    for kind, name, known in (("family", family, FAMILIES), ("effect", effect or "mass", EFFECTS)):
        if name not in known:
            raise UsageError(f"the {kind} '{name}' is unknown; known are {', '.join(known)}")
    rng = np.random.default_rng([seed, 101, list(FAMILIES).index(family)])
    nominal = vehicles.draw(rng, f"racer {rng.integers(10**6):06d}")
    nominal = without_pack(nominal) if plain_pack else nominal
    chosen = [(effect, multiple)] if effect else _chosen(family, rng, HIDES if plain_pack else tuple(EFFECTS))
    kind = _kind(family, [name for name, _ in chosen], rng)
    path = _path(rng, nominal, kind, family)
    true, hidden = nominal, []
    for name, factor in chosen:
        true, one = _hide(true, name, factor or float(rng.choice(MULTIPLES)), rng, path)
        hidden.append(one)
    notes = {"path": kind}
    if family in ("null_sheet", "sheet"):
        notes["sheet"] = float(rng.choice([0.5, 2.0]))
        true = true | {"sensors": {key: notes["sheet"] * value for key, value in true["sensors"].items()}}
    pilot = _other_gains(nominal, rng) if family == "null_pilot" else nominal
    roughness = ROUGH if family == "gusty" else float(rng.uniform(*ROUGHNESS))
    order = Order(true, pilot, path, 2 * seed, true["sensors"]["gyro_rad_s"], roughness)
    other = _path(rng, nominal, "gates" if kind in ("lissajous", "hover") else kind, "held out")
    lacking = str(rng.choice(list(LACKING))) if family == "lacking" else ""
    missing = LACKING.get(lacking, ()) + (("voltage", "current") if plain_pack else ())
    return Case(
        family,
        seed,
        nominal,
        order,
        tuple(hidden),
        held_out=replace(order, path=other, seed=2 * seed + 1),
        removed=tuple(one.effect for one in hidden) if family == "knockout" else (),
        channels=tuple(name for name in CHANNELS if name not in missing),
        lacking=lacking,
        notes=notes,
    )


def _kind(family: str, effects: list[str], rng) -> str:
    """Return the kind of path: one that shows the effects."""
    kind = str(rng.choice(["lissajous", "gates", "dives"], p=[0.5, 0.4, 0.1]))
    if family == "poor":
        return "hover"
    if family == "null_slow":
        return str(rng.choice(["hover", "low"]))
    return next((EFFECTS[name].path for name in effects if EFFECTS[name].path), kind)


def _other_gains(content: dict, rng) -> dict:
    """Return the vehicle as a pilot of other habits flies it."""
    gains = {key: content["controller"][key] * float(rng.uniform(0.6, 1.5)) for key in OTHER_GAINS}
    return content | {"controller": content["controller"] | gains}


def _path(rng, nominal, kind, family) -> paths.Path:
    speed = rng.uniform(9.0, 17.0)
    shaking = 0.0 if family in ("poor", "null_slow") else rng.uniform(0.2, 0.8)
    seconds = SECONDS + instruments.LEAD_S
    return paths.draw(rng, kind, seconds, vehicles.top_thrust(nominal), speed, shaking)


def _chosen(family: str, rng, known) -> list[tuple[str, float]]:
    """Return the effects that a family conceals, and multiples of what is detectable; 0: any."""
    if family.startswith("null"):
        return []
    if family in ("confusable", "poor"):
        groups = [[name for name in group if name in known] for group in CONFUSABLE]
        groups = [group for group in groups if len(group) > 1]
        group = groups[rng.integers(len(groups))]
        return [(str(rng.choice(group)), float(rng.choice([3.0, 6.0, 10.0])))]
    if family in ("pair", "triple"):
        count = 2 if family == "pair" else 3
        names = [str(name) for name in rng.choice(known, count, replace=False)]
        return [(name, float(rng.choice([3.0, 6.0, 10.0]))) for name in names]
    factor = 0.0 if family == "single" else float(rng.choice([3.0, 6.0, 10.0]))
    return [(str(rng.choice(known)), factor)]


def _hide(content: dict, name: str, multiple: float, rng, path: paths.Path) -> tuple[dict, Hidden]:
    """Return the content with an effect in it, no larger than is plausible, and what to seal of it."""
    effect = EFFECTS[name]
    size = min(multiple * effect.detectable, effect.largest)
    values = effect.planted(content, size, rng)
    if name == "local_draught":
        place = path.p[rng.integers(len(path.p) // 4, len(path.p))]
        values |= {("terms", "local_draught", "center", i): float(place[i]) for i in range(3)}
    values = {at: vehicles.plain(value) for at, value in values.items()}
    nominal = {written(at): got(content, at, effect.idle) for at in values}
    sealed = {written(at): value for at, value in values.items()}
    return conceal(content, values), Hidden(name, size, size / effect.detectable, sealed, nominal)
