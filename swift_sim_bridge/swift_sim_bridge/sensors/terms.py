"""The terms of the sensors that a vehicle file switches on; an absent one is not simulated.

The module of each sensor has a table `TERMS`: by name the specification of a term, with the dataclass of its
coefficients, which mirrors the file's entry. The function that applies the term stands in the same module.
"""

from swift_ros.configuration import build
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import TermSpecification
from swift_sim_bridge.sensors import camera, imu_errors, motion_capture, vio, world

SENSOR_TERMS: dict[str, TermSpecification] = {
    **imu_errors.TERMS,
    **motion_capture.TERMS,
    **vio.TERMS,
    **camera.TERMS,
    **world.TERMS,
}


def sensor_terms(vehicle: Vehicle) -> dict:
    """Return the coefficients by name of the vehicle's sensor terms. Raises UsageError for a wrong one."""
    return {
        name: build(SENSOR_TERMS[name].coefficients, entry, f"the vehicle '{vehicle.name}', terms.{name}")
        for name, entry in vehicle.terms.items()
        if name in SENSOR_TERMS
    }
