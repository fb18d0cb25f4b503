"""Gaussian-process regression with a squared-exponential kernel of one length scale for all normalised inputs.

Each target has its own length scale and noise: those with which the samples of some blocks predict another block best.
The marginal likelihood would take noise that is correlated in time for a function of the inputs.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from scipy import linalg

MAX_SAMPLES = 800  # of the training set; the fit takes time in proportion to the cube of their number
MAX_TRIED = 400  # of the samples with which length scale and noise are chosen
LENGTHS = (1.0, 2.0, 4.0, 8.0)  # length scales that are tried, in standard deviations of the inputs
NOISES = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0)  # noise variances that are tried, relative to the variance of the process
TINY = 1e-30  # added to mean squares, of which logarithms are taken


@dataclass(frozen=True)
class GaussianProcess:
    """A fitted process: its mean at a query is the kernel between query and inputs, times the coefficients.

    Attributes:
        inputs: (n, d) training inputs, divided by `scale`.
        scale: (d,) standard deviation of each input.
        lengths: (k,) length scale of each target, in standard deviations of the inputs.
        coefficients: (n, k) weights of the training inputs.
        log_squares: (b, k) log(mean squared error) with which each of b blocks is predicted from others, see `fit`.
    """

    inputs: np.ndarray
    scale: np.ndarray
    lengths: np.ndarray
    coefficients: np.ndarray
    log_squares: np.ndarray


def fit(blocks, forward: bool = False) -> GaussianProcess:
    """Return the process of several blocks of samples; at most MAX_SAMPLES are used, evenly spaced.

    Args:
        blocks: pairs of inputs (n, d) and targets (n, k), two or more.
        forward: whether each block but the first is predicted from those before it, not from all others.
    """
    inputs, targets = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
    deviation = np.maximum(np.std(inputs, axis=0), 1e-9)
    tried = [_log_squares(one, others, deviation) for one, others in splits(blocks, forward)]
    tried = np.stack(tried)  # (b, lengths, noises, k)
    mean = tried.mean(axis=0)
    best = [np.unravel_index(of_target.argmin(), of_target.shape) for of_target in np.moveaxis(mean, -1, 0)]
    chosen = evenly_spaced(len(inputs), MAX_SAMPLES)
    scaled, targets = inputs[chosen] / deviation, targets[chosen]
    lengths, noises = np.array([(LENGTHS[length], NOISES[noise]) for length, noise in best]).T
    coefficients = [
        linalg.solve(_kernel(scaled / length, scaled / length) + noise * np.eye(len(scaled)), column, assume_a="pos")
        for length, noise, column in zip(lengths, noises, targets.T, strict=True)
    ]
    log_squares = np.stack([tried[:, length, noise, k] for k, (length, noise) in enumerate(best)], axis=-1)
    return GaussianProcess(scaled, deviation, lengths, np.stack(coefficients, axis=-1), log_squares)


def splits(blocks, forward: bool) -> list[tuple]:
    """Return each block that is predicted, with the blocks that predict it, see `fit`."""
    if forward:
        return [(blocks[i], blocks[:i]) for i in range(1, len(blocks))]
    return [(blocks[i], [*blocks[:i], *blocks[i + 1 :]]) for i in range(len(blocks))]


def _log_squares(block, others, deviation) -> np.ndarray:
    """Return log(mean squared error) (lengths, noises, k) in a block of the processes that other blocks give.

    Args:
        block: inputs and targets.
        others: blocks.
        deviation: (d,) standard deviation of the inputs.
    """
    inputs, targets = (np.concatenate(parts) for parts in zip(*others, strict=True))
    chosen = evenly_spaced(len(inputs), MAX_TRIED)
    inputs, targets, (queries, truth) = inputs[chosen] / deviation, targets[chosen], block
    found = np.empty((len(LENGTHS), len(NOISES), targets.shape[1]))
    for j, length in enumerate(LENGTHS):
        values, vectors = np.linalg.eigh(_kernel(inputs / length, inputs / length))
        turned = vectors.T @ targets
        cross = _kernel(queries / (deviation * length), inputs / length) @ vectors
        for k, noise in enumerate(NOISES):
            left = truth - cross @ (turned / (np.maximum(values, 0.0) + noise)[:, None])
            found[j, k] = log_mean_square(left)
    return found


def log_mean_square(errors) -> np.ndarray:
    """Return the logarithm (k,) of the mean square of errors (n, k)."""
    return np.log(np.mean(np.square(errors), axis=0) + TINY)


def evenly_spaced(count: int, most: int) -> np.ndarray:
    """Return the indices of at most `most` of `count` samples."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))


def _kernel(a, b) -> np.ndarray:
    """Return the kernel (m, n) between rows of a (m, d) and b (n, d)."""
    squared = np.sum(a * a, axis=1)[:, None] + np.sum(b * b, axis=1) - 2.0 * a @ b.T
    return np.exp(-0.5 * np.maximum(squared, 0.0))


def weights(squared_distance, lengths):
    """Return the kernel (..., n, k) at squared normalised distances (..., n) for each of k length scales."""
    return jnp.exp(-0.5 * squared_distance[..., None] / lengths**2)


def predict(model: GaussianProcess, queries):
    """Return the mean (m, k) at queries (m, d)."""
    scaled = np.asarray(queries) / model.scale
    columns = (
        _kernel(scaled / length, model.inputs / length) @ column
        for length, column in zip(model.lengths, model.coefficients.T, strict=True)
    )
    return np.stack(list(columns), axis=-1)
