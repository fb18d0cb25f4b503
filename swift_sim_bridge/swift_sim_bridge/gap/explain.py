"""What the effects are, for a reader."""

import difflib

from swift_ros.errors import UsageError
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.effect import Effect
from swift_sim_bridge.gap.effects import NOT_COVERED, catalogue, draught, gusts


def table(vehicle: Vehicle) -> str:
    """Return one line an effect: id, layer, parameters with units, equation; then those that cannot be told yet."""
    lines, seen = [], set()
    for effect in (*catalogue(vehicle, gates=1), gusts(), draught()):
        if effect.id not in seen:
            lines.append(f"{effect.id:22} {effect.layer:7} {_parameters(effect):48} {effect.equation}")
        seen.add(effect.id)
    lines += [f"{name:22} -       {reason}" for name, reason in NOT_COVERED.items()]
    return "\n".join(lines)


def one(name: str, vehicle: Vehicle) -> str:
    """Return what an effect is, its equation and what to fly to see it. Raises UsageError for an unknown one."""
    effects = {effect.id: effect for effect in (*catalogue(vehicle, gates=1), gusts(), draught())}
    if name in NOT_COVERED:
        return f"{name}: not told from flights; {NOT_COVERED[name]}"
    if name not in effects:
        near = difflib.get_close_matches(name, [*effects, *NOT_COVERED], n=1, cutoff=0.0)[0]
        raise UsageError(f"there is no effect '{name}'; the nearest is '{near}', `--list-effects` prints all")
    effect = effects[name]
    return "\n".join([
        f"{effect.id}: {effect.equation}",
        f"parameters: {_parameters(effect)}",
        f"shows first in the {effect.layer} layer; needs {', '.join(effect.channels)}",
        f"to see it, fly: {effect.manoeuvre}",
    ])  # fmt: skip


def _parameters(effect: Effect) -> str:
    return ", ".join(f"{p.name} {p.unit}".strip() for p in effect.parameters)
