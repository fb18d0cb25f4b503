"""What neither effects nor an equation explain of a recording, although its reference flights have nothing like it.

An equation is a sum of products of quantities. What depends on the past of a flight, on another function of a quantity,
or on something that was not recorded leaves a residual that no product describes. It shows in two ways: the residual is
slower than the noise of any reference flight, with the process noise that its steps allow, or it follows a curve over
one quantity.
"""

from dataclasses import replace

import numpy as np

from swift_sim_bridge.gap.attribution.evidence import Evidence, Unexplained
from swift_sim_bridge.gap.attribution.process_noise import window_squares_of_noise
from swift_sim_bridge.gap.discovery.equation_search import DRIFTING_LAYER, searched_columns
from swift_sim_bridge.gap.inference import null_distribution, stepwise
from swift_sim_bridge.gap.inference.sensitivity import Linearisation
from swift_sim_bridge.gap.residuals.channels import VOLTAGE

CURVE_BINS = 10  # with equal numbers of samples, over which a residual may follow a curve
CURVE_MARGIN = 1.5  # factor over the gain that a term must have: a curve has ten numbers
SLOW_RATIO = 3.0  # of a recording's slow squares over the largest ones of a reference flight
MIN_SHARE = 0.002  # of a channel's squares that must be unexplained; less may be the error of strong effects
# The same of the voltage. It is simulated from the measured rotor speeds, so that the error of strong effects in other
# channels does not reach it, and a worn plug leaves little of what a larger resistance imitates.
MIN_SHARE_OF_VOLTAGE = 0.0005
# Noise of a recording over that of its reference flights: what changes by more from sample to sample is no noise of
# sensors, whose sheet may be wrong by a factor of two.
MAX_NOISE_RATIO = 2.0
TIME = "t"  # a curve over time is slow, and follows no quantity


def unexplained_channels(
    evidence: Evidence, before: list[Linearisation], after: list[np.ndarray]
) -> tuple[Unexplained, ...]:
    """Return what remains clearly above the reference flights, in the order of the channels.

    Camera and odometry are left out: the errors of a detector and the drift of odometry are slow by themselves.

    Args:
        evidence: the recordings.
        before: of each recording, the residuals of the vehicle file.
        after: of each recording, (m, c) normalised residuals that effects and equation leave.
    """
    scales = [np.minimum(1.0, MAX_NOISE_RATIO / ratio) for ratio in evidence.noise_ratios]
    lines = [
        replace(line, residual=residual / scale) for line, residual, scale in zip(before, after, scales, strict=True)
    ]
    squares = sum(
        np.sum((line.residual / (sigma * scale)) ** 2, axis=0)
        for line, sigma, scale in zip(before, evidence.sigmas, scales, strict=True)
    )
    slow = sum(null_distribution.window_squares(line) for line in lines)
    every, usual = sum(evidence.reference_squares), sum(evidence.reference_window_squares)
    references = zip(evidence.reference_difference_variance, evidence.sigmas, scales, strict=True)
    steps = [variance / (sigma * scale) ** 2 for variance, sigma, scale in references]
    usual = usual + sum(map(window_squares_of_noise, evidence.residual_models, lines, steps))
    remaining = sum(np.sum(line.residual**2, axis=0) for line in lines)
    found = []
    for c in searched_columns(evidence.residual_models):
        channel = evidence.residual_models[0].channels[c]
        if channel.layer == DRIFTING_LAYER:
            continue
        gain, quantity = _best_curve(evidence, lines, c)
        gain = min(gain, remaining[c] - every[c])  # reference flights may follow the curve, too: a bias of the method
        curve = gain if gain > CURVE_MARGIN * evidence.library.threshold else 0.0
        excess = slow[c] - usual[c] if slow[c] > SLOW_RATIO * usual[c] else 0.0
        left = max(curve, excess)
        share = MIN_SHARE_OF_VOLTAGE if channel.quantity == VOLTAGE else MIN_SHARE
        if left > max(evidence.library.threshold, share * squares[c]):
            share, significance = float(min(left / squares[c], 1.0)), stepwise.significance(left, CURVE_BINS)
            found.append(Unexplained(channel, share, significance, quantity if curve and quantity != TIME else ""))
    return tuple(found)


def _best_curve(evidence: Evidence, lines: list[Linearisation], c: int) -> tuple[float, str]:
    """Return the gain of the curve over one quantity that explains most of a channel's residual, and the quantity.

    The gain is that of independent samples.
    """
    own = [features[c] for features in evidence.library.features]
    residual = np.concatenate([line.residual[line.good, c] for line in lines])
    values = np.concatenate([one.values[line.good] for one, line in zip(own, lines, strict=True)])
    count = len(evidence.library.variance_inflation[c])
    gains = [curve_gain(values[:, i], residual) / evidence.library.variance_inflation[c][i] for i in range(count)]
    best = int(np.argmax(gains))
    return gains[best], own[0].names[best]


def curve_gain(values: np.ndarray, residual: np.ndarray) -> float:
    """Return by how much the best step curve over `values` (n,) lowers the squares of residuals (n,)."""
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, CURVE_BINS + 1)[1:-1]))
    part = np.searchsorted(edges, values, "right")
    count = np.maximum(np.bincount(part, minlength=len(edges) + 1), 1)
    return float(np.sum(np.bincount(part, residual, len(edges) + 1) ** 2 / count))
