"""Black-box models of the specific force: alone, on the nominal vehicle, and of the remainder that a repair leaves.

A remainder joins the repair on an axis only if it predicts parts of the training data that it has not learned from:
blocks of the flight, or, of several flights, whole ones. Elsewhere it is zero. The mean error of a flight is a nuisance
of that flight: bias, trim, load and pack are others in the next. A remainder of several flights is learned without it,
and the repair with its remainder takes it from the past of the flight that it predicts, see `running_level`.
"""

from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np

from swift_ros import geometry
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.residuals.channels import AXES
from swift_sim_bridge.gap.residuals.rollout import BlackBox, black_box_force, black_box_inputs
from swift_sim_bridge.gap.validation.parts import Part, whole
from swift_sim_bridge.gap.validation.running_level import running_level
from swift_sim_bridge.parallel import run_in_threads
from swift_sim_bridge.residual_models import gaussian_process, nearest_neighbors
from swift_sim_bridge.residual_models.gaussian_process import GaussianProcess
from swift_sim_bridge.residual_models.nearest_neighbors import NearestNeighbors

# Nominal, repaired, repaired with the remainder, nominal with nearest neighbours, nominal with a Gaussian process.
MODELS = ("before", "after", "with_remainder", "knn", "gp")
WITH_REMAINDER = MODELS.index("with_remainder")
NONE = "none"  # kind of a remainder that does not join the repair
BLOCKS = 5  # of a single flight; each is predicted by a remainder that the others give
MIN_GAIN = 0.02  # mean over the blocks of log(RMS error without / with) from which a remainder joins
MAX_ROWS = 4096  # of inputs at a time: each takes 45 kB beside 800 samples
GAIN_ERRORS = 2.0  # standard errors of that mean by which it must exceed zero


class Samples(NamedTuple):
    """What black boxes learn from.

    Attributes:
        inputs: (n, 7), see `rollout.black_box_inputs`.
        targets: (n, 3) residual specific force, m/s^2.
    """

    inputs: np.ndarray
    targets: np.ndarray


@dataclass(frozen=True)
class Compared:
    """The models that are compared, in the order of MODELS.

    Attributes:
        vehicles: vehicle of each.
        boxes: black box of each, zero for those without; empty where forces are not compared.
        remainder: by axis the kind of the remainder's black box, or NONE where the repair has none.
    """

    vehicles: tuple[Vehicle, ...]
    boxes: tuple[BlackBox, ...]
    remainder: dict[str, str] = field(default_factory=dict)


def have_forces(parts: list[Part]) -> bool:
    """Return whether specific forces are compared in all these parts."""
    return all("force" in part.residual_model.groups for part in parts)


def compared(learned: list[Part], before: Vehicle, after: Vehicle, same_flights: bool) -> Compared:
    """Return the models that are compared.

    Args:
        learned: what the black boxes learn from: parts of recordings, not empty.
        before: the nominal vehicle.
        after: the repaired vehicle, with the same terms.
        same_flights: whether they are to predict other parts of these recordings, not other flights.
    """
    vehicles = (before, after, after, before, before)
    if not have_forces(learned):
        return Compared(vehicles, ())
    nominal, repaired = ([_samples(part, vehicle) for part in learned] for vehicle in (before, after))
    process, (remainder, kinds) = run_in_threads(
        partial(gaussian_process.fit, _blocks(nominal)), partial(fit_remainder, repaired, same_flights)
    )
    gp, knn = _gp_box(process), _knn_box(joined(nominal))
    none = gp._replace(targets=np.zeros_like(gp.targets))
    return Compared(vehicles, (none, none, remainder, knn, gp), kinds)


class ForceErrors(NamedTuple):
    """Errors of MODELS in the specific forces of a part of a recording.

    Attributes:
        as_compared: (5, k, 3) m/s^2; the repair with its remainder has the running level, the others have none.
        leveled: (5, k, 3) m/s^2, of each with its running level.
    """

    as_compared: np.ndarray
    leveled: np.ndarray


def force_errors(part: Part, models: Compared) -> ForceErrors:
    """Return the errors of MODELS; what a recording has before the part is the past from which levels come.

    All rows of the part must be good ones of its recording.
    """
    before, after, *_ = models.vehicles
    recording = whole(part.residual_model)
    nominal, repaired = (_samples(recording, one) for one in (before, after))
    left = (nominal, repaired, repaired, nominal, nominal)
    errors = np.stack([one.targets - _force(box, one.inputs) for one, box in zip(left, models.boxes, strict=True)])
    t = recording.residual_model.t[recording.rows]
    leveled = np.stack([one - running_level(t, one) for one in errors])[:, part.rows[recording.rows]]
    as_compared = errors[:, part.rows[recording.rows]]
    as_compared[WITH_REMAINDER] = leveled[WITH_REMAINDER]
    return ForceErrors(as_compared, leveled)


def _force(box: BlackBox, inputs) -> np.ndarray:
    """Return the specific force (n, 3) m/s^2 of a black box, a part of a long flight after the other."""
    if not np.any(box.targets):
        return np.zeros((len(inputs), len(AXES)))
    parts = np.array_split(inputs, -(-len(inputs) // MAX_ROWS))
    return np.concatenate([black_box_force(box, part) for part in parts])


def fit_remainder(flights: list[Samples], same_flights: bool) -> tuple[BlackBox, dict[str, str]]:
    """Return the black box of what a repair leaves, and its kind by axis; it is zero where it does not join the repair.

    Args:
        flights: samples of each flight in the order of time, with residuals of the repaired vehicle as targets.
        same_flights: whether later parts of these flights are to be predicted: there each block is predicted from those
            before it.
    """
    varying = flights  # a single flight cannot show which part of its mean is its own
    if len(flights) > 1:
        varying = [one._replace(targets=one.targets - one.targets.mean(axis=0)) for one in flights]
    splits = gaussian_process.splits(_blocks(varying), same_flights)
    process = gaussian_process.fit(_blocks(varying), same_flights)
    boxes = {"gp": _gp_box(process), "knn": _knn_box(joined(varying))}
    without = np.array([gaussian_process.log_mean_square(one.targets) for one, _ in splits])
    of_neighbors = np.array([_log_squares_of_neighbors(*split) for split in splits])
    gains = {"gp": _gain(without, process.log_squares), "knn": _gain(without, of_neighbors)}
    best = max(gains, key=lambda kind: gains[kind].sum())
    joins = gains[best] > 0.0
    kinds = {axis: best if taken else NONE for axis, taken in zip(AXES, joins, strict=True)}
    return boxes[best]._replace(targets=boxes[best].targets * joins), kinds


def _gain(without, log_squares) -> np.ndarray:
    """Return by axis (3,) the mean over b blocks of log(RMS error without / with), 0 where it may be chance.

    Args:
        without: (b, 3) log(mean squared error) without a model.
        log_squares: (b, 3) the same with the model that the other blocks give.
    """
    gain = 0.5 * (without - log_squares)
    mean, error = gain.mean(axis=0), gain.std(axis=0, ddof=1) / np.sqrt(len(gain))
    return np.where((mean > MIN_GAIN) & (mean > GAIN_ERRORS * error), mean, 0.0)


def _log_squares_of_neighbors(block: Samples, others: list[Samples]) -> np.ndarray:
    """Return log(mean squared error) (3,) in a block of the nearest neighbours among the other blocks' samples.

    They are as many as those of the Gaussian process with which they compete.
    """
    neighbors = _neighbors(joined(others), gaussian_process.MAX_TRIED)
    return gaussian_process.log_mean_square(block.targets - nearest_neighbors.predict(neighbors, block.inputs))


def joined(flights: list[Samples]) -> Samples:
    """Return the samples of all flights together."""
    return Samples(*(np.concatenate(parts) for parts in zip(*flights, strict=True)))


def _blocks(flights: list[Samples]) -> list[Samples]:
    """Return several flights as they are, a single one as BLOCKS parts of equal length."""
    if len(flights) > 1:
        return flights
    parts = (np.array_split(part, BLOCKS) for part in flights[0])
    return [Samples(*one) for one in zip(*parts, strict=True)]


def _gp_box(process: GaussianProcess) -> BlackBox:
    return BlackBox(process.inputs, process.scale, process.lengths, process.coefficients, 0.0)


def _neighbors(samples: Samples, most: int = gaussian_process.MAX_SAMPLES) -> NearestNeighbors:
    """Return nearest neighbours among at most `most` of the samples, evenly spaced."""
    chosen = gaussian_process.evenly_spaced(len(samples.inputs), most)
    return nearest_neighbors.fit(samples.inputs[chosen], samples.targets[chosen])


def _knn_box(samples: Samples) -> BlackBox:
    neighbors = _neighbors(samples)
    lengths = np.ones(len(AXES))  # nearest neighbours have none
    return BlackBox(neighbors.inputs, neighbors.scale, lengths, neighbors.targets, 1.0)


def _samples(part: Part, vehicle: Vehicle) -> Samples:
    """Return inputs of a vehicle's black box and residual specific force at each residual of a part."""
    recording, rows = part.residual_model.recording, part.residual_model.filter.rows[part.rows]
    measured = recording.q_world_body, recording.v_world, recording.gyro_body
    q, v, gyro, speed = (values[rows] for values in (*measured, part.residual_model.rotor_speed(vehicle)))
    inputs = black_box_inputs(geometry.rotate_inverse(q, v), gyro, speed, vehicle)
    return Samples(inputs, part.errors(vehicle)[:, part.residual_model.columns["force"]])
