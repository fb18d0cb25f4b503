"""What was found, on parts of the flights that it was not fitted on: before and after, and against black boxes."""

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

HORIZONS_S = (0.1, 0.2, 0.5, 1.0)
MODELS = ("before", "after", "knn", "gp")
TRAINING_SHARE = 0.7  # of each flight that is fitted; the rest is flown
THIRDS = ("slow", "middle", "fast")
FORCED = ("p_world", "q_world_body", "gyro_body", "specific_force_body", "rotor_speed")  # what tells a force


@dataclass(frozen=True)
class HoldoutResult:
    """entry: `held_out` of the report; courses: of each recording, flown by MODELS on its unseen part."""

    entry: dict = field(default_factory=dict)
    trajectories: tuple[Trajectories, ...] = ()


def validate(residual_models: tuple[ResidualModel, ...], before: Vehicle, after: Vehicle, effects) -> HoldoutResult:
    """Return the errors on the unseen part of each recording: of every channel at once, and where forces can be told,
    of them and of positions after a while against black boxes, by axis and by thirds of the speed. Errors of which
    there is no sample are left out.

    after: with what was taken in, fitted on the first LEARNT_SHARE of each flight; effects: those that were taken in.
    """
    before, after = (with_effect_terms(vehicle, tuple(effects)) for vehicle in (before, after))
    if not any(_rows(one, TRAINING_SHARE)[1].any() for one in residual_models):
        return HoldoutResult()
    entry = {"one_step_rmse_by_channel": _by_channel(residual_models, before, after)}
    if not all(one.recording.has(*FORCED) for one in residual_models):
        return HoldoutResult(_told(entry))
    chosen = boxes(residual_models, before, TRAINING_SHARE)
    missed = np.concatenate([_missed(one, before, after, chosen) for one in residual_models], axis=1)
    speed = np.concatenate([_speed(one) for one in residual_models])
    edges = np.quantile(speed, (1 / 3, 2 / 3))
    entry |= {
        "one_step_rmse": _by_model(missed),
        "one_step_rmse_by_axis": {axis: _by_model(missed[:, :, i]) for i, axis in enumerate(AXES)},
        "one_step_rmse_by_speed": {name: _by_model(missed[:, rows]) for name, rows in _thirds(speed, edges)},
        "thirds_of_speed_m_s": {"slow_below": float(edges[0]), "fast_above": float(edges[1])},
    }
    if all(one.recording.gate_observations for one in residual_models):
        entry["reprojection_rmse_px"] = _by_model(
            np.stack(
                [
                    np.concatenate(
                        [
                            _layer(one, vehicle, "camera")[_rows(one, TRAINING_SHARE)[1]].ravel()
                            for one in residual_models
                        ]
                    )
                    for vehicle in (before, after)
                ]
            )
        )
    if not all(one.recording.has("single_rotor_speeds") for one in residual_models):
        return HoldoutResult(_told(entry))  # what turns the vehicle is not known: no rollout would mean anything
    vehicles = [before, after, before, before]
    flown = tuple(
        trajectories(one, vehicles, chosen, _split(one, TRAINING_SHARE), max(HORIZONS_S)) for one in residual_models
    )
    return HoldoutResult(_told(entry | _of_rollouts(residual_models, flown, edges)), flown)


def _of_rollouts(residual_models, flown: tuple[Trajectories, ...], edges) -> dict:
    """Return the entries of rollouts, their speeds parted at the edges (2,) m/s."""
    steps = [np.round(np.array(HORIZONS_S) / one.recording.dt).astype(int) for one in residual_models]
    apart = [(one.flown - one.recorded)[:, rows] for one, rows in zip(flown, steps, strict=True)]
    speed = np.concatenate(
        [
            np.linalg.norm(one.recorded[0, rows[0]] - one.recorded[0, 0], axis=-1) / HORIZONS_S[0]
            for one, rows in zip(flown, steps, strict=True)
        ]
    )
    apart = np.moveaxis(np.concatenate(apart, axis=2), 1, 0)  # (horizons, models, rollouts, 3)

    def by_horizon(errors) -> dict:
        return {f"{horizon:.1f}": _by_model(one) for horizon, one in zip(HORIZONS_S, errors, strict=True)}

    lengths = np.linalg.norm(apart, axis=-1)
    by_speed = {name: by_horizon(lengths[..., rows]) for name, rows in _thirds(speed, edges)}
    by_axis = {axis: by_horizon(apart[..., i]) for i, axis in enumerate(AXES)}
    return {
        "rollout_rmse_m": by_horizon(lengths),
        "rollout_rmse_m_by_axis": by_axis,
        "rollout_rmse_m_by_speed": by_speed,
    }


def _by_channel(residual_models, before: Vehicle, after: Vehicle) -> dict:
    """Return errors by channel with their unit: of motors, moments, instruments among themselves, VIO and commands.
    Forces and corners have entries of their own."""
    found = {}
    for one in residual_models:
        unseen = _rows(one, TRAINING_SHARE)[1]
        apart = np.stack([_residuals(one, vehicle)[unseen] for vehicle in (before, after)])
        for i, channel in enumerate(one.channels):
            if channel.layer not in ("force", "camera"):
                found.setdefault(channel, []).append(apart[:, :, i])
    return {
        channel.name: _by_model(np.concatenate(some, axis=1)) | {"unit": channel.unit}
        for channel, some in found.items()
        if len(some) == len(residual_models)
    }


def _missed(residual_model: ResidualModel, before: Vehicle, after: Vehicle, chosen: list[BlackBox]) -> np.ndarray:
    """Return by how much MODELS miss the unseen specific forces (4, m, 3) m/s^2; chosen: their black boxes."""
    unseen = _rows(residual_model, TRAINING_SHARE)[1]
    plain, mended = (_layer(residual_model, vehicle, "force")[unseen] for vehicle in (before, after))
    knn, gp = (np.asarray(black_box_force(box, _heard(residual_model, before)[unseen])) for box in chosen[2:])
    return np.stack([plain, mended, plain - knn, plain - gp])


def _speed(residual_model: ResidualModel) -> np.ndarray:
    """Return the speed (m,) m/s at the unseen forces."""
    speed = np.linalg.norm(residual_model.recording.v_world, axis=1)[residual_model.filter.rows]
    return speed[_rows(residual_model, TRAINING_SHARE)[1]]


def _thirds(speed, edges) -> list[tuple[str, np.ndarray]]:
    """Return by name which speeds (m,) m/s lie in each third, parted at the edges (2,)."""
    third = np.searchsorted(edges, speed, "right")
    return [(name, third == i) for i, name in enumerate(THIRDS)]


def _by_model(errors) -> dict:
    """Return the root mean square by name of the first of MODELS, of errors (v, ...)."""
    return {name: _rms(one) for name, one in zip(MODELS, errors, strict=False)}


def _told(entry: dict) -> dict:
    """Return nested figures without those of no sample, nor a unit of none."""
    found = {key: _told(value) if isinstance(value, dict) else value for key, value in entry.items()}
    figures = {
        key
        for key, value in found.items()
        if not isinstance(value, str) and (value if isinstance(value, dict) else np.isfinite(value))
    }
    return {key: value for key, value in found.items() if figures and (key in figures or isinstance(value, str))}


def _rows(residual_model: ResidualModel, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Return which residuals (m,) are of the share that is learnt, and which of the part that is not."""
    good, learnt = residual_model.good, residual_model.t <= _split(residual_model, share)
    return good & learnt, good & ~learnt


def _split(residual_model: ResidualModel, share: float) -> float:
    """Return the time s until which a share of what rests on measurements in flight was recorded."""
    t = residual_model.t[residual_model.good]
    return float(t[int(np.ceil(share * len(t))) - 1]) if len(t) else float(residual_model.t[-1])


def _residuals(residual_model: ResidualModel, vehicle: Vehicle) -> np.ndarray:
    """Return the residuals (m, c), NaN where there is nothing to compare."""
    return np.where(residual_model.measured, residual_model.residual(vehicle), np.nan)


def _layer(residual_model: ResidualModel, vehicle: Vehicle, layer: str) -> np.ndarray:
    """Return the residuals (m, c) of a layer, NaN where there is nothing to compare."""
    columns = [i for i, channel in enumerate(residual_model.channels) if channel.layer == layer]
    return _residuals(residual_model, vehicle)[:, columns]


def _heard(residual_model: ResidualModel, vehicle: Vehicle) -> np.ndarray:
    """Return what a black box hears (m, 7) at each residual."""
    recording = residual_model.recording
    v_body = geometry.rotate_inverse(recording.q_world_body, recording.v_world)
    return black_box_inputs(v_body, recording.gyro_body, recording.rotor_speed, vehicle)[residual_model.filter.rows]


def boxes(residual_models: tuple[ResidualModel, ...], vehicle: Vehicle, share: float) -> list[BlackBox]:
    """Return the black boxes of the four that fly, of which each has learnt a share of every recording: none, none,
    nearest neighbours, Gaussian process."""
    inputs = [_heard(one, vehicle)[_rows(one, share)[0]] for one in residual_models]
    targets = [_layer(one, vehicle, "force")[_rows(one, share)[0]] for one in residual_models]
    inputs, targets = np.concatenate(inputs), np.concatenate(targets)
    process = gaussian_process.fit(inputs, targets)
    chosen = np.unique(np.linspace(0, len(inputs) - 1, len(process.inputs)).astype(int))
    nearest = nearest_neighbors.fit(inputs[chosen], targets[chosen])
    silent = np.zeros_like(process.coefficients)
    none = BlackBox(process.inputs, process.scale, silent, 0.0)
    return [
        none,
        none,
        BlackBox(nearest.inputs, nearest.scale, nearest.targets, 1.0),
        BlackBox(process.inputs, process.scale, process.coefficients, 0.0),
    ]


def _rms(values) -> float:
    return float(np.sqrt(np.nanmean(np.square(values)))) if np.any(np.isfinite(values)) else float("nan")
