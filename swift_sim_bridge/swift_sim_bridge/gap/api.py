"""The gap tool as one function: recordings and a vehicle file in, a diagnosis out."""

from collections.abc import Callable

import jax

from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.pipeline import multi_flight, single_flight
from swift_sim_bridge.gap.pipeline.diagnosis import Diagnosis, Options
from swift_sim_bridge.gap.recording.betaflight_log import with_pid_gains
from swift_sim_bridge.physics.terms.equation import without_covariance


def diagnose(
    recordings: list[FlightTable],
    vehicle: Vehicle,
    progress: Callable[[str], None] = print,
    seed: int = 0,
    knocked_out: tuple[str, ...] = (),
    validate: bool = True,
) -> Diagnosis:
    """Return the effects that the vehicle file lacks to explain these recordings of one vehicle.

    Args:
        recordings: one or more flights of the same vehicle.
        vehicle: the vehicle file to compare with.
        progress: called with one line of text at each stage.
        seed: seed of the reference flights.
        knocked_out: ids of effects that are left out of the catalogue.
        validate: whether to compute the errors before and after the repair on parts of the flights that no fit has
            seen, and to diagnose the repaired vehicle again; a third of the computing time.

    Raises:
        UsageError: the recordings cannot be used.
    """
    options = Options(progress, seed, knocked_out, validate)
    vehicle = without_covariance(with_pid_gains(vehicle))
    with jax.enable_x64(True):
        if len(recordings) > 1:
            return multi_flight.diagnose(recordings, vehicle, options)
        return single_flight.diagnose(recordings[0], vehicle, options)
