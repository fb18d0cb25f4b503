"""The gap tool as one function: recordings and a vehicle file in, a diagnosis out."""

from collections.abc import Callable

import jax

from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.pipeline import multi_flight, single_flight, unseen_flights
from swift_sim_bridge.gap.pipeline.diagnosis import Diagnosis, Options
from swift_sim_bridge.gap.recording.betaflight_log import with_pid_gains
from swift_sim_bridge.identification.regular_stamps import with_regular_stamps
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
    recordings = [with_regular_stamps(one, progress) for one in recordings]
    with jax.enable_x64(True):
        if len(recordings) > 1:
            return multi_flight.diagnose(recordings, vehicle, options)
        return single_flight.diagnose(recordings[0], vehicle, options)


def predict_unseen(
    diagnosis: Diagnosis, vehicle: Vehicle, flights: list[FlightTable], progress: Callable[[str], None] = print
) -> list[dict]:
    """Return for each flight the errors with which the repaired vehicle and black-box models predict it.

    All have learned from the whole recordings of the diagnosis. The entries are `unseen_flights` of report.json.

    Args:
        diagnosis: the diagnosis.
        vehicle: the vehicle file that was diagnosed.
        flights: other flights of the vehicle.
        progress: called with a line of text for each flight.

    Raises:
        UsageError: a flight cannot be used.
    """
    flights = [with_regular_stamps(one, progress) for one in flights]
    with jax.enable_x64(True):
        return unseen_flights.predict(diagnosis, without_covariance(with_pid_gains(vehicle)), flights, progress)
