"""How well a diagnosis predicts other flights of the vehicle, which no fit has used, beside black-box models."""

from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.inference.sensitivity import with_effect_terms
from swift_sim_bridge.gap.nominal.rotor_speed_model import with_modelled_rotor_speeds
from swift_sim_bridge.gap.pipeline.diagnosis import Diagnosis
from swift_sim_bridge.gap.pipeline.prepare import with_rows
from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.gap.validation import parts, prediction_errors
from swift_sim_bridge.gap.validation.black_boxes import compared


def predict(diagnosis: Diagnosis, vehicle: Vehicle, flights: list[FlightTable], progress) -> list[dict]:
    """Return the errors of each flight; call it through `gap.api.predict_unseen`.

    Args:
        diagnosis: the diagnosis.
        vehicle: the vehicle file that was diagnosed.
        flights: other flights.
        progress: called with a line of text for each flight.

    Raises:
        UsageError: a flight cannot be used.
    """
    effects = tuple(one.effect for one in diagnosis.selected)
    before, after = (with_effect_terms(one, effects) for one in (vehicle, diagnosis.vehicle))
    learned = [parts.whole(one) for one in diagnosis.evidence.residual_models]
    models, found = compared(learned, before, after, same_flights=False), []
    for table in flights:
        progress(f"{table.name}: predicting it")
        recording = read_recording(with_modelled_rotor_speeds(table, vehicle), vehicle)
        flight = with_rows(ResidualModel(recording), table, after, (), None, progress)
        entry, _ = prediction_errors.evaluate([parts.whole(flight)], models)
        found.append({"recording": table.name, **entry})
    return found
