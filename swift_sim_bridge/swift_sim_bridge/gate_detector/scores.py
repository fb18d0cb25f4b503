"""Scores of detected corners: correct, wrong and missed ones of one class, and recall at a precision."""

from dataclasses import dataclass

import numpy as np

# Pixels of the published image.
NEAR_PX = 3.0  # a corner is correct within this distance of a true one
IGNORED_PX = 8.0  # a corner within this distance of an ignored one is neither correct nor wrong


@dataclass(frozen=True)
class CornerMatches:
    """Detected corners of one class, matched to true ones.

    Attributes:
        found: (n,), confidence of each detected corner that counts.
        right: (n,) bool, it is correct.
        error_px: (n,), distance to the true corner; NaN if it is wrong.
        truth: (m,), index into `found` for each true corner; -1 if it was missed.
    """

    found: np.ndarray
    right: np.ndarray
    error_px: np.ndarray
    truth: np.ndarray


def match(points, confidence, true_points, ignored_points) -> CornerMatches:
    """Match detected corners of one class to true ones, in the order of confidence, each true one once.

    Args:
        points: (n, 2) px, detected.
        confidence: (n,).
        true_points: (m, 2) px.
        ignored_points: (k, 2) px, ignored corners; a wrong detection within IGNORED_PX of one is left out.
    """
    truth = np.full(len(true_points), -1)
    found, right, error = [], [], []
    for k in np.argsort(-np.asarray(confidence), kind="stable"):
        away = np.linalg.norm(true_points - points[k], axis=-1) if len(true_points) else np.zeros(0)
        free = np.where(truth < 0, away, np.inf)
        if len(free) and free.min() <= NEAR_PX:
            truth[np.argmin(free)] = len(found)
            entry = (confidence[k], True, free.min())
        elif len(ignored_points) and np.linalg.norm(ignored_points - points[k], axis=-1).min() <= IGNORED_PX:
            continue
        else:
            entry = (confidence[k], False, np.nan)
        for values, value in zip((found, right, error), entry, strict=True):
            values.append(value)
    return CornerMatches(np.array(found), np.array(right, bool), np.array(error), truth)


def recall_at_precision(found, right, truths: int, precision: float) -> tuple[float, float]:
    """Return (recall, threshold) of the lowest threshold with at least a precision; (0, 1) if there is none.

    Args:
        found, right: (n,), confidence and correctness of all detected corners.
        truths: number of true corners.
        precision: to reach.
    """
    order = np.argsort(-found, kind="stable")
    hits = np.cumsum(right[order])
    good = np.nonzero(hits / np.arange(1, len(order) + 1) >= precision)[0]
    if not len(good):
        return 0.0, 1.0
    return float(hits[good[-1]] / max(truths, 1)), float(found[order][good[-1]])
