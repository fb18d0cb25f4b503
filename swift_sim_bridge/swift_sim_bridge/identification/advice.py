"""What each coefficient is counted in, and what to fly when a flight does not tell it (separating manoeuvres)."""

ANY_AIR = "fly fast in all directions, at several speeds and thrusts"
RAMP = "climb and sink slowly through the whole range of throttle, with a full pack and with a nearly empty one"

FLY = {
    "thrust_coefficient": "hover, full throttle and free fall in turn",
    "torque_coefficient": "yaw steps at constant height",
    "rotor_drag": "one speed at two thrusts: straight and in a tight turn",
    "linear_drag": "straight passes both ways, at three speeds",
    "body_drag": "straight passes at three speeds, the fastest three times the slowest",
    "lift_cross": "dives and pull-ups, both ways",
    "axial_inflow": "level climbs and descents at 2, 4 and 8 m/s",
    "translational_lift": "level passes at high speed, both ways",
    "flapping_moment": "passes forwards, backwards and sideways",
    "drag_center": "straight passes at three speeds",
    "ground_effect": "low passes at 0.1, 0.2, 0.4 and 1 m",
    "vortex_ring": "straight descents at 2 to 12 m/s",
    "rotor_gyroscopic": "fast rolls and pitches during yaw turns",
    "map": RAMP,
    "time_constant": "throttle steps up and down, or a chirp",
    "open_circuit_full": "start with a full, rested pack",
    "open_circuit_slope": "fly from a full pack to a nearly empty one",
    "resistance": "hover, full throttle and hover in turn",
    "rc_resistance": "hold hover and full load for some ten seconds each",
    "rc_time": "hold hover and full load for some ten seconds each",
    "efficiency": "record the pack's current, in hover and at full throttle",
    "avionics_w": "record the pack's current, also with motors idling",
}

UNITS = {
    ("rotor_drag", "k_d"): "N/(rad/s m/s)",
    ("linear_drag", "c"): "N/(m/s)",
    ("body_drag", "c"): "N/(m/s)^2",
    ("drag_center", "position"): "m",
    ("lift_cross", "a"): "N/(m/s)^2",
    ("lift_cross", "b"): "N/(m/s)^2",
    ("flapping_moment", "k_f"): "N m/(rad/s m/s)",
    ("axial_inflow", "k_z"): "N/(rad/s m/s)",
    ("translational_lift", "k_h"): "N/(m/s)^2",
    ("translational_lift", "saturation"): "m/s",
    ("ground_effect", "k"): "",
    ("vortex_ring", "loss"): "",
    ("thrust_axis_tilt", "tilt"): "rad",
    ("rotor_gyroscopic", "inertia"): "kg m^2",
}

# eq. 5: what each summand is proportional to, in units
POLYNOMIAL = {
    "f_x": ("m/s", "(m/s)^2", "(rad/s)^2", "m/s (rad/s)^2"),
    "f_y": ("m/s", "(m/s)^2", "(rad/s)^2", "m/s (rad/s)^2"),
    "f_z": ("m/s", "(m/s)^2", "m/s", "(m/s)^2", "m/s (rad/s)^2", "m/s (rad/s)^2", "(m/s)^2 (rad/s)^2"),
    "tau_x": ("m/s", "(m/s)^2", "(rad/s)^2", "m/s (rad/s)^2", "(m/s)^2 (rad/s)^2"),
    "tau_y": ("m/s", "(m/s)^2", "(rad/s)^2", "m/s (rad/s)^2", "(m/s)^2 (rad/s)^2"),
    "tau_z": ("m/s", "m/s"),
}


def fly(name: str) -> str:
    """Return what to fly to tell a coefficient of this key or term."""
    return FLY.get(name, ANY_AIR)


def unit_of(term: str, coefficient: str, index: tuple = ()) -> str:
    """Return the unit of a term's coefficient, or of one of its entries; SI where this table does not have it."""
    if term == "aerodynamic_polynomial":
        regressor = POLYNOMIAL[coefficient][index[0]]
        force = "N m" if coefficient.startswith("tau") else "N"
        return f"{force}/({regressor})" if " " in regressor or "^" not in regressor else f"{force}/{regressor}"
    return UNITS.get((term, coefficient), "SI")
