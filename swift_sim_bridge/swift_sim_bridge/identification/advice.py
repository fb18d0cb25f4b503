"""Units of the coefficients, and the manoeuvre that shows each; both from the specifications of the effects."""

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.physics import battery, motors
from swift_sim_bridge.physics.terms import rotors
from swift_sim_bridge.physics.terms.registry import PHYSICS

ANY_FLIGHT = "fly fast in all directions, at several speeds and thrusts"  # shows every force of the air
LOAD_STEPS = "hold hover and full load for some ten seconds each"

EFFECTS = {  # effect whose manoeuvre shows a coefficient of another name
    "map": "motor_map",
    "time_constant": "motor_time_constant",
    "open_circuit_slope": "battery_sag",
    "resistance": "battery_sag",
}
MANOEUVRES = {  # of coefficients that are no effect of the gap tool
    "open_circuit_full": "start with a full, rested pack",
    "rc_resistance": LOAD_STEPS,
    "rc_time": LOAD_STEPS,
    "efficiency": "record the pack's current, in hover and at full throttle",
    "avionics_w": "record the pack's current, also with motors idling",
}


def manoeuvre(name: str, vehicle: Vehicle) -> str:
    """Return the flight that shows the coefficient or the term `name`."""
    if name in MANOEUVRES:
        return MANOEUVRES[name]
    effect = _effect(EFFECTS.get(name, name), vehicle)
    return effect.manoeuvre if effect else ANY_FLIGHT


def unit_of(name: str, vehicle: Vehicle) -> str:
    """Return the unit of the first parameter of the effect `name`."""
    return _effect(name, vehicle).parameters[0].unit


def _effect(name: str, vehicle: Vehicle) -> Effect | None:
    """Return the effect `name` of the physics; None where there is none."""
    found = (*rotors.coefficient_effects(vehicle), *motors.effects(vehicle), *battery.effects(vehicle))
    if name in PHYSICS:
        found += PHYSICS[name].effects_of(name, vehicle)
    return next((effect for effect in found if effect.id == name), None)
