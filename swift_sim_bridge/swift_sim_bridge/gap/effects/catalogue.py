"""The catalogue of effects: every number of the vehicle file that may be wrong, and every term that it may lack.

The specification of an effect stands in the module that simulates it; this module collects them.
"""

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect, NotIdentified, known_terms
from swift_sim_bridge.gap.effects import rate_loop
from swift_sim_bridge.physics import battery, motors, rigid_body
from swift_sim_bridge.physics.terms import registry, rotors
from swift_sim_bridge.physics.terms.air import draught_effect
from swift_sim_bridge.physics.terms.airframe import payload_effect
from swift_sim_bridge.sensors import world
from swift_sim_bridge.sensors.terms import SENSOR_TERMS

MAP_EFFECTS = tuple(world.TERMS)  # errors of the track file, not of the vehicle file

# Order of the columns of the normal equations. Sums over columns depend on it in their last digits, so it is fixed for
# reproducible reports. Effects that are not named here follow, in the order in which they are collected.
COLUMN_ORDER = (
    "mass inertia com_offset thrust_axis_tilt",
    "thrust_coefficient torque_coefficient",
    "motor_time_constant motor_asymmetry motor_map rotor_gain damaged_propeller battery_sag",
    "axial_inflow translational_lift rotor_gyroscopic",
    "rotor_drag linear_drag body_drag lift_cross flapping_moment ground_effect vortex_ring drag_center wind",
    "gyro_bias gyro_scale imu_lever_arm marker_offset accel_bias accel_scale time_offset clock_drift",
    "frame_misalignment map_tilt",
    "vio_scale vio_drift",
    "command_latency command_jitter dropped_commands rate_scale throttle_curve",
    "rate_loop_p rate_loop_i rate_loop_d",
    "camera_extrinsic camera_focal rolling_shutter processing_latency gate_displaced map_scale",
    "payload gust local_draught",
)


def all_effects(vehicle: Vehicle, gates: int = 0) -> tuple[Effect, ...]:
    """Return every effect, also those that need a term which the vehicle file lacks or have a search of their own.

    Args:
        vehicle: the vehicle.
        gates: number of gates of the map; 0 without a map.
    """
    found = [
        *rigid_body.effects(vehicle),
        *rotors.coefficient_effects(vehicle),
        *motors.effects(vehicle),
        *battery.effects(vehicle),
        *(effect for name, term in known_terms().items() for effect in term.effects_of(name, vehicle, gates)),
        *rate_loop.effects(vehicle),
    ]
    place = {name: column for column, name in enumerate(" ".join(COLUMN_ORDER).split())}
    return tuple(sorted(found, key=lambda effect: place.get(effect.id, len(place))))


def catalogue(vehicle: Vehicle, gates: int = 0) -> tuple[Effect, ...]:
    """Return the effects that the search for linear effects examines, in the order of their columns.

    Args:
        vehicle: the vehicle.
        gates: number of gates of the map; 0 without a map.
    """
    effects = all_effects(vehicle, gates)
    return tuple(effect for effect in effects if effect.possible(vehicle) and not effect.own_search)


def gusts() -> Effect:
    """Return the effect of gusts: random, without a sensitivity, found by `inference.gust_correlation`."""
    (effect,) = known_terms()["gust"].effects_of("gust", None)
    return effect


def payload(position=(0.0, 0.0, 0.0)) -> Effect:
    """Return the effect of a fixed load near a position (3,) m, found by `attribution.payload`."""
    return payload_effect(position)


def draught(center=(0.0, 0.0, 0.0), radius: float = 1.0) -> Effect:
    """Return the effect of a local draught near a center (3,) m with a radius m, found by `attribution.wind`."""
    return draught_effect(center, radius)


def not_identified() -> dict[str, NotIdentified]:
    """Return by name the known effects that the gap tool does not identify."""
    physics, sensors = (
        {name: term.not_identified for name, term in terms.items() if term.not_identified}
        for terms in (registry.PHYSICS, SENSOR_TERMS)
    )
    return {**physics, **motors.NOT_IDENTIFIED, **sensors}
