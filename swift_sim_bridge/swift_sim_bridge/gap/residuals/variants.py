"""Vehicle variants that are compared with one recording at once."""

from dataclasses import dataclass
from functools import cached_property

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.residuals import physics_replay
from swift_sim_bridge.physics.state import Parameters
from swift_sim_bridge.sensors.terms import sensor_terms


@dataclass(frozen=True)
class Variants:
    """Vehicles with the same terms; the first is the nominal one, each other differs from it in one effect.

    Attributes:
        vehicles: (b,).
        changes: (b,) what each changes: `motor`, `motion` (forces, moments, air), `imu` (any sensor but the camera,
            VIO included), `camera` (and the map) or `command`; empty for the first.
        sides: by parameter, the index of the vehicle with the parameter moved up, and of the one with it moved down; 0
            where there is none.
    """

    vehicles: tuple[Vehicle, ...]
    changes: tuple[str, ...]
    sides: tuple[tuple[int, int], ...] = ()

    @cached_property
    def sensors(self) -> list[dict]:
        """The sensor terms of each vehicle."""
        return [sensor_terms(vehicle) for vehicle in self.vehicles]

    @cached_property
    def _parameters(self) -> dict[tuple[str, ...], Parameters]:
        """The stacked physical parameters that were asked for, by changes."""
        return {}

    @cached_property
    def nominal_parameters(self) -> Parameters:
        """The physical parameters of the first vehicle, (1, ...)."""
        return physics_replay.stack_parameters([self.vehicles[0]])

    def parameters(self, *changes: str) -> Parameters:
        """Return the stacked physical parameters of the first vehicle and of those with one of these changes."""
        if changes not in self._parameters:
            vehicles = [self.vehicles[i] for i in self.rows(*changes)]
            self._parameters[changes] = physics_replay.stack_parameters(vehicles)
        return self._parameters[changes]

    def rows(self, *changes: str) -> list[int]:
        """Return the indices of the first vehicle and of those with one of these changes."""
        return [0, *(i for i, change in enumerate(self.changes) if i and change in changes)]
