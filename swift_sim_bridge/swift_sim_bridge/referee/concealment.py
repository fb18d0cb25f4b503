"""How effects are concealed in a vehicle: the true vehicle, and what the sealed answer says of it."""

from dataclasses import dataclass

from swift_sim_bridge.referee.effects.catalogue import EFFECTS
from swift_sim_bridge.referee.effects.changes import CHANGES, CHANGES_OF_ROTORPY, FACTORS, FAR
from swift_sim_bridge.referee.effects.laws import BLIND, STRANGE
from swift_sim_bridge.referee.effects.planting import conceal, path_text, value_at
from swift_sim_bridge.referee.families import MULTIPLES
from swift_sim_bridge.referee.simulator import paths, vehicles
from swift_sim_bridge.referee.simulator.rotorpy_flight import EFFECTS_OF_ROTORPY

KNOWN = EFFECTS | STRANGE | BLIND  # all that a case may conceal
SMALL_EFFECTS = {  # effects of which the file of a foreign recording has small errors, by generator: own, RotorPy
    False: (
        "mass inertia com_offset thrust_axis_tilt thrust_coefficient torque_coefficient motor_time_constant motor_map "
        "rotor_gain battery_sag rotor_drag body_drag flapping_moment gyro_bias gyro_scale accel_bias accel_scale"
    ),
    True: "mass inertia thrust_coefficient motor_time_constant rotor_drag body_drag gyro_bias accel_bias",
}
SMALL_COUNT, SMALL = 5, (0.05, 0.2)  # of these errors; their sizes relative to the detectable size


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


def with_change(content: dict, seed: int, rng, for_rotorpy: bool) -> tuple[dict, dict, str]:
    """Return the vehicle with one of CHANGES, in turn of the seeds; what was hidden, and the change's name."""
    known = CHANGES_OF_ROTORPY if for_rotorpy else tuple(CHANGES)
    change = known[seed % len(known)]
    name, plant, sizes = CHANGES[change]
    size = float(rng.uniform(*sizes))
    return *_concealed(content, name, size, plant(content, size, rng)), change


def with_small_errors(content: dict, hidden: list[str], rng, path, for_rotorpy: bool) -> tuple[dict, list[str]]:
    """Return the content with small errors of other effects than the hidden ones, in half of the cases; their names."""
    if rng.random() < 0.5:
        return content, []
    known = [name for name in SMALL_EFFECTS[for_rotorpy].split() if name not in hidden]
    names = [str(name) for name in rng.choice(known, SMALL_COUNT, replace=False)]
    for name in names:
        content, _ = _hide(content, name, float(rng.uniform(*SMALL)), rng, path)
    return content, names


def far_file(content: dict, seed: int, rng, for_rotorpy: bool) -> tuple[dict, Hidden, float]:
    """Return the content with an effect's numbers wrong by a factor, up or down, the effect, and the factor."""
    known = [name for name in FAR if not for_rotorpy or name in EFFECTS_OF_ROTORPY]
    name, factor = known[seed % len(known)], FACTORS[seed // len(known) % len(FACTORS)]
    factor = factor ** float(rng.choice([-1, 1]))
    true = {at: value_at(content, at) for at in FAR[name]}
    wrong = {at: vehicles.plain(factor * value) for at, value in true.items()}
    size = max(abs(wrong[at] - true[at]) for at in true)
    texts = ({path_text(at): value for at, value in values.items()} for values in (true, wrong))
    return conceal(content, wrong), Hidden(name, size, size / EFFECTS[name].detectable, *texts), factor


def hide_all(content: dict, chosen: list[tuple[str, float]], rng, path: paths.Path) -> tuple[dict, list[Hidden]]:
    """Return the content with all chosen effects, given as by `families.draw_effects`, and the effects."""
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
