"""Sealed cases: which vehicle flies which path and what its recording has, all drawn from a family and a seed."""

from dataclasses import dataclass, field, replace

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.recording.flight_channels import CHANNELS
from swift_ros.recording.flight_table import FlightTable
from swift_sim_bridge.referee import race
from swift_sim_bridge.referee.concealment import (
    KNOWN,
    Hidden,
    far_file,
    hide_all,
    with_change,
    with_small_errors,
)
from swift_sim_bridge.referee.effects.catalogue import EFFECTS
from swift_sim_bridge.referee.effects.laws import RELATED
from swift_sim_bridge.referee.families import CHANGED, FAMILIES, draw_effects
from swift_sim_bridge.referee.simulator import foreign_logger, instruments, paths, vehicles
from swift_sim_bridge.referee.simulator.flight import Order, Truth
from swift_sim_bridge.referee.simulator.rotorpy_flight import EFFECTS_OF_ROTORPY, without_battery

SECONDS = 30.0  # duration of a recording
MISSING_CHANNELS = {  # channels that a recording of the family `lacking` may miss
    "no_rotors": ("rotor_speed",),
    "no_velocity": ("v_world",),
    "no_battery": ("voltage", "current"),
    "no_pose": ("p_world", "q_world_body", "v_world"),
    "no_imu": ("gyro_body", "specific_force_body"),
    "no_commands": ("thrust_command", "omega_command_body"),
}
POSE_AND_COMMANDS = ("p_world", "q_world_body", "motor_command")
ROUGHNESS, STRONG_ROUGHNESS = (0.1, 0.6), 4.0  # scale of the process noise (see `disturbances`)
SPEEDS, RACE_SPEEDS = (9.0, 17.0), (16.0, 21.0)  # largest speed of a path, m/s
VARIED_GAINS = ("position_kp", "velocity_kp", "attitude_kp")


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
    nominal = race.raceable(nominal) if family == "strange_race" else nominal
    known = EFFECTS_OF_ROTORPY if for_rotorpy else tuple(EFFECTS)
    chosen = [(effect, multiple)] if effect else draw_effects(family, seed, rng, known)
    names = [name for name, _ in chosen]
    kind = _kind(family, names, rng)
    path = _path(rng, nominal, kind, family)
    true, hidden = hide_all(nominal, chosen, rng, path)
    notes = {"path": kind}
    if family in CHANGED:
        true, one, notes["change"] = with_change(true, seed, rng, for_rotorpy)
        hidden.append(one)
    if family in ("null_sheet", "sheet"):
        notes["sheet"] = float(rng.choice([0.5, 2.0]))
        true = true | {"sensors": {key: notes["sheet"] * value for key, value in true["sensors"].items()}}
    file = nominal
    if family == "far":
        file, one, notes["factor"] = far_file(nominal, seed, rng, for_rotorpy)
        hidden.append(one)
    logger = None
    if "foreign" in family:
        logger = foreign_logger.draw_logger(rng)
        true, notes["small"] = with_small_errors(true, names, rng, path, for_rotorpy)
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


def _recorded_channels(family: str, lacking: str, for_rotorpy: bool) -> tuple[str, ...]:
    """Return the channels that the recording has. RotorPy has no battery."""
    if "pose_commands" in family:
        return tuple(name for name in CHANNELS if name in POSE_AND_COMMANDS)
    missing = MISSING_CHANNELS.get(lacking, ()) + (("voltage", "current") if for_rotorpy else ())
    return tuple(name for name in CHANNELS if name not in missing)


def _removed(family: str, hidden) -> tuple[str, ...]:
    """Return the effects to remove from the tool's catalogue."""
    if family in ("strange", "strange_race"):
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
