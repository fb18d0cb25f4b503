"""Hold-out validation: errors before and after the repair, on parts of the flights that no fit has used.

The repaired vehicle is compared with the nominal one, and with the nominal one plus a black-box model of the remaining
forces: nearest neighbours or a Gaussian process.
"""

from dataclasses import dataclass, field

import numpy as np

from swift_ros import geometry
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.inference.sensitivity import with_effect_terms
from swift_sim_bridge.gap.residuals.channels import AXES
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.gap.residuals.rollout import (
    BlackBox,
    Trajectories,
    black_box_force,
    black_box_inputs,
    trajectories,
)
from swift_sim_bridge.residual_models import gaussian_process, nearest_neighbors

HORIZONS_S = (0.1, 0.2, 0.5, 1.0)  # duration of rollouts after which their errors are reported
MODELS = ("before", "after", "knn", "gp")  # nominal, repaired, nominal with nearest neighbours, with Gaussian process
TRAINING_SHARE = 0.7  # of each flight, from its start, that the fits use; the rest is held out
SPEED_THIRDS = ("slow", "middle", "fast")
FORCE_CHANNELS = ("p_world", "q_world_body", "gyro_body", "specific_force_body", "rotor_speed")  # to compare forces


@dataclass(frozen=True)
class HoldoutResult:
    """The result of a hold-out validation.

    Attributes:
        entry: entry `held_out` of report.json.
        trajectories: of each recording, the rollouts of MODELS on its held-out part.
    """

    entry: dict = field(default_factory=dict)
    trajectories: tuple[Trajectories, ...] = ()


def validate(residual_models: tuple[ResidualModel, ...], before: Vehicle, after: Vehicle, effects) -> HoldoutResult:
    """Return the errors on the held-out part of each recording.

    Errors of all channels are reported; those of specific forces and of positions after a rollout also by axis and
    speed, and for black-box models. Errors without a sample are left out.

    Args:
        residual_models: the recordings.
        before: the nominal vehicle.
        after: the vehicle with the selected effects, fitted to the first TRAINING_SHARE of each flight.
        effects: the selected effects.
    """
    before, after = (with_effect_terms(vehicle, tuple(effects)) for vehicle in (before, after))
    if not any(_rows(one, TRAINING_SHARE)[1].any() for one in residual_models):
        return HoldoutResult()
    entry = {"one_step_rmse_by_channel": _by_channel(residual_models, before, after)}
    if not all("force" in one.groups for one in residual_models):
        return HoldoutResult(_finite(entry))
    models = black_boxes(residual_models, before, TRAINING_SHARE)
    errors = np.concatenate([_force_errors(one, before, after, models) for one in residual_models], axis=1)
    speed = np.concatenate([_speed(one) for one in residual_models])
    edges = np.quantile(speed, (1 / 3, 2 / 3))
    entry |= {
        "one_step_rmse": _by_model(errors),
        "one_step_rmse_by_axis": {axis: _by_model(errors[:, :, i]) for i, axis in enumerate(AXES)},
        "one_step_rmse_by_speed": {name: _by_model(errors[:, rows]) for name, rows in _thirds(speed, edges)},
        "thirds_of_speed_m_s": {"slow_below": float(edges[0]), "fast_above": float(edges[1])},
    }
    if all(one.recording.gate_observations for one in residual_models):
        entry["reprojection_rmse_px"] = _by_model(_reprojection_errors(residual_models, before, after))
    if not all(one.recording.has(*FORCE_CHANNELS, "single_rotor_speeds") for one in residual_models):
        return HoldoutResult(_finite(entry))  # the moment or the first state is unknown: rollouts are meaningless
    vehicles = [before, after, before, before]
    flown = tuple(
        trajectories(one, vehicles, models, _split_time(one, TRAINING_SHARE), max(HORIZONS_S))
        for one in residual_models
    )
    return HoldoutResult(_finite(entry | _rollout_entry(residual_models, flown, edges)), flown)


def _rollout_entry(residual_models, flown: tuple[Trajectories, ...], edges) -> dict:
    """Return the entries of rollouts, by thirds of the speed with these `edges` (2,) m/s."""
    steps = [np.round(np.array(HORIZONS_S) / one.recording.dt).astype(int) for one in residual_models]
    errors = [(one.flown - one.recorded)[:, rows] for one, rows in zip(flown, steps, strict=True)]
    speed = np.concatenate(
        [
            np.linalg.norm(one.recorded[0, rows[0]] - one.recorded[0, 0], axis=-1) / HORIZONS_S[0]
            for one, rows in zip(flown, steps, strict=True)
        ]
    )
    errors = np.moveaxis(np.concatenate(errors, axis=2), 1, 0)  # (horizons, models, rollouts, 3)

    def by_horizon(values) -> dict:
        return {f"{horizon:.1f}": _by_model(one) for horizon, one in zip(HORIZONS_S, values, strict=True)}

    distances = np.linalg.norm(errors, axis=-1)
    by_speed = {name: by_horizon(distances[..., rows]) for name, rows in _thirds(speed, edges)}
    by_axis = {axis: by_horizon(errors[..., i]) for i, axis in enumerate(AXES)}
    return {
        "rollout_rmse_m": by_horizon(distances),
        "rollout_rmse_m_by_axis": by_axis,
        "rollout_rmse_m_by_speed": by_speed,
    }


def _by_channel(residual_models, before: Vehicle, after: Vehicle) -> dict:
    """Return the errors of each channel but forces and corners, which have entries of their own."""
    found = {}
    for one in residual_models:
        held_out = _rows(one, TRAINING_SHARE)[1]
        errors = np.stack([_residuals(one, vehicle)[held_out] for vehicle in (before, after)])
        for i, channel in enumerate(one.channels):
            if channel.layer not in ("force", "camera"):
                found.setdefault(channel, []).append(errors[:, :, i])
    return {
        channel.id: _by_model(np.concatenate(parts, axis=1))
        for channel, parts in found.items()
        if len(parts) == len(residual_models)
    }


def _force_errors(residual_model: ResidualModel, before: Vehicle, after: Vehicle, models: list[BlackBox]) -> np.ndarray:
    """Return the errors (4, m, 3) m/s^2 of MODELS in the held-out specific forces, with their black boxes."""
    held_out = _rows(residual_model, TRAINING_SHARE)[1]
    nominal, repaired = (_layer(residual_model, vehicle, "force")[held_out] for vehicle in (before, after))
    inputs = _black_box_inputs(residual_model, before)[held_out]
    knn, gp = (np.asarray(black_box_force(model, inputs)) for model in models[2:])
    return np.stack([nominal, repaired, nominal - knn, nominal - gp])


def _reprojection_errors(residual_models, before: Vehicle, after: Vehicle) -> np.ndarray:
    """Return the errors (2, n) px of the held-out gate corners, before and after."""
    return np.stack(
        [
            np.concatenate(
                [_layer(one, vehicle, "camera")[_rows(one, TRAINING_SHARE)[1]].ravel() for one in residual_models]
            )
            for vehicle in (before, after)
        ]
    )


def _speed(residual_model: ResidualModel) -> np.ndarray:
    """Return the speed (m,) m/s at the held-out residuals."""
    speed = np.linalg.norm(residual_model.recording.v_world, axis=1)[residual_model.filter.rows]
    return speed[_rows(residual_model, TRAINING_SHARE)[1]]


def _thirds(speed, edges) -> list[tuple[str, np.ndarray]]:
    """Return the name of each third of the speeds (m,) with these `edges` (2,), and which speeds it contains."""
    third = np.searchsorted(edges, speed, "right")
    return [(name, third == i) for i, name in enumerate(SPEED_THIRDS)]


def _by_model(errors) -> dict:
    """Return the root mean square of errors (v, ...) by the name of the first v of MODELS."""
    return {name: _rms(one) for name, one in zip(MODELS, errors, strict=False)}


def _finite(entry: dict) -> dict:
    """Return a nested entry without numbers that are not finite, and without units that belong to none."""
    found = {key: _finite(value) if isinstance(value, dict) else value for key, value in entry.items()}
    numbers = {
        key
        for key, value in found.items()
        if not isinstance(value, str) and (value if isinstance(value, dict) else np.isfinite(value))
    }
    return {key: value for key, value in found.items() if numbers and (key in numbers or isinstance(value, str))}


def _rows(residual_model: ResidualModel, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Return which residuals (m,) belong to the training share, and which are held out."""
    good, training = residual_model.good, residual_model.t <= _split_time(residual_model, share)
    return good & training, good & ~training


def _split_time(residual_model: ResidualModel, share: float) -> float:
    """Return the time s at which the training share of the residuals ends."""
    t = residual_model.t[residual_model.good]
    return float(t[int(np.ceil(share * len(t))) - 1]) if len(t) else float(residual_model.t[-1])


def rows_by_part(residual_model: ResidualModel) -> tuple[np.ndarray, np.ndarray]:
    """Return which residuals (m,) the fits use, and which are held out."""
    return _rows(residual_model, TRAINING_SHARE)


def _residuals(residual_model: ResidualModel, vehicle: Vehicle) -> np.ndarray:
    """Return the residuals (m, c), NaN where nothing was measured."""
    return np.where(residual_model.measured, residual_model.residual(vehicle), np.nan)


def _layer(residual_model: ResidualModel, vehicle: Vehicle, layer: str) -> np.ndarray:
    """Return the residuals (m, c) of one layer, NaN where nothing was measured."""
    columns = [i for i, channel in enumerate(residual_model.channels) if channel.layer == layer]
    return _residuals(residual_model, vehicle)[:, columns]


def _black_box_inputs(residual_model: ResidualModel, vehicle: Vehicle) -> np.ndarray:
    """Return the inputs (m, 7) of a black box at each residual, see `rollout.black_box_inputs`."""
    recording = residual_model.recording
    v_body = geometry.rotate_inverse(recording.q_world_body, recording.v_world)
    return black_box_inputs(v_body, recording.gyro_body, recording.rotor_speed, vehicle)[residual_model.filter.rows]


def black_boxes(residual_models: tuple[ResidualModel, ...], vehicle: Vehicle, share: float) -> list[BlackBox]:
    """Return the black box of each of MODELS, trained on a share of every recording; the first two are zero."""
    inputs = [_black_box_inputs(one, vehicle)[_rows(one, share)[0]] for one in residual_models]
    targets = [_layer(one, vehicle, "force")[_rows(one, share)[0]] for one in residual_models]
    inputs, targets = np.concatenate(inputs), np.concatenate(targets)
    process = gaussian_process.fit(inputs, targets)
    chosen = np.unique(np.linspace(0, len(inputs) - 1, len(process.inputs)).astype(int))
    neighbors = nearest_neighbors.fit(inputs[chosen], targets[chosen])
    zero = BlackBox(process.inputs, process.scale, np.zeros_like(process.coefficients), 0.0)
    return [
        zero,
        zero,
        BlackBox(neighbors.inputs, neighbors.scale, neighbors.targets, 1.0),
        BlackBox(process.inputs, process.scale, process.coefficients, 0.0),
    ]


def _rms(values) -> float:
    """Return the root mean square of the finite values, NaN if there are none."""
    return float(np.sqrt(np.nanmean(np.square(values)))) if np.any(np.isfinite(values)) else float("nan")
