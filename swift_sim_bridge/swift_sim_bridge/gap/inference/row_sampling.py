"""Nuisance parameters of a recording: what its motor commands did between two rows.

They are fitted together with the effects of the motors, so that a motor's lag is not taken for a shift of the commands.
Their remaining uncertainty enters the covariance of the residuals: directions that a nuisance parameter could explain
as well count as little as they are known.
"""

from dataclasses import replace

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.effects.injection import file_values, inject
from swift_sim_bridge.gap.inference import nuisance
from swift_sim_bridge.gap.inference.normal_equations import solve
from swift_sim_bridge.gap.inference.null_distribution import REFERENCE_MARGIN, NullDistribution
from swift_sim_bridge.gap.inference.sensitivity import (
    linearise,
    parameter_steps,
    perturbed_variants,
)
from swift_sim_bridge.gap.recording import command_timing
from swift_sim_bridge.gap.recording.recording import Recording
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel

POSE_AND_IMU = ("p_world", "q_world_body", "gyro_body", "specific_force_body")
ITERATIONS = 5  # Gauss-Newton steps at most
CONVERGED_S = 2e-5  # change of the shift that ends the iteration
ASYMMETRY_SHARE = 0.05  # of a row: rising and falling commands that are interpolated may differ by as much in time
DAMPING = 1e-3  # share of each effect's information that is added to it: keeps effects small that the flight hides
# Of a row. Delays are seen in whole rows: where a common delay is not a whole number of them, or the commands have
# another period, some commands seem to come a row later than others. Their standard deviation is half a row at most.
JITTER_SHARE = 0.5


def with_fitted_rows(residual_model: ResidualModel, vehicle: Vehicle, effects: tuple[Effect, ...]) -> ResidualModel:
    """Return the residual model with the shift and bend of the motor commands that its recording shows.

    Args:
        residual_model: of one recording; returned unchanged where every command was recorded.
        vehicle: the vehicle as its file describes it.
        effects: effects of the search; those of the motors are fitted together with the rows.
    """
    rows, columns = residual_model.command_rows, residual_model.columns.get("rotors")
    if rows is None or columns is None or not any(rows.sigma):
        return residual_model
    motor = tuple(effect for effect in effects if effect.layer == "motor")
    size, first, sigma = parameter_steps(motor), rows, np.array(rows.sigma)
    for _ in range(ITERATIONS):
        now = residual_model.command_rows
        line = linearise(residual_model, perturbed_variants(vehicle, motor, central=False), marginal=False)
        residual, x = line.residual[:, columns].ravel(), _flat(line.sensitivity[:, :, columns])
        scale = float(nuisance.step_noise(line.residual[:, columns], line.good).mean())
        shown = np.any(x != 0, axis=1)
        of_rows = residual_model.nuisance(vehicle)[-len(sigma) :, :, columns] * now.speed_noise
        x = np.concatenate([x[shown], _flat(of_rows)]) / scale
        effect, row = slice(0, np.count_nonzero(shown)), slice(np.count_nonzero(shown), None)
        prior, offset = np.ones(len(x)), np.zeros(len(x))
        prior[effect] = DAMPING * np.einsum("ij,ij->i", x[effect], x[effect])
        offset[row] = (now.nuisances - first.nuisances) / np.where(sigma > 0, sigma, np.inf)
        step = -solve(x @ x.T + np.diag(prior), x @ residual / scale + prior * offset)
        vehicle = _moved(vehicle, motor, size, _spread(step[effect], shown))
        moved = step[row] * sigma
        before_s = now.shift_s - first.shift_s
        moved[0] = np.clip(before_s + moved[0], -rows.interval_s, rows.interval_s) - before_s
        residual_model = residual_model.with_command_rows(replace(now.moved(*moved), speed_noise=scale))
        if abs(moved[0]) < CONVERGED_S:
            break
    return residual_model


def _flat(sensitivity) -> np.ndarray:
    """Return sensitivities (p, m, c) as (p, m c)."""
    return sensitivity.reshape(len(sensitivity), int(np.prod(sensitivity.shape[1:])))


def _spread(step, shown) -> np.ndarray:
    """Return a step (p,) of all parameters from that of the `shown` ones."""
    found = np.zeros(len(shown))
    found[shown] = step
    return found


def _moved(vehicle: Vehicle, effects, size, step) -> Vehicle:
    """Return the vehicle with the parameters of the effects changed by a step (p,), within their bounds."""
    begin = 0
    for effect in effects:
        end = begin + len(effect.parameters)
        low, high = np.array([(p.low, p.high) for p in effect.parameters]).T
        values = file_values(effect, vehicle) + step[begin:end] * size[begin:end]
        vehicle, begin = inject(vehicle, effect, np.clip(values, low, high)), end
    return vehicle


def row_bounds(recording: Recording) -> dict[str, np.ndarray]:
    """Return by effect the change of its parameters (k,) below which it may be what the rows leave open."""
    rows_s = recording.undeclared_rows_s
    pose_and_imu = max((rows_s.get(name, 0.0) for name in POSE_AND_IMU), default=0.0)
    commands = rows_s.get("motor_command", 0.0)
    of_motors = {"motor_time_constant": commands} if recording.driven else {}  # rotor speeds would show the shift
    delays_s = {
        "time_offset": 0.5 * pose_and_imu,
        "command_latency": commands,
        "motor_asymmetry": ASYMMETRY_SHARE * commands,
    } | of_motors
    bounds, link = {name: np.array([delay_s]) for name, delay_s in delays_s.items()}, recording.command_link
    if link and link.row_s:
        bounds["command_jitter"] = np.array([JITTER_SHARE * link.row_s])
        bounds["rate_scale"] = np.concatenate([link.scale_error(), command_timing.NEGLIGIBLE[:3]])
    return bounds


def with_row_bounds(known: NullDistribution, effects: tuple[Effect, ...], bounds: dict[str, np.ndarray]):
    """Return the null distribution with these bounds on the minimum detectable magnitudes."""
    largest, size = known.largest.copy(), parameter_steps(effects)
    for effect in effects:
        if effect.id in bounds:
            rows = known.slices[effect.key]
            largest[rows] = np.maximum(largest[rows], bounds[effect.id] / size[rows] / REFERENCE_MARGIN)
    return replace(known, largest=largest)
