"""Nuisance parameters of a recording: what its motor commands did between two rows.

They are fitted together with the effects of the motors, so that a motor's lag is not taken for a shift of the commands.
Their remaining uncertainty enters the covariance of the residuals: directions that a nuisance parameter could explain
as well count as little as they are known.

Commands in slow rows may show little of what the motors did: noise of the gyro and answers to disturbances come and go
between two rows, and what a rate loop answers is opposed to what it causes. A regression on such commands gives too
small a force and moment for every change of a command, which would be taken for a heavier vehicle or for weaker motors.
Their size is known as far as the commands explain the motion.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from swift_ros.recording.checks import Rejection
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
from swift_sim_bridge.gap.residuals.channels import AXES
from swift_sim_bridge.gap.residuals.residual_model import MAX_COUNTED_SPREAD, ResidualModel, RotorSpread
from swift_sim_bridge.identification.grid import HALF_WIDTH_S

LAGS = "motor_time_constant", "motor_asymmetry"  # effects that move rotor speeds in time, as a shift of the rows does
POSE_AND_IMU = ("p_world", "q_world_body", "gyro_body", "specific_force_body")
CORRELATED_S = 2.0 * HALF_WIDTH_S  # s, over which the noise of filtered residuals is correlated
TINY = 1e-12  # squared, of axes without a motion
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
        effects: effects of the search; those that the commands show are fitted together with the rows.
    """
    rows, columns = residual_model.command_rows, residual_model.driven_columns
    if rows is None or not (any(rows.sigma) or residual_model.rotor_spread):
        return residual_model
    if residual_model.recording.driven:  # without rotor speeds a lag of less than a row is a shift
        beside = tuple(one for one in effects if one.layer in ("motor", "force", "moment") and one.id not in LAGS)
    else:
        beside = tuple(one for one in effects if one.layer == "motor")
    size, first, sigma = parameter_steps(beside), rows, np.array(rows.sigma)
    for _ in range(ITERATIONS):
        now = residual_model.command_rows
        line = linearise(residual_model, perturbed_variants(vehicle, beside, central=False), marginal=False)
        noise = nuisance.step_noise(line.residual[:, columns], line.good)
        if not residual_model.recording.driven:
            noise = np.full(len(columns), noise.mean())
        weight = np.where(residual_model.counted[:, columns], 1.0 / noise, 0.0)
        residual, x = (line.residual[:, columns] * weight).ravel(), _flat(line.sensitivity[:, :, columns] * weight)
        shown = np.any(x != 0, axis=1)
        x = np.concatenate([x[shown], _flat(residual_model.row_sensitivity(vehicle) * weight)])
        effect, row = slice(0, np.count_nonzero(shown)), slice(np.count_nonzero(shown), None)
        prior, offset = np.ones(len(x)), np.zeros(len(x))
        prior[effect] = DAMPING * np.einsum("ij,ij->i", x[effect], x[effect])
        offset[row] = (now.nuisances - first.nuisances) / np.where(sigma > 0, sigma, np.inf)
        step = -solve(x @ x.T + np.diag(prior), x @ residual + prior * offset)
        vehicle = _moved(vehicle, beside, size, _spread(step[effect], shown))
        moved = step[row] * sigma
        before_s = now.shift_s - first.shift_s
        moved[0] = np.clip(before_s + moved[0], -rows.interval_s, rows.interval_s) - before_s
        residual_model = residual_model.with_command_rows(replace(now.moved(*moved), noise=noise))
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


def with_rotor_spread(
    residual_model: ResidualModel, vehicle: Vehicle, progress: Callable[[str], None]
) -> ResidualModel:
    """Return the residual model with what its commands leave open of the rotors' force along z and their moments.

    The size of what these vary by is open by the share of the motion that the commands do not explain: a regression of
    the motion on commands and one of commands on the motion give sizes that differ by this share, and the true one
    lies between them. What varies in the commands beyond the motion is noise of the rows; its mean over the flight is
    open, too. Where the commands explain the force, its size is that of the vehicle, and a repair of it counts.

    Args:
        residual_model: of one recording; returned unchanged where the rotor speeds are not those under slow commands.
        vehicle: the vehicle as its file describes it.
        progress: called with a line about axes whose moments are left out.
    """
    recording, good = residual_model.recording, residual_model.good
    slow = recording.driven and residual_model.command_rows
    if not slow or not {"force", "moment"} <= set(residual_model.groups) or not good.any():
        return residual_model
    modelled = residual_model.modelled_rotors(vehicle)
    measured = modelled + residual_model.residual(vehicle)[:, residual_model.rotor_columns]
    steps = nuisance.step_noise(measured, good)
    modelled, measured = modelled[good], measured[good]
    deviations = np.maximum(modelled.std(axis=0) * measured.std(axis=0), TINY)
    products = np.mean((modelled - modelled.mean(axis=0)) * (measured - measured.mean(axis=0)), axis=0)
    explained = np.minimum((products / deviations) ** 2, 1.0)
    size, noise = 1.0 - explained, modelled.var(axis=0) * (1.0 - explained)
    mean = np.sqrt(noise * CORRELATED_S / (len(modelled) * np.median(np.diff(residual_model.t))))
    if size[0] < MAX_COUNTED_SPREAD:
        size[0] = mean[0] = 0.0
    spread = RotorSpread(*(tuple(map(float, one)) for one in (size, mean, steps)))
    found = replace(residual_model, rotor_spread=spread)
    left_out = [axis for axis, counts in enumerate(found.counted[good][0, found.columns["moment"]]) if not counts]
    if not left_out:
        return found
    rejection = Rejection(
        float(recording.t[0]),
        float(recording.t[-1]),
        f"size of the rotors' moments about {', '.join(AXES[axis] for axis in left_out)}",
        f"the motor commands explain {', '.join(f'{explained[1 + axis]:.0%}' for axis in left_out)} of the rotation",
    )
    progress(f"{recording.name}: left out {rejection.channel}: {rejection.reason}")
    return replace(found, recording=replace(recording, rejections=(*recording.rejections, rejection)))


def row_bounds(recording: Recording) -> dict[str, np.ndarray]:
    """Return by effect the change of its parameters (k,) below which it may be what the rows leave open."""
    rows_s = recording.undeclared_rows_s
    pose_and_imu = max((rows_s.get(name, 0.0) for name in POSE_AND_IMU), default=0.0)
    commands = rows_s.get("motor_command", 0.0)
    lags = LAGS if recording.driven else ()  # rotor speeds would show the shift
    delays_s = {
        "time_offset": 0.5 * pose_and_imu,
        "command_latency": commands,
        "motor_asymmetry": ASYMMETRY_SHARE * commands,
    } | dict.fromkeys(lags, commands)
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
