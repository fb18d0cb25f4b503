"""Errors with which models predict parts of recordings: of one step, by channel, axis and speed, and of rollouts."""

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.residuals.channels import AXES
from swift_sim_bridge.gap.residuals.rollout import Trajectories, trajectories
from swift_sim_bridge.gap.validation.black_boxes import MODELS, Compared, force_errors, have_forces
from swift_sim_bridge.gap.validation.parts import Part

HORIZONS_S = (0.1, 0.2, 0.5, 1.0)  # duration of rollouts after which their errors are reported
SPEED_THIRDS = ("slow", "middle", "fast")
FORCE_CHANNELS = ("p_world", "q_world_body", "gyro_body", "specific_force_body", "rotor_speed")  # to compare forces


def evaluate(predicted: list[Part], models: Compared) -> tuple[dict, tuple[Trajectories, ...]]:
    """Return the errors with which the parts are predicted, as report.json has them, and the rollouts of MODELS.

    Errors of all channels are reported; those of specific forces and of positions after a rollout also by axis and
    speed, and for black-box models. Errors without a sample are left out.

    Args:
        predicted: what is predicted: parts that are not empty.
        models: what predicts it.
    """
    entry = _by_channel(predicted, *models.vehicles[:2])
    if not models.boxes or not have_forces(predicted):
        return _finite(entry), ()
    of_forces, flown = _of_forces(predicted, models)
    return _finite(entry | of_forces) | {"remainder": models.remainder}, flown


def _by_channel(parts: list[Part], before: Vehicle, after: Vehicle) -> dict:
    """Return the errors of each channel, and of gate corners, before and after the repair; empty without a sample."""
    found, corners = {}, []
    for part in parts:
        errors = np.stack([part.errors(vehicle) for vehicle in (before, after)])
        for i, channel in enumerate(part.residual_model.channels):
            if channel.layer == "camera":
                corners.append(errors[:, :, i])
            elif channel.layer != "force":
                found.setdefault(channel, []).append(errors[:, :, i])
    by_channel = {
        channel.id: _by_model(np.concatenate(columns, axis=1))
        for channel, columns in found.items()
        if len(columns) == len(parts)
    }
    entry = {"one_step_rmse_by_channel": by_channel}
    if corners:
        entry["reprojection_rmse_px"] = _by_model(np.concatenate(corners, axis=1))
    return entry


def _of_forces(parts: list[Part], models: Compared) -> tuple[dict, tuple[Trajectories, ...]]:
    """Return the errors of MODELS in specific forces and in positions after a rollout, and the rollouts.

    Rollouts need all of FORCE_CHANNELS and single rotor speeds: otherwise the moment or the first state is unknown.

    Args:
        parts: parts of recordings with forces.
        models: what is compared.
    """
    of_parts = [force_errors(part, models) for part in parts]
    errors, leveled = (np.concatenate(some, axis=1) for some in zip(*of_parts, strict=True))
    speed = np.concatenate([part.speed for part in parts])
    edges = np.quantile(speed, (1 / 3, 2 / 3))
    entry = {
        "one_step_rmse": _by_model(errors),
        "one_step_rmse_by_axis": {axis: _by_model(errors[:, :, i]) for i, axis in enumerate(AXES)},
        "one_step_rmse_with_level_by_axis": {axis: _by_model(leveled[:, :, i]) for i, axis in enumerate(AXES)},
        "one_step_rmse_by_speed": {name: _by_model(errors[:, rows]) for name, rows in _thirds(speed, edges)},
        "thirds_of_speed_m_s": {"slow_below": float(edges[0]), "fast_above": float(edges[1])},
    }
    if not all(one.residual_model.recording.has(*FORCE_CHANNELS, "single_rotor_speeds") for one in parts):
        return entry, ()
    flown = tuple(
        trajectories(one.residual_model, models.vehicles, models.boxes, one.begin_s, max(HORIZONS_S)) for one in parts
    )
    return entry | _rollout_entry(parts, flown, edges), flown


def _rollout_entry(parts: list[Part], flown: tuple[Trajectories, ...], edges) -> dict:
    """Return the entries of rollouts, by thirds of the speed with these `edges` (2,) m/s."""
    steps = [np.round(np.array(HORIZONS_S) / one.residual_model.recording.dt).astype(int) for one in parts]
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


def _thirds(speed, edges) -> list[tuple[str, np.ndarray]]:
    """Return the name of each third of the speeds (m,) with these `edges` (2,), and which speeds it contains."""
    third = np.searchsorted(edges, speed, "right")
    return [(name, third == i) for i, name in enumerate(SPEED_THIRDS)]


def _by_model(errors) -> dict:
    """Return the root mean square of errors (v, ...) by the name of the first v of MODELS."""
    return {name: _rms(one) for name, one in zip(MODELS, errors, strict=False)}


def _finite(entry: dict) -> dict:
    """Return a nested entry without numbers that are not finite, and without entries that are empty then."""
    found = {key: _finite(value) if isinstance(value, dict) else value for key, value in entry.items()}
    return {key: value for key, value in found.items() if (value if isinstance(value, dict) else np.isfinite(value))}


def _rms(values) -> float:
    """Return the root mean square of the finite values, NaN if there are none."""
    return float(np.sqrt(np.nanmean(np.square(values)))) if np.any(np.isfinite(values)) else float("nan")
