"""The sensor effects that a vehicle file switches on: one entry of its `terms` each, absent ones are not simulated.

A term is a dataclass of its coefficients, which mirrors the file's entry, in the module of its sensor, with the pure
function that applies it. The effects of the airframe and the air are listed in `physics.terms`.
"""

from swift_ros.configuration import build
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.sensors import camera, imu_errors, motion_capture, vio, world

SENSOR_TERMS: dict[str, type] = {
    **imu_errors.TERMS,
    **motion_capture.TERMS,
    **vio.TERMS,
    **camera.TERMS,
    **world.TERMS,
}


def sensor_terms(vehicle: Vehicle) -> dict:
    """Return the coefficients by name of the vehicle's sensor terms. Raises UsageError for a wrong coefficient."""
    return {
        name: build(SENSOR_TERMS[name], entry, f"the vehicle '{vehicle.name}', terms.{name}")
        for name, entry in vehicle.terms.items()
        if name in SENSOR_TERMS
    }
