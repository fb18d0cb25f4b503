"""Null distribution: statistics of the pipeline on reference flights, in which no effect is missing.

It gives the noise of every residual, the bias of the pipeline for every effect, the gain that an effect must have to be
selected, and the minimum detectable magnitude of each parameter.
"""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import special

from swift_sim_bridge.gap.inference.normal_equations import NormalEquations, accumulate, fit_gain
from swift_sim_bridge.gap.inference.sensitivity import Linearisation, parameter_steps
from swift_sim_bridge.parallel import run_in_threads

MIN_SIGNIFICANCE = 5.0  # standard deviations of the null distribution that an effect must have (chance: 6e-7)
REFERENCE_MARGIN = 1.25  # factor over the largest value of the reference flights, which one flight in 25 exceeds
MAX_BIAS_SHARE = 0.25  # largest share of an effect's gain that the bias of the pipeline may explain
MIN_INFORMATION_SHARE = 1e-6  # lower bound of a recording's information relative to its reference flights'
MIN_NOISE_FREE_SHARE = 0.05  # lower bound of the noise-free share of a sensitivity's square, which is itself estimated
SAMPLES_PER_SECOND = 50  # of residuals
WINDOW_S = 0.5  # over which residuals are averaged to see what is slow in them


@dataclass(frozen=True)
class NullDistribution:
    """Statistics of k reference flights with c channels, p parameters and g effects.

    Parameters are in their steps, sums of squares in independent samples.

    Attributes:
        noise: (c,) standard deviation of each residual, in its unit.
        sigma: (c,) the same, increased where neighbouring samples are correlated, so that seconds count correctly.
        spread: (p,) standard deviation of the estimate of each parameter alone.
        largest: (p,) largest deviation of these estimates from their mean.
        bias: (p,) mean of these estimates: what the pipeline finds where nothing is missing.
        information: (p,) information of each parameter alone over a flight.
        bias_gradient_by_channel: (p, c) mean gradient per second, by channel; it causes the bias.
        gains: (k, g) gain of each effect alone in each flight, with the bias gradient of the other flights subtracted.
        attenuation: (p,) part of the information that is noise of the sensitivity itself (errors in variables).
        slices: positions of each effect's parameters, by its key.
    """

    noise: np.ndarray
    sigma: np.ndarray
    spread: np.ndarray
    largest: np.ndarray
    bias: np.ndarray
    information: np.ndarray
    bias_gradient_by_channel: np.ndarray
    gains: np.ndarray
    attenuation: np.ndarray
    slices: dict[str, slice]

    @property
    def bias_gradient(self) -> np.ndarray:
        """The mean gradient per second (p,), over all channels."""
        return self.bias_gradient_by_channel.sum(axis=1)

    def variance_inflation(self, key: str) -> float:
        """Return the factor by which an effect's gain exceeds that of independent samples, at least 1."""
        return max(1.0, float(np.mean(self.null_gains(key))) / self._parameter_count(key))

    def threshold(self, key: str) -> float:
        """Return the gain that an effect needs to be selected."""
        by_chance = special.chdtri(self._parameter_count(key), 2.0 * special.ndtr(-MIN_SIGNIFICANCE))
        return max(by_chance * self.variance_inflation(key), REFERENCE_MARGIN * float(np.max(self.null_gains(key))))

    @property
    def minimum_detectable(self) -> np.ndarray:
        """The minimum detectable magnitude (p,) of each parameter alone, in its steps; infinite if unobservable.

        Noise of the sensitivity itself attenuates an estimate. In a hover, for example, the sensitivity to a time
        offset is the velocity of the pose, which is mostly noise. The magnitude is therefore divided by the noise-free
        share.
        """
        smallest = np.empty(len(self.spread))
        for key, rows in self.slices.items():
            smallest[rows] = np.sqrt(self.threshold(key) / np.maximum(self.information[rows], 1e-300))
        smallest = np.where(self.information > 0, smallest, np.inf)
        smallest = np.maximum(smallest, np.abs(self.bias) / np.sqrt(MAX_BIAS_SHARE))
        found = np.maximum(smallest, np.maximum(MIN_SIGNIFICANCE * self.spread, REFERENCE_MARGIN * self.largest))
        noise_free = 1.0 - self.attenuation / np.maximum(self.information, 1e-300)
        return found / np.clip(noise_free, MIN_NOISE_FREE_SHARE, 1.0)

    def is_exceeded(self, key: str, change: np.ndarray, factor: float) -> bool:
        """Return whether a parameter of an effect changes by more than `factor` times its minimum detectable magnitude.

        Args:
            key: the effect. One without information from reference flights has no minimum.
            change: (k,) change of its parameters, in steps.
            factor: the factor.
        """
        least = self.minimum_detectable[self.slices[key]]
        return bool(np.any(np.abs(change) > factor * np.where(np.isfinite(least), least, 0.0)))

    def null_gains(self, key: str) -> np.ndarray:
        """Return the gain (k,) of an effect alone in each reference flight."""
        return self.gains[:, list(self.slices).index(key)]

    def _parameter_count(self, key: str) -> int:
        return self.slices[key].stop - self.slices[key].start


def residual_weights(references: list[Linearisation], floor=0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return noise and sigma (c,) of each channel over reference flights.

    The noise is the standard deviation, at least `floor` (c,). Sigma is increased by the factor by which sums over
    whole seconds vary more than sums of independent samples would.
    """
    rows = [line.residual[line.good] - line.residual[line.good].mean(axis=0) for line in references]
    variance = np.maximum(np.mean([np.mean(row**2, axis=0) for row in rows], axis=0), np.square(floor))
    inflation = []
    for row in rows:
        whole = len(row) // SAMPLES_PER_SECOND * SAMPLES_PER_SECOND
        seconds = row[:whole].reshape(-1, SAMPLES_PER_SECOND, row.shape[1]).sum(axis=1)
        independent = np.maximum(SAMPLES_PER_SECOND * np.mean(row**2, axis=0), 1e-300)
        inflation.append(np.mean(seconds**2, axis=0) / independent)
    return np.sqrt(variance), np.sqrt(variance * np.maximum(np.mean(inflation, axis=0), 1.0)) + 1e-12


def estimate_null_distribution(
    references: list[Linearisation], slices: dict[str, slice], floor=0.0, noise_free: Linearisation | None = None
) -> NullDistribution:
    """Return the null distribution of reference flights.

    Args:
        references: linearisations of the reference flights.
        slices: positions of each effect's parameters, by its key.
        floor: (c,) lower bound of the noise of each channel.
        noise_free: linearisation of the first reference flight, measured without noise; without it the attenuation is
            zero.
    """
    noise, sigma = residual_weights(references, floor)
    equations = run_in_threads(*(partial(accumulate, line, sigma) for line in references))
    estimates = np.array([_single_estimates(one) for one in equations])
    gradients = np.array(
        [
            np.einsum("pmc,mc->pc", line.sensitivity, line.residual) / np.square(sigma) / np.count_nonzero(one.samples)
            for line, one in zip(references, equations, strict=True)
        ]
    )
    bias_gradient, count = gradients.mean(axis=0), len(gradients)
    of_others = [(count * bias_gradient - gradient).sum(axis=1) / max(count - 1, 1) for gradient in gradients]
    corrected = [subtract_bias(one, other) for one, other in zip(equations, of_others, strict=True)]
    gains = np.array([[fit_gain(one, rows) for rows in slices.values()] for one in corrected])
    deviations = estimates - estimates.mean(axis=0)
    spread = np.sqrt(np.sum(deviations**2, axis=0) / max(len(estimates) - 1, 1))
    information = np.mean([one.parameter_information for one in equations], axis=0)
    bias, attenuation = estimates.mean(axis=0), np.zeros(len(information))
    if noise_free:
        noisy_squares, squares = (
            np.einsum("pmc,c->p", line.sensitivity**2, 1.0 / sigma**2) for line in (references[0], noise_free)
        )
        attenuation = information * np.maximum(1.0 - squares / np.maximum(noisy_squares, 1e-300), 0.0)
    return NullDistribution(
        noise=noise,
        sigma=sigma,
        spread=spread,
        largest=np.abs(deviations).max(axis=0),
        bias=bias,
        information=information,
        bias_gradient_by_channel=bias_gradient,
        gains=gains,
        attenuation=attenuation,
        slices=slices,
    )


def minimum_detectable_changes(effects, null_distribution: NullDistribution) -> dict[str, dict[str, float]]:
    """Return the minimum detectable change of each parameter, in its unit, by effect id and parameter name.

    Of several variants it is the largest of the finite ones. Parameters that the flight does not show are left out.
    """
    found: dict = {}
    changes = parameter_steps(effects) * null_distribution.minimum_detectable
    for effect in effects:
        for parameter, change in zip(effect.parameters, changes[null_distribution.slices[effect.key]], strict=True):
            if np.isfinite(change):
                known = found.setdefault(effect.id, {})
                known[parameter.name] = max(known.get(parameter.name, 0.0), float(change))
    return found


def seconds_with_data(line: Linearisation) -> int:
    """Return the number of seconds of a flight that have residuals."""
    return len(np.unique(np.floor(line.t[line.good] - line.t[0])))


def difference_variance(line: Linearisation) -> np.ndarray:
    """Return the variance (c,) of the difference of neighbouring residuals: that of noise, without slow changes."""
    return np.var(np.diff(line.residual[line.good], axis=0), axis=0)


def window_squares(line: Linearisation) -> np.ndarray:
    """Return the sum of squares (c,) of the means of the residuals over windows of WINDOW_S: what is slow in them.

    It counts in samples: a constant residual has the sum of its squares. Windows with a sample that is not good count
    as none.
    """
    size = max(1, round(WINDOW_S / (line.t[1] - line.t[0])))
    whole = len(line.t) // size * size
    kept = line.good[:whole].reshape(-1, size).all(axis=1)
    means = line.residual[:whole].reshape(-1, size, line.residual.shape[1])[kept].mean(axis=1)
    return size * np.sum(means**2, axis=0)


def with_effect(null_distribution: NullDistribution, key: str, count: int, gains) -> NullDistribution:
    """Return the null distribution with one more effect of `count` parameters, which has gains (k,) and no bias."""
    nothing, begin = np.zeros(count), len(null_distribution.bias)
    by_channel = null_distribution.bias_gradient_by_channel
    return replace(
        null_distribution,
        **{
            name: np.concatenate([getattr(null_distribution, name), nothing])
            for name in ("spread", "largest", "bias", "information", "attenuation")
        },
        bias_gradient_by_channel=np.concatenate([by_channel, np.zeros((count, by_channel.shape[1]))]),
        gains=np.column_stack([null_distribution.gains, gains]),
        slices={**null_distribution.slices, key: slice(begin, begin + count)},
    )


def scaled_to_recording(null_distribution: NullDistribution, recorded: Linearisation, share: float) -> NullDistribution:
    """Return the null distribution with the information of the recording, where that is less than the references'.

    Reference flights may move more than the recording did, above all in a hover.

    Args:
        null_distribution: null distribution of the reference flights.
        recorded: linearisation of the recording.
        share: share of the recording that is not rejected, 0 to 1.
    """
    information = np.einsum("pmc,c->p", recorded.sensitivity**2, 1.0 / null_distribution.sigma**2)
    ratio = np.full(len(information), share)
    np.divide(information, null_distribution.information, out=ratio, where=null_distribution.information > 0)
    ratio = np.clip(ratio, MIN_INFORMATION_SHARE, share)
    wider = {name: getattr(null_distribution, name) / np.sqrt(ratio) for name in ("spread", "largest")}
    return replace(
        null_distribution,
        information=null_distribution.information * ratio,
        bias=null_distribution.bias / ratio,
        attenuation=null_distribution.attenuation * share,
        **wider,
    )


def with_noise_ratio(null_distribution: NullDistribution, ratios: list[np.ndarray]) -> NullDistribution:
    """Return the null distribution with its bias gradient weighted by the noise of the recordings.

    Args:
        null_distribution: null distribution of the reference flights.
        ratios: of each recording, (c,) standard deviation of its residuals relative to its reference flights'.
    """
    by_channel = null_distribution.bias_gradient_by_channel
    if len(ratios) == 1:
        return replace(null_distribution, bias_gradient_by_channel=by_channel / np.square(ratios[0]))
    weight = np.mean([np.mean(1.0 / np.square(ratio)) for ratio in ratios])
    return replace(null_distribution, bias_gradient_by_channel=by_channel * weight)


def subtract_bias(equations: NormalEquations, bias_gradient) -> NormalEquations:
    """Return normal equations without the bias gradient (p,) per second; for selection, not for estimation."""
    return replace(equations, gradient=equations.gradient - (equations.samples > 0)[:, None] * bias_gradient)


def _single_estimates(equations: NormalEquations) -> np.ndarray:
    """Return the estimate (p,) of each parameter alone; zero without information."""
    diagonal = equations.parameter_information
    return np.where(diagonal > 0, -equations.total_gradient / np.where(diagonal > 0, diagonal, 1.0), 0.0)


def pooled(parts: list[NullDistribution], seconds: list[int]) -> NullDistribution:
    """Return the null distribution of several recordings together, each with its own and its duration in seconds."""
    if len(parts) == 1:
        return parts[0]
    information = np.array([part.information for part in parts])
    share = information / np.maximum(information.sum(axis=0), 1e-300)
    spread, largest = (
        np.sqrt(np.sum(share**2 * np.array([getattr(part, name) for part in parts]) ** 2, axis=0))
        for name in ("spread", "largest")
    )
    gains = np.mean([part.gains for part in parts], axis=0)
    bias_gradient = np.average([part.bias_gradient for part in parts], axis=0, weights=seconds)
    bias = np.sum(share * np.array([part.bias for part in parts]), axis=0)
    return NullDistribution(
        noise=parts[0].noise,
        sigma=parts[0].sigma,
        spread=spread,
        largest=largest,
        bias=bias,
        information=information.sum(axis=0),
        bias_gradient_by_channel=bias_gradient[:, None],
        gains=gains,
        attenuation=np.sum([part.attenuation for part in parts], axis=0),
        slices=parts[0].slices,
    )
