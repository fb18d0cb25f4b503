"""The null population: what the pipeline makes of nominal twins, in whose recordings nothing was left out.

It tells the floor of every residual, what the pipeline invents for every effect, and so the smallest size of each that
can be told.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from swift_sim_bridge.gap.inference.normal_equations import NormalEquations, accumulate, fit_gain
from swift_sim_bridge.gap.inference.sensitivity import Linearisation, parameter_steps

SIGMAS = 5.0  # of what twins scatter, that an effect must have to be told
REFERENCE_MARGIN = 1.25  # and so many times the largest size that any twin shows
OWN_MAKING = 0.25  # of an effect's gain, that the pipeline may make of it by itself
MIN_INFORMATION_SHARE = 1e-6  # of what twins tell
LEAST_MOVED = 0.05  # of a footprint's square, below which its noise is not known well enough to take it off


@dataclass(frozen=True)
class NullDistribution:
    """noise (c,): standard deviation of each residual in twins; sigma (c,): the same, so wide that neighbours count as
    one sample where they move together; spread, largest (p,): of the sizes that single parameters would have in the
    twins about their mean, in their steps; made (p,): that mean, the pipeline's own; information (p,): of a single
    parameter, per step squared; artefacts (p, c): the mean product of footprints and residual in a second of a
    twin, by residual, which the pipeline makes itself; gains (k, g): by how much each of g effects alone lowers the
    squares of each of k twins, without that; attenuation (p,): how much of the information is a footprint's own noise; slices:
    where each effect's parameters stand."""

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
    def artefact(self) -> np.ndarray:
        """What the pipeline makes itself (p,), of all residuals together."""
        return self.bias_gradient_by_channel.sum(axis=1)

    def copies(self, key: str) -> float:
        """Return how many times larger the gain of an effect is in twins than independent samples would have it."""
        return max(1.0, float(np.mean(self.null_gains(key))) / self._size(key))

    def threshold(self, key: str) -> float:
        """Return the gain that an effect must have."""
        by_chance = stats.chi2.isf(2.0 * stats.norm.sf(SIGMAS), self._size(key)) * self.variance_inflation(key)
        return max(by_chance, REFERENCE_MARGIN * float(np.max(self.null_gains(key))))

    @property
    def detectable(self) -> np.ndarray:
        """The smallest size (p,) of each parameter alone that can be told, in its steps; infinite where none can.

        A footprint may be mostly noise, as of a time offset in a hover, where the pose's velocity is hardly anything
        else: a fit divides by all of it, and finds so much less than there is.
        """
        least = np.empty(len(self.spread))
        for key, rows in self.slices.items():
            least[rows] = np.sqrt(self.threshold(key) / np.maximum(self.information[rows], 1e-300))
        least = np.where(self.information > 0, least, np.inf)
        least = np.maximum(least, np.abs(self.bias) / np.sqrt(OWN_MAKING))
        found = np.maximum(least, np.maximum(SIGMAS * self.spread, REFERENCE_MARGIN * self.largest))
        return found / np.clip(1.0 - self.attenuation / np.maximum(self.information, 1e-300), LEAST_MOVED, 1.0)

    def gains_of(self, key: str) -> np.ndarray:
        """Return by how much an effect alone lowers the squares of each twin (k,)."""
        return self.gains[:, list(self.slices).index(key)]

    def _size(self, key: str) -> int:
        return self.slices[key].stop - self.slices[key].start


def residual_weights(twins: list[Linearisation], least=0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return noise and sigma (c,) of residuals: their standard deviation in twins, at least `least` (c,), and the same
    widened by the share in which whole seconds scatter more than independent samples would."""
    rows = [twin.residual[twin.good] - twin.residual[twin.good].mean(axis=0) for twin in twins]
    variance = np.maximum(np.mean([np.mean(row**2, axis=0) for row in rows], axis=0), np.square(least))
    copies = []
    for row in rows:
        whole = len(row) // 50 * 50
        seconds = row[:whole].reshape(-1, 50, row.shape[1]).sum(axis=1)
        copies.append(np.mean(seconds**2, axis=0) / np.maximum(50 * np.mean(row**2, axis=0), 1e-300))
    return np.sqrt(variance), np.sqrt(variance * np.maximum(np.mean(copies, axis=0), 1.0)) + 1e-12


def estimate_null_distribution(
    twins: list[Linearisation], parameter_slices: dict[str, slice], least=0.0, quiet: Linearisation | None = None
) -> NullDistribution:
    """Return the null population of twins; slices: where each effect's parameters stand; least (c,): of the noise;
    quiet: the first twin, recorded without noise."""
    noise, sigma = residual_weights(twins, least)
    sums = [accumulate(twin, sigma) for twin in twins]
    sizes = np.array([_single_sizes(one) for one in sums])
    means = np.array(
        [
            np.einsum("pmc,mc->pc", twin.sensitivity, twin.residual) / np.square(sigma) / np.count_nonzero(one.samples)
            for twin, one in zip(twins, sums, strict=True)
        ]
    )
    artefacts, count = means.mean(axis=0), len(means)
    others = [(count * artefacts - mean).sum(axis=1) / max(count - 1, 1) for mean in means]
    bare = [subtract_bias(one, other) for one, other in zip(sums, others, strict=True)]
    gains = np.array([[fit_gain(one, rows) for rows in parameter_slices.values()] for one in bare])
    apart = sizes - sizes.mean(axis=0)
    spread = np.sqrt(np.sum(apart**2, axis=0) / max(len(sizes) - 1, 1))
    information = np.mean([np.einsum("spp->p", one.matrix) for one in sums], axis=0)
    made, attenuation = sizes.mean(axis=0), np.zeros(len(information))
    if quiet:
        loud, calm = (np.einsum("pmc,c->p", one.sensitivity**2, 1.0 / sigma**2) for one in (twins[0], quiet))
        attenuation = information * np.maximum(1.0 - calm / np.maximum(loud, 1e-300), 0.0)
    return NullDistribution(
        noise,
        sigma,
        spread,
        np.abs(apart).max(axis=0),
        made,
        information,
        artefacts,
        gains,
        attenuation,
        parameter_slices,
    )


def minimum_detectable_changes(effects, nulls: NullDistribution) -> dict[str, dict[str, float]]:
    """Return the smallest change of each parameter that can be told, in its unit, by effect; of several variants the
    largest of those that can be told; without those that nothing shows."""
    found: dict = {}
    size = parameter_steps(effects) * nulls.detectable
    for effect in effects:
        for parameter, change in zip(effect.parameters, size[nulls.slices[effect.key]], strict=True):
            if np.isfinite(change):
                known = found.setdefault(effect.id, {})
                known[parameter.name] = max(known.get(parameter.name, 0.0), float(change))
    return found


def seconds_with_data(line: Linearisation) -> int:
    """Return in how many seconds of a flight there is a residual."""
    return len(np.unique(np.floor(line.t[line.good] - line.t[0])))


def difference_variance(line: Linearisation) -> np.ndarray:
    """Return the variance (c,) of the steps between neighbouring residuals: of noise, not of what slowly changes."""
    return np.var(np.diff(line.residual[line.good], axis=0), axis=0)


def with_effect(nulls: NullDistribution, key: str, count: int, gains) -> NullDistribution:
    """Return the population with one more effect of `count` parameters, by which each twin gains so much (k,)."""
    nothing, begin = np.zeros(count), len(nulls.bias)
    return replace(
        nulls,
        **{
            name: np.concatenate([getattr(nulls, name), nothing])
            for name in ("spread", "largest", "made", "information", "attenuation")
        },
        bias_gradient_by_channel=np.concatenate(
            [nulls.bias_gradient_by_channel, np.zeros((count, nulls.bias_gradient_by_channel.shape[1]))]
        ),
        gains=np.column_stack([nulls.gains, gains]),
        slices={**nulls.slices, key: slice(begin, begin + count)},
    )


def scaled_to_recording(nulls: NullDistribution, recorded: Linearisation, share: float) -> NullDistribution:
    """Return the population with what it tells of sizes lessened to what the recording itself tells: twins may move
    more than it did, in a hover above all. share: of the flight that was not refused, 0 to 1."""
    own = np.einsum("pmc,c->p", recorded.sensitivity**2, 1.0 / nulls.sigma**2)
    told = np.full(len(own), share)
    np.divide(own, nulls.information, out=told, where=nulls.information > 0)
    told = np.clip(told, MIN_INFORMATION_SHARE, share)
    wider = {name: getattr(nulls, name) / np.sqrt(told) for name in ("spread", "largest")}
    return replace(
        nulls,
        information=nulls.information * told,
        bias=nulls.bias / told,
        attenuation=nulls.attenuation * share,
        **wider,
    )


def with_noise_ratio(nulls: NullDistribution, times: list[np.ndarray]) -> NullDistribution:
    """Return the population with what the pipeline makes itself weighed as in recordings whose residuals are so many
    times (c,) as noisy as the twins'."""
    if len(times) == 1:
        return replace(nulls, bias_gradient_by_channel=nulls.bias_gradient_by_channel / np.square(times[0]))
    return replace(
        nulls,
        bias_gradient_by_channel=nulls.bias_gradient_by_channel
        * np.mean([np.mean(1.0 / np.square(one)) for one in times]),
    )


def subtract_bias(sums: NormalEquations, artefact) -> NormalEquations:
    """Return the sums of a recording without what the pipeline makes itself, its mean a second (p,). It helps choose,
    not to measure: a fit has it in full."""
    return replace(sums, products=sums.products - (sums.samples > 0)[:, None] * artefact)


def _single_sizes(sums: NormalEquations) -> np.ndarray:
    """Return the size (p,) that each parameter would have if it alone were at work; zero where nothing shows it."""
    diagonal = np.einsum("spp->p", sums.matrix)
    return np.where(diagonal > 0, -sums.products.sum(axis=0) / np.where(diagonal > 0, diagonal, 1.0), 0.0)


def pooled(parts: list[NullDistribution], seconds: list[int]) -> NullDistribution:
    """Return the population of a diagnosis of several recordings, each with its own and so many seconds long."""
    if len(parts) == 1:
        return parts[0]
    information = np.array([part.information for part in parts])
    share = information / np.maximum(information.sum(axis=0), 1e-300)
    spread, largest = (
        np.sqrt(np.sum(share**2 * np.array([getattr(part, name) for part in parts]) ** 2, axis=0))
        for name in ("spread", "largest")
    )
    gains = np.mean([part.gains for part in parts], axis=0)
    artefact = np.average([part.bias_gradient for part in parts], axis=0, weights=seconds)
    made = np.sum(share * np.array([part.bias for part in parts]), axis=0)
    first, attenuation = parts[0], np.sum([part.attenuation for part in parts], axis=0)
    return NullDistribution(
        first.noise,
        first.sigma,
        spread,
        largest,
        made,
        information.sum(axis=0),
        artefact[:, None],
        gains,
        attenuation,
        first.slices,
    )
