"""Counting corners: which found corners are right, which true ones were missed, by class and within some pixels."""

from dataclasses import dataclass

import numpy as np

NEAR_PX = 3.0  # published-image pixels within which a found corner is right
FORGIVEN_PX = 8.0  # around a corner that is not judged, a found one is neither right nor wrong


@dataclass(frozen=True)
class CornerMatches:
    """found (n,): confidence of every judged finding; right (n,) bool; error_px (n,): distance of the right ones, nan
    else; truth (m,): index of each true corner's finding, -1 where it was missed."""

    found: np.ndarray
    right: np.ndarray
    error_px: np.ndarray
    truth: np.ndarray


def match(points, confidence, true_points, forgiven_points) -> CornerMatches:
    """Match findings of one class (n, 2) px to true corners (m, 2) px, surest first, each truth once.

    A finding near none but within FORGIVEN_PX of a corner that is not judged is left out of the count.
    """
    truth = np.full(len(true_points), -1)
    found, right, error = [], [], []
    for k in np.argsort(-np.asarray(confidence), kind="stable"):
        away = np.linalg.norm(true_points - points[k], axis=-1) if len(true_points) else np.zeros(0)
        free = np.where(truth < 0, away, np.inf)
        if len(free) and free.min() <= NEAR_PX:
            truth[np.argmin(free)] = len(found)
            entry = (confidence[k], True, free.min())
        elif len(forgiven_points) and np.linalg.norm(forgiven_points - points[k], axis=-1).min() <= FORGIVEN_PX:
            continue
        else:
            entry = (confidence[k], False, np.nan)
        for values, value in zip((found, right, error), entry, strict=True):
            values.append(value)
    return CornerMatches(np.array(found), np.array(right, bool), np.array(error), truth)


def recall_at_precision(found, right, truths: int, precision: float) -> tuple[float, float]:
    """Return (recall, threshold) of the lowest threshold whose precision is at least `precision`; (0, 1) if none.

    found, right (n,): confidence and correctness of all findings; truths: number of true corners.
    """
    order = np.argsort(-found, kind="stable")
    hits = np.cumsum(right[order])
    good = np.nonzero(hits / np.arange(1, len(order) + 1) >= precision)[0]
    if not len(good):
        return 0.0, 1.0
    return float(hits[good[-1]] / max(truths, 1)), float(found[order][good[-1]])
