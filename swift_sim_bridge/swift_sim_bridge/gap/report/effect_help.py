"""What the effects are, for a reader."""

import difflib
import re
from dataclasses import replace

from swift_ros.errors import UsageError
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect, Parameter
from swift_sim_bridge.gap.effects.catalogue import NOT_COVERED, catalogue, draught, gusts, payload
from swift_sim_bridge.gap.recording.betaflight_log import with_pid_gains
from swift_sim_bridge.gap.recording.channel_names import names_with_columns

WITHOUT_DRAG = {  # why a vehicle file without drag lets no recording tell them
    "drag_center": "the vehicle file has no drag of the body (linear_drag, body_drag) that could act beside its centre",
    **dict.fromkeys(
        ("wind", "gust", "local_draught"),
        "the vehicle file has no drag (rotor_drag, linear_drag, body_drag, axial_inflow) that wind could change",
    ),
}
SIMULATED = {  # of what is not told, what the simulator flies: its equation, and the flight that shows it
    "slung_load": (
        "F/M = m/(m + M) (l n'^2 - n.f) n, n'' = -n'^2 n - (f - (n.f) n)/l - c n', with n from vehicle to "
        "load and f (m/s^2) of all other forces but gravity",
        "sudden stops to a hover: the load swings on",
    ),
    "corner_noise": ("corner = projection + e, e normal, px an axis", "hover before a gate for a minute"),
    "camera_exposure": ("image(t) = scene(t + delay)", "fast passes and turns before a gate"),
}


def table(vehicle: Vehicle) -> str:
    """Return one line an effect: id, layer, parameters with units, equation; then those that cannot be told yet."""
    lines, seen = [], set()
    for effect in _all(vehicle):
        if effect.id not in seen:
            lines.append(f"{effect.id:22} {effect.layer:7} {_parameters(effect):48} {effect.equation}")
        seen.add(effect.id)
    lines += [f"{name:22} -       {reason}" for name, reason in NOT_COVERED.items()]
    return "\n".join(lines)


def one(name: str, vehicle: Vehicle) -> str:
    """Return what an effect is, its equation and what to fly to see it. Raises UsageError for an unknown one."""
    effects = {effect.id: effect for effect in _all(vehicle)}
    if name in NOT_COVERED:
        equation, manoeuvre = SIMULATED.get(name, ("", ""))
        return "\n".join(
            [
                f"{name}: not told under this name; {NOT_COVERED[name]}",
                *([f"equation: {equation}", f"to see it, fly: {manoeuvre}"] if equation else []),
            ]
        )
    if name not in effects:
        near = difflib.get_close_matches(name, [*effects, *NOT_COVERED], n=1, cutoff=0.0)[0]
        raise UsageError(f"there is no effect '{name}'; the nearest is '{near}', `--list-effects` prints all")
    effect, known = effects[name], {one.id for one in catalogue(vehicle)}
    return "\n".join(
        [
            f"{effect.id}: {_plain(effect)}",
            f"equation: {effect.equation}",
            f"parameters: {_parameters(effect)}",
            f"shows first in the {effect.layer} layer; needs {names_with_columns(effect.channels)}",
            f"to see it, fly: {effect.manoeuvre}",
            *([f"not told with this file: {WITHOUT_DRAG[name]}"] if name in undragged(known) else []),
        ]
    )


def parameters(vehicle: Vehicle) -> dict[tuple[str, str], Parameter]:
    """Return every parameter by effect and name."""
    return {(effect.id, parameter.name): parameter for effect in _all(vehicle) for parameter in effect.parameters}


def undragged(known) -> dict[str, str]:
    """Return why no recording tells the effects that need a drag, of those that are not known to a vehicle's catalogue;
    air moves nothing where it does not drag."""
    return {
        name: reason
        for name, reason in WITHOUT_DRAG.items()
        if name not in known and ("wind" not in known or name == "drag_center")
    }


def _all(vehicle: Vehicle) -> tuple[Effect, ...]:
    """Return the effects of a vehicle with drag, which all vehicles have, also where their file does not know of it."""
    vehicle = with_pid_gains(vehicle)
    dragged = replace(vehicle, terms={"linear_drag": {"c": [0.0, 0.0, 0.0]}, **vehicle.terms})
    return (*catalogue(dragged, gates=1), payload(), gusts(), draught())


def _plain(effect: Effect) -> str:
    """Return an effect's sentence with dots for its numbers, the first of two words where their sign decides."""
    numbers = r"\{.*?\}" + (rf"|\b{effect.variant}\b" if effect.variant else "")
    return re.sub(numbers, "...", re.sub(r"\{\w+:([^|}]*)\|[^}]*\}", r"\1", effect.sentence))


def _parameters(effect: Effect) -> str:
    return ", ".join(f"{p.name} {p.unit}".strip() for p in effect.parameters)
