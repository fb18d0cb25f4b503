"""A recording in the forms that the reference flights need."""

from dataclasses import dataclass

from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel


@dataclass(frozen=True)
class RecordedFlight:
    """One recording.

    Attributes:
        table: as it was measured.
        residual_model: the same on its time grid.
        linearisation: its residuals and sensitivities against the vehicle.
        vehicle: the vehicle as its file describes it.
    """

    table: FlightTable
    residual_model: ResidualModel
    linearisation: Linearisation
    vehicle: Vehicle
