"""The reference flights of a recording: flown without an effect, and measured and read as the recording was."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.effects.injection import inject
from swift_sim_bridge.gap.inference import null_distribution
from swift_sim_bridge.gap.inference.sensitivity import (
    Linearisation,
    linearise,
    linearise_all,
    noise_floor,
    parameter_slices,
    perturbed_variants,
)
from swift_sim_bridge.gap.nominal import (
    corner_bootstrap,
    motors_only,
    phase_surrogates,
    reference_flights,
    rotor_speed_model,
)
from swift_sim_bridge.gap.nominal.noise_sheet import estimate_noise_sheet
from swift_sim_bridge.gap.nominal.recorded_flight import RecordedFlight
from swift_sim_bridge.gap.recording import command_rows
from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.gap.residuals.variants import Variants
from swift_sim_bridge.parallel import run_in_threads

# For each recording. Their mean and largest statistics set the thresholds: one flight in 25 without an effect exceeds
# the largest of 24. The time of a diagnosis grows with their number.
REFERENCE_FLIGHTS = 24


@dataclass(frozen=True)
class ReferenceFlights:
    """The reference flights of one recording, read as the recording was.

    Attributes:
        recorded: residual model of the recording.
        flights: residual models of the reference flights.
        noise_free: residual model of the first of them, measured without noise; None for a recording without a pose.
        quantities: for each channel of the recording the physical quantities (m, q) that its residual may depend on
            (see `phase_surrogates.add_surrogate_channels`).
        seed: seed of their random numbers.
    """

    recorded: ResidualModel
    flights: list[ResidualModel]
    noise_free: ResidualModel | None
    quantities: list[np.ndarray]
    seed: int

    def linearised(
        self, variants: Variants, recorded: Linearisation
    ) -> tuple[list[Linearisation], Linearisation | None]:
        """Return the linearisations of the reference flights, and of the noise-free one if there is one.

        Args:
            variants: variants of the vehicle.
            recorded: linearisation of the recording by the same variants.
        """
        residual_models = [*self.flights, self.noise_free] if self.noise_free else self.flights
        lines = linearise_all(residual_models, variants)
        phase_surrogates.add_surrogate_channels(lines, recorded, self.quantities, self.seed)
        return lines[: len(self.flights)], lines[-1] if self.noise_free else None


def in_own_air(vehicle: Vehicle, residual_model: ResidualModel) -> Vehicle:
    """Return the vehicle with the gusts of a recording.

    The rate loop reacts to gusts, and without them in the reference flights its reaction would look like an effect.
    """
    for effect, values in residual_model.flight_effects:
        if effect.id == "gust":
            vehicle = inject(vehicle, effect, values)
    return vehicle


def fly_references(
    table: FlightTable,
    residual_model: ResidualModel,
    vehicle: Vehicle,
    seed: int,
    process_noise: np.ndarray,
) -> tuple[reference_flights.FlightPath, list[reference_flights.Trace]] | None:
    """Return the path of the reference flights and how each moved, None for a recording without a pose.

    Args:
        table: the recording as it was measured.
        residual_model: the same recording on its grid.
        vehicle: the vehicle that flies.
        seed: seed of the flights.
        process_noise: (6,), see `prepare.Prior`.
    """
    if not residual_model.recording.has_motion:
        return None
    path = reference_flights.reference_path(
        residual_model.recording, reference_flights.time_step(table, vehicle), REFERENCE_FLIGHTS, seed
    )
    gyro_noise = estimate_noise_sheet(table, vehicle).get("gyro_rad_s", 0.0)
    return path, reference_flights.fly(vehicle, path, gyro_noise, seed, process_noise)


def measured_references(
    table: FlightTable, residual_model: ResidualModel, vehicle: Vehicle, seed: int, recorded: Linearisation, flown
) -> tuple[list[ResidualModel], ResidualModel | None]:
    """Return the reference flights as the recording's instruments measure them, and the first of them without noise.

    Args:
        table: the recording as it was measured.
        residual_model: the same recording on its grid.
        vehicle: the vehicle that they are compared with.
        seed: seed of the measurement noise.
        recorded: linearisation of the recording.
        flown: result of `fly_references`; where it is None, motors and battery alone are simulated, and there is no
            noise-free flight.
    """
    if flown is None:
        found = motors_only.reference_tables(table, residual_model.recording, vehicle, REFERENCE_FLIGHTS, seed)
        return [_reference_model(one, vehicle, residual_model) for one in found], None
    path, traces = flown
    found = reference_flights.reference_tables(traces, path, table, vehicle, seed)
    found += reference_flights.reference_tables(traces[:1], path, table, vehicle, seed, noisy=False)
    if residual_model.recording.gate_observations:
        recorded_flight = RecordedFlight(table, residual_model, recorded, vehicle)
        found = corner_bootstrap.with_gates(found, [*traces, traces[0]], path.t, recorded_flight, seed)
    *noisy, noise_free = run_in_threads(*(partial(_reference_model, one, vehicle, residual_model) for one in found))
    return noisy, noise_free


def _reference_model(table: FlightTable, vehicle: Vehicle, recorded: ResidualModel) -> ResidualModel:
    """Return the residual model of a reference flight, with the residuals that the recording has.

    Its rows of motor commands are as uncertain as those of the recording, and so are its moments.
    """
    found = ResidualModel(
        read_recording(rotor_speed_model.with_modelled_rotor_speeds(table, vehicle), vehicle, simulated=True),
        excluded_groups=recorded.excluded_groups,
        rotor_spread=recorded.rotor_spread,
    )
    if recorded.command_rows is None:
        return found
    rows, known = found.command_rows or command_rows.of_held(table["motor_command"]), recorded.command_rows
    rows = replace(rows, sigma=(*known.sigma[:2], 0.0), noise=known.noise)
    return found.with_command_rows(rows)


def detectable_sizes(effects: tuple[Effect, ...], vehicle: Vehicle, reference: ReferenceFlights) -> dict:
    """Return the minimum detectable magnitudes of effects that no search looks for, by id and parameter."""
    variants = perturbed_variants(vehicle, effects, central=False)
    recorded = linearise(reference.recorded, variants)
    lines, noise_free_line = reference.linearised(variants, recorded)
    least = noise_floor(lines, reference.recorded.channels)
    distribution = null_distribution.estimate_null_distribution(
        lines, parameter_slices(effects), least, noise_free_line
    )
    return null_distribution.minimum_detectable_changes(
        effects, null_distribution.scaled_to_recording(distribution, recorded, 1.0)
    )
