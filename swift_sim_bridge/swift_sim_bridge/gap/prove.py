"""What was found, on parts of the flights that it was not fitted on: before and after, and against black boxes."""

from dataclasses import dataclass, field

import numpy as np

from swift_ros import geometry
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.footprints import ready
from swift_sim_bridge.gap.residuals import AXES, Replayer, Variants
from swift_sim_bridge.gap.rollout import Box, Courses, boxed_inputs, courses
from swift_sim_bridge.residuals import gaussian_process, nearest_neighbors

HORIZONS_S = (0.1, 0.2, 0.5, 1.0)
MODELS = ("before", "after", "knn", "gp")
LEARNT_SHARE = 0.7  # of each flight that is fitted; the rest is flown


@dataclass(frozen=True)
class Proof:
    """entry: `held_out` of the report; courses: of each recording, flown by MODELS on its unseen part."""

    entry: dict = field(default_factory=dict)
    courses: tuple[Courses, ...] = ()


def held_out(replayers: tuple[Replayer, ...], before: Vehicle, after: Vehicle, effects) -> Proof:
    """Return the errors on the unseen part of each recording.

    after: with what was taken in, fitted on the first LEARNT_SHARE of each flight; effects: those that were taken in.
    """
    before, after = (ready(vehicle, tuple(effects)) for vehicle in (before, after))
    apart = {name: np.concatenate([_parted(one, vehicle, LEARNT_SHARE)[1] for one in replayers])
             for name, vehicle in (("before", before), ("after", after))}
    entry = {"one_step_rmse": {name: _rms(rows) for name, rows in apart.items()},
             "one_step_rmse_by_axis": {axis: {name: _rms(rows[:, i]) for name, rows in apart.items()}
                                       for i, axis in enumerate(AXES)}}  # fmt: skip
    if all(one.recording.sightings for one in replayers):
        entry["reprojection_rmse_px"] = {
            name: _rms(np.concatenate([_parted(one, vehicle, LEARNT_SHARE, "camera")[1].ravel() for one in replayers]))
            for name, vehicle in (("before", before), ("after", after))
        }
    if not all(one.recording.has("single_rotor_speeds") for one in replayers):
        return Proof(entry)  # what turns the vehicle is not known: no rollout would mean anything
    chosen, vehicles = boxes(replayers, before, LEARNT_SHARE), [before, after, before, before]
    flown = tuple(courses(one, vehicles, chosen, _split(one, LEARNT_SHARE), max(HORIZONS_S)) for one in replayers)
    errors = np.concatenate([one.errors(np.round(np.array(HORIZONS_S) / replayer.recording.dt).astype(int))
                             for one, replayer in zip(flown, replayers, strict=True)], axis=1)  # fmt: skip
    if errors.shape[1]:
        entry["rollout_rmse_m"] = {
            f"{horizon:.1f}": {name: _rms(errors[i, :, h]) for i, name in enumerate(MODELS)}
            for h, horizon in enumerate(HORIZONS_S)
        }
    return Proof(entry, flown)


def _split(replayer: Replayer, share: float) -> float:
    """Return the time before which a share of the flight lies."""
    t = replayer.recording.t
    return float(t[0] + share * (t[-1] - t[0]))


def _parted(replayer: Replayer, vehicle: Vehicle, share: float, layer: str = "force") -> tuple[np.ndarray, np.ndarray]:
    """Return the residuals of a layer (m, c) of the share that is learnt and of the part that is not, NaN where there
    are none."""
    residual = np.where(replayer.measured, replayer.of(Variants((vehicle,), ("",)))[0], np.nan)
    own = residual[:, [i for i, channel in enumerate(replayer.channels) if channel.layer == layer]]
    good, learnt = replayer.good(vehicle), replayer.t <= _split(replayer, share)
    return own[good & learnt], own[good & ~learnt]


def boxes(replayers: tuple[Replayer, ...], vehicle: Vehicle, share: float) -> list[Box]:
    """Return the black boxes of the four that fly, of which each has learnt a share of every recording: none, none,
    nearest neighbours, Gaussian process."""
    inputs, targets = [], []
    for one in replayers:
        recording, rows = one.recording, one.filter.rows
        v_body = geometry.rotate_inverse(recording.q_world_body, recording.v_world)
        heard = boxed_inputs(v_body, recording.gyro_body, recording.rotor_speed, vehicle)[rows]
        inputs.append(heard[one.good(vehicle) & (one.t <= _split(one, share))])
        targets.append(_parted(one, vehicle, share)[0])
    inputs, targets = np.concatenate(inputs), np.concatenate(targets)
    process = gaussian_process.fit(inputs, targets)
    chosen = np.unique(np.linspace(0, len(inputs) - 1, len(process.inputs)).astype(int))
    nearest = nearest_neighbors.fit(inputs[chosen], targets[chosen])
    silent = np.zeros_like(process.coefficients)
    none = Box(process.inputs, process.scale, silent, 0.0)
    return [none, none, Box(nearest.inputs, nearest.scale, nearest.targets, 1.0),
            Box(process.inputs, process.scale, process.coefficients, 0.0)]


def _rms(values) -> float:
    return float(np.sqrt(np.nanmean(np.square(values)))) if np.any(np.isfinite(values)) else float("nan")
