"""Help on the effects of the catalogue: `swiftros gap --list-effects` and `--explain`."""

import difflib
import re

from swift_ros.errors import UsageError
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect, Parameter, known_terms
from swift_sim_bridge.gap.effects.catalogue import all_effects, not_identified
from swift_sim_bridge.gap.recording.betaflight_log import with_pid_gains
from swift_sim_bridge.gap.recording.channel_names import names_with_columns


def effect_table(vehicle: Vehicle) -> str:
    """Return a line for each effect: id, layer, parameters with units, equation; then those that are not identified."""
    lines, known = [], set()
    for effect in _effects(vehicle):
        if effect.id not in known:
            lines.append(f"{effect.id:22} {effect.layer:7} {_parameters(effect):48} {effect.equation}")
        known.add(effect.id)
    lines += [f"{name:22} -       {effect.reason}" for name, effect in not_identified().items()]
    return "\n".join(lines)


def describe_effect(name: str, vehicle: Vehicle) -> str:
    """Return what an effect is, its equation, and the flight that shows it.

    Raises:
        UsageError: there is no such effect.
    """
    effects, others = {effect.id: effect for effect in _effects(vehicle)}, not_identified()
    if name in others:
        lines = [f"{name}: not identified under this name; {others[name].reason}"]
        if others[name].equation:
            lines += [f"equation: {others[name].equation}", f"to see it, fly: {others[name].manoeuvre}"]
        return "\n".join(lines)
    if name not in effects and name in known_terms():
        return f"{name}: a term of the vehicle file that is no effect of the catalogue; see docs/vehicle-file.md"
    if name not in effects:
        near = difflib.get_close_matches(name, [*effects, *others], n=1, cutoff=0.0)[0]
        raise UsageError(f"there is no effect '{name}'; the nearest is '{near}', `--list-effects` prints all")
    effect, missing = effects[name], missing_terms(vehicle)
    lines = [
        f"{effect.id}: {_without_values(effect)}",
        f"equation: {effect.equation}",
        f"parameters: {_parameters(effect)}",
        f"shows first in the {effect.layer} layer; needs {names_with_columns(effect.channels)}",
        f"to see it, fly: {effect.manoeuvre}",
    ]
    if name in missing:
        lines.append(f"not testable with this file: {missing[name]}")
    return "\n".join(lines)


def parameters(vehicle: Vehicle) -> dict[tuple[str, str], Parameter]:
    """Return every parameter by effect and name."""
    return {(effect.id, parameter.name): parameter for effect in _effects(vehicle) for parameter in effect.parameters}


def missing_terms(vehicle: Vehicle) -> dict[str, str]:
    """Return by id why effects cannot be tested for whose action the vehicle file lacks a term.

    Wind, for example, has no effect on a vehicle without drag.
    """
    return {
        effect.id: f"the vehicle file has none of the terms through which it acts ({', '.join(effect.requires)})"
        for effect in _effects(vehicle)
        if not effect.possible(vehicle)
    }


def _effects(vehicle: Vehicle) -> tuple[Effect, ...]:
    """Return all effects, with one gate as an example of a map."""
    return all_effects(with_pid_gains(vehicle), gates=1)


def _without_values(effect: Effect) -> str:
    """Return an effect's sentence with dots in place of its values; of two words for a sign the first."""
    values = r"\{.*?\}" + (rf"|\b{effect.variant}\b" if effect.variant else "")
    return re.sub(values, "...", re.sub(r"\{\w+:([^|}]*)\|[^}]*\}", r"\1", effect.sentence))


def _parameters(effect: Effect) -> str:
    """Return an effect's parameters with their units."""
    return ", ".join(f"{p.name} {p.unit}".strip() for p in effect.parameters)
