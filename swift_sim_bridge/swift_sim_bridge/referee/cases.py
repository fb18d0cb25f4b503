"""Sealed cases: what is concealed in which flight of which vehicle, all drawn from a family and a seed."""

from dataclasses import dataclass, field, replace

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.recording.flight_channels import CHANNELS
from swift_ros.recording.flight_table import FlightTable
from swift_sim_bridge.referee.effects.catalogue import EFFECTS
from swift_sim_bridge.referee.effects.changes import CHANGES, CHANGES_OF_ROTORPY, FACTORS, FAR
from swift_sim_bridge.referee.effects.laws import BLIND, RELATED, STRANGE
from swift_sim_bridge.referee.effects.planting import conceal, path_text, value_at
from swift_sim_bridge.referee.simulator import foreign_logger, instruments, paths, vehicles
from swift_sim_bridge.referee.simulator.flight import Order, Truth
from swift_sim_bridge.referee.simulator.rotorpy_flight import EFFECTS_OF_ROTORPY, without_battery

SECONDS = 30.0  # duration of a recording
MULTIPLES = (0.5, 1.0, 2.0, 4.0, 10.0)  # sizes of single effects, relative to the detectable size
TEST_SEEDS, REVIEW_SEEDS = range(1_000, 10_000), range(10_000, 1_000_000)  # lower seeds are for development
MISSING_CHANNELS = {  # channels that a recording of the family `lacking` may miss
    "no_rotors": ("rotor_speed",),
    "no_velocity": ("v_world",),
    "no_battery": ("voltage", "current"),
    "no_pose": ("p_world", "q_world_body", "v_world"),
    "no_imu": ("gyro_body", "specific_force_body"),
    "no_commands": ("thrust_command", "omega_command_body"),
}
FAMILIES = {
    "null": "no effect",
    "null_sheet": "no effect, and a noise sheet that is wrong by a factor of 0.5 or 2",
    "null_pilot": "no effect, flown with other gains than those of the vehicle file",
    "single": "one effect, at 0.5 to 10 times the detectable size",
    "pair": "two effects",
    "triple": "three effects",
    "confusable": "one effect of a confusable group, in a flight that excites all axes",
    "poor": "one effect of a confusable group, in a hover, which shows little",
    "knockout": "one effect, removed from the tool's catalogue",
    "lacking": "one effect, in a recording with missing channels",
    "sheet": "one effect, and a noise sheet that is wrong by a factor of 0.5 or 2",
    "gusty": "one effect, with strong process noise",
    "null_slow": "no effect, in a hover or low over the ground",
    "null_foreign": "no effect, by a foreign logger (see `foreign_logger`); half of the files have small errors",
    "foreign": "one effect, recorded likewise",
    "foreign_pair": "two effects, recorded likewise",
    "strange": "physics that no effect of the tool's catalogue names",
    "null_pose_commands": "no effect, in a recording of pose and motor commands alone",
    "pose_commands": "a cut propeller, a hung weight, a heavier battery or a weaker pack, recorded likewise",
    "far": "a file in which a motor lag, a drag or the pack's resistance is wrong by a factor of 3, 10 or 30",
    "strange_blind": "physics that no effect names, by an author who had not read the tool; each law in turn",
}
STRANGE_FAMILIES = ("strange", "strange_blind")
KNOWN = EFFECTS | STRANGE | BLIND
POSE_AND_COMMANDS = ("p_world", "q_world_body", "motor_command")
SMALL_EFFECTS = {  # effects of which the file of a foreign recording has small errors, by generator: own, RotorPy
    False: (
        "mass inertia com_offset thrust_axis_tilt thrust_coefficient torque_coefficient motor_time_constant motor_map "
        "rotor_gain battery_sag rotor_drag body_drag flapping_moment gyro_bias gyro_scale accel_bias accel_scale"
    ),
    True: "mass inertia thrust_coefficient motor_time_constant rotor_drag body_drag gyro_bias accel_bias",
}
SMALL_COUNT, SMALL = 5, (0.05, 0.2)  # of these errors; their sizes relative to the detectable size
ROUGHNESS, STRONG_ROUGHNESS = (0.1, 0.6), 4.0  # scale of the process noise (see `disturbances`)
SPEEDS, RACE_SPEEDS = (9.0, 17.0), (16.0, 21.0)  # largest speed of a path, m/s
VARIED_GAINS = ("position_kp", "velocity_kp", "attitude_kp")
CONFUSABLE = (
    ("mass", "thrust_coefficient", "accel_scale"),
    ("motor_time_constant", "command_latency", "time_offset"),
    ("rotor_drag", "linear_drag", "body_drag"),
    ("wind", "accel_bias", "thrust_axis_tilt", "com_offset"),
    ("com_offset", "damaged_propeller", "payload"),
    ("imu_lever_arm", "marker_offset", "accel_bias", "lift_cross"),
    ("axial_inflow", "body_drag", "vortex_ring", "translational_lift"),
    ("inertia", "thrust_coefficient", "motor_time_constant"),
    ("rate_scale", "gyro_scale", "gyro_bias"),
    ("dropped_commands", "command_latency"),
)  # groups of effects with similar residuals


@dataclass(frozen=True)
class Hidden:
    """One hidden effect.

    Attributes:
        effect: key of the catalogue.
        size: size in the catalogue's unit.
        multiple: size relative to the detectable size.
        parameters: {path: value in the true vehicle file}.
        nominal: {path: value in the vehicle file that the tool gets}.
    """

    effect: str
    size: float
    multiple: float
    parameters: dict[str, float]
    nominal: dict[str, float]


@dataclass(frozen=True)
class Case:
    """One case.

    Attributes:
        family: key of FAMILIES.
        seed: seed of the case.
        vehicle: content of the vehicle file that the tool gets.
        order: the flight; its content is the true vehicle.
        hidden: the hidden effects.
        held_out: another flight of the true vehicle, for the evaluation of the repaired file.
        removed: effects to remove from the tool's catalogue.
        channels: channels of the recording.
        logger: how the recording is written; None for the rows of the rate loop.
        lacking: key of MISSING_CHANNELS, empty if none is missing.
        notes: further entries of the answer.
    """

    family: str
    seed: int
    vehicle: dict
    order: Order
    hidden: tuple[Hidden, ...]
    held_out: Order
    removed: tuple[str, ...] = ()
    channels: tuple[str, ...] = ()
    logger: foreign_logger.Logger | None = None
    lacking: str = ""
    notes: dict = field(default_factory=dict)

    def record(self, truth: Truth, name: str, number: int = 1) -> FlightTable:
        """Return the recording of a flight of this vehicle.

        Args:
            truth: the flight.
            name: name of the recording; it must contain no information on the hidden effects.
            number: 1 for the case's flight, another number for another one: it has other measurement noise.
        """
        rng = np.random.default_rng([self.seed, 10 + number])
        if self.logger:
            return foreign_logger.record(truth, self.order.content, rng, self.logger, self.channels, name)
        return instruments.record(truth, self.order.content, rng, channels=self.channels, name=name)

    @property
    def answer(self) -> dict:
        """The sealed answer, for JSON."""
        return {
            "family": self.family,
            "seed": self.seed,
            "lacking": self.lacking,
            "removed": list(self.removed),
            "hidden": [vars(one) for one in self.hidden],
            **self.notes,
        }


def check_seed(seed: int, review: bool) -> None:
    """Raise UsageError if a seed is out of range, or reserved for reviews and `review` is false."""
    if seed < 0 or seed >= REVIEW_SEEDS.stop:
        raise UsageError(f"the seed {seed} is not from 0 to {REVIEW_SEEDS.stop - 1}")
    if seed >= REVIEW_SEEDS.start and not review:
        raise UsageError(
            f"the seed {seed} is kept for reviews; use 0 to 999 to develop, 1000 to 9999 to test, or give --review"
        )


def draw_case(family: str, seed: int, effect: str = "", multiple: float = 0.0, for_rotorpy: bool = False) -> Case:
    """Return the case of a family and a seed.

    Args:
        family: key of FAMILIES.
        seed: seed of the case.
        effect: hidden effect; drawn if empty.
        multiple: its size relative to the detectable size; drawn if 0.
        for_rotorpy: whether vehicle and effects are limited to what RotorPy simulates.

    Raises:
        UsageError: the family or the effect is unknown.
    """
    _check_names(family, effect)
    rng = np.random.default_rng([seed, 101, list(FAMILIES).index(family)])
    nominal = vehicles.draw_vehicle(rng, f"racer {rng.integers(10**6):06d}")
    nominal = without_battery(nominal) if for_rotorpy else nominal
    known = EFFECTS_OF_ROTORPY if for_rotorpy else tuple(EFFECTS)
    chosen = [(effect, multiple)] if effect else _chosen(family, seed, rng, known)
    names = [name for name, _ in chosen]
    kind = _kind(family, names, rng)
    path = _path(rng, nominal, kind, family)
    true, hidden = _hide_all(nominal, chosen, rng, path)
    notes = {"path": kind}
    if family == "pose_commands":
        true, one, notes["change"] = _with_change(true, seed, rng, for_rotorpy)
        hidden.append(one)
    if family in ("null_sheet", "sheet"):
        notes["sheet"] = float(rng.choice([0.5, 2.0]))
        true = true | {"sensors": {key: notes["sheet"] * value for key, value in true["sensors"].items()}}
    file = nominal
    if family == "far":
        file, one, notes["factor"] = _far_file(nominal, seed, rng, for_rotorpy)
        hidden.append(one)
    logger = None
    if "foreign" in family:
        logger = foreign_logger.draw_logger(rng)
        true, notes["small"] = _with_small_errors(true, names, rng, path, for_rotorpy)
        notes |= logger.notes
    order = _order(family, seed, rng, true, nominal, path)
    other = _path(rng, nominal, "gates" if kind in ("lissajous", "hover") else kind, "held out")
    lacking = str(rng.choice(list(MISSING_CHANNELS))) if family == "lacking" else ""
    if "pad" in names:  # another path would miss the place
        other = path
    return Case(
        family,
        seed,
        file,
        order,
        tuple(hidden),
        held_out=replace(order, path=other, seed=2 * seed + 1),
        removed=_removed(family, hidden),
        channels=_recorded_channels(family, lacking, for_rotorpy),
        logger=logger,
        lacking=lacking,
        notes=notes,
    )


def _check_names(family: str, effect: str):
    """Raise UsageError if a family, or an effect that is not empty, is unknown."""
    for kind, name, known in (("family", family, FAMILIES), ("effect", effect or "mass", KNOWN)):
        if name not in known:
            raise UsageError(f"the {kind} '{name}' is unknown; known are {', '.join(known)}")


def _order(family: str, seed: int, rng, true: dict, nominal: dict, path: paths.Path) -> Order:
    """Return the flight of a true vehicle that is flown as the nominal one, along a path."""
    pilot = _other_gains(nominal, rng) if family == "null_pilot" else nominal
    roughness = STRONG_ROUGHNESS if family == "gusty" else float(rng.uniform(*ROUGHNESS))
    return Order(true, pilot, path, 2 * seed, true["sensors"]["gyro_rad_s"], roughness)


def _with_change(content: dict, seed: int, rng, for_rotorpy: bool) -> tuple[dict, dict, str]:
    """Return the vehicle with one of CHANGES, in turn of the seeds; what was hidden, and the change's name."""
    known = CHANGES_OF_ROTORPY if for_rotorpy else tuple(CHANGES)
    change = known[seed % len(known)]
    name, plant, sizes = CHANGES[change]
    size = float(rng.uniform(*sizes))
    return *_concealed(content, name, size, plant(content, size, rng)), change


def _recorded_channels(family: str, lacking: str, for_rotorpy: bool) -> tuple[str, ...]:
    """Return the channels that the recording has. RotorPy has no battery."""
    if "pose_commands" in family:
        return tuple(name for name in CHANNELS if name in POSE_AND_COMMANDS)
    missing = MISSING_CHANNELS.get(lacking, ()) + (("voltage", "current") if for_rotorpy else ())
    return tuple(name for name in CHANNELS if name not in missing)


def _removed(family: str, hidden) -> tuple[str, ...]:
    """Return the effects to remove from the tool's catalogue."""
    if family == "strange":
        return tuple(name for one in hidden for name in RELATED.get(one.effect, ()))
    return tuple(one.effect for one in hidden) if family == "knockout" else ()


def _kind(family: str, effects: list[str], rng) -> str:
    """Return the kind of path: drawn, but one that shows the effects."""
    kind = str(rng.choice(["lissajous", "gates", "dives"], p=[0.5, 0.4, 0.1]))
    if family == "poor":
        return "hover"
    if family == "null_slow":
        return str(rng.choice(["hover", "low"]))
    if "pose_commands" in family:
        return str(rng.choice(["lissajous", "gates", "hover"], p=[0.4, 0.4, 0.2]))
    return next((KNOWN[name].path for name in effects if KNOWN[name].path), kind)


def _other_gains(content: dict, rng) -> dict:
    """Return the content of the vehicle file with other gains of the outer loops."""
    gains = {key: content["controller"][key] * float(rng.uniform(0.6, 1.5)) for key in VARIED_GAINS}
    return content | {"controller": content["controller"] | gains}


def _path(rng, nominal, kind, family) -> paths.Path:
    """Return a random path of a kind that the vehicle can fly."""
    speed = rng.uniform(*(RACE_SPEEDS if kind == "race" else SPEEDS))
    shaking = 0.0 if family in ("poor", "null_slow") else rng.uniform(0.2, 0.8)
    seconds = SECONDS + instruments.LEAD_S
    return paths.draw_path(rng, kind, seconds, vehicles.top_thrust(nominal), speed, shaking)


def _chosen(family: str, seed: int, rng, known) -> list[tuple[str, float]]:
    """Return the hidden effects of a family and their sizes relative to the detectable size; 0: drawn later."""
    if family.startswith("null") or family in ("pose_commands", "far"):
        return []
    if family in ("confusable", "poor"):
        groups = [[name for name in group if name in known] for group in CONFUSABLE]
        groups = [group for group in groups if len(group) > 1]
        group = groups[rng.integers(len(groups))]
        return [(str(rng.choice(group)), float(rng.choice([3.0, 6.0, 10.0])))]
    if family in ("pair", "triple", "foreign_pair"):
        count = 3 if family == "triple" else 2
        names = [str(name) for name in rng.choice(known, count, replace=False)]
        return [(name, float(rng.choice([3.0, 6.0, 10.0]))) for name in names]
    if family == "strange":
        return [(str(rng.choice(list(STRANGE))), float(rng.choice([3.0, 6.0, 10.0])))]
    if family == "strange_blind":
        law = tuple(BLIND)[seed % len(BLIND)]
        return [(law, BLIND[law].largest / BLIND[law].detectable)]
    factor = 0.0 if family == "single" else float(rng.choice([3.0, 6.0, 10.0]))
    return [(str(rng.choice(known)), factor)]


def _with_small_errors(content: dict, hidden: list[str], rng, path, for_rotorpy: bool) -> tuple[dict, list[str]]:
    """Return the content with small errors of other effects than the hidden ones, in half of the cases; their names."""
    if rng.random() < 0.5:
        return content, []
    known = [name for name in SMALL_EFFECTS[for_rotorpy].split() if name not in hidden]
    names = [str(name) for name in rng.choice(known, SMALL_COUNT, replace=False)]
    for name in names:
        content, _ = _hide(content, name, float(rng.uniform(*SMALL)), rng, path)
    return content, names


def _far_file(content: dict, seed: int, rng, for_rotorpy: bool) -> tuple[dict, Hidden, float]:
    """Return the content with an effect's numbers wrong by a factor, up or down, the effect, and the factor."""
    known = [name for name in FAR if not for_rotorpy or name in EFFECTS_OF_ROTORPY]
    name, factor = known[seed % len(known)], FACTORS[seed // len(known) % len(FACTORS)]
    factor = factor ** float(rng.choice([-1, 1]))
    true = {at: value_at(content, at) for at in FAR[name]}
    wrong = {at: vehicles.plain(factor * value) for at, value in true.items()}
    size = max(abs(wrong[at] - true[at]) for at in true)
    texts = ({path_text(at): value for at, value in values.items()} for values in (true, wrong))
    return conceal(content, wrong), Hidden(name, size, size / EFFECTS[name].detectable, *texts), factor


def _hide_all(content: dict, chosen: list[tuple[str, float]], rng, path: paths.Path) -> tuple[dict, list[Hidden]]:
    """Return the content with all chosen effects, given by name and size (see `_chosen`), and the effects."""
    hidden = []
    for name, multiple in chosen:
        content, one = _hide(content, name, multiple or float(rng.choice(MULTIPLES)), rng, path)
        hidden.append(one)
    return content, hidden


def _hide(content: dict, name: str, multiple: float, rng, path: paths.Path) -> tuple[dict, Hidden]:
    """Return the content with an effect of at most its largest plausible size, and the effect for the answer."""
    effect = KNOWN[name]
    size = min(multiple * effect.detectable, effect.largest)
    values = effect.plant(content, size, rng)
    if name == "local_draught":
        place = path.p[rng.integers(len(path.p) // 4, len(path.p))]
        values |= {("terms", "local_draught", "center", i): float(place[i]) for i in range(3)}
    if name == "pad":
        place = path.p[rng.integers(len(path.p) // 4, len(path.p) // 2)]
        values |= {("strange", "center", i): float(place[i]) for i in range(3)}
    return _concealed(content, name, size, values)


def _concealed(content: dict, name: str, size: float, values: dict) -> tuple[dict, Hidden]:
    """Return the content with the values {path: value} of an effect, and the effect for the answer."""
    effect = KNOWN[name]
    values = {at: vehicles.plain(value) for at, value in values.items()}
    nominal = {path_text(at): value_at(content, at, effect.idle) for at in values}
    sealed = {path_text(at): value for at, value in values.items()}
    return conceal(content, values), Hidden(name, size, size / effect.detectable, sealed, nominal)
