"""When each command came into force, read from what a rate loop heard: which were late, and which lost. Pure.

At every pass one of the commands under way is in force, never an older one than at the pass before: the sequence that
fits best what was heard (Viterbi) tells when each came. One that was never in force was lost, or a newer one overtook
it.
"""

from dataclasses import dataclass

import numpy as np

LEAST = np.array([0.01, 0.01, 0.01, 0.001])  # rad/s and throttle: nobody cares for less
LONGEST_S = 0.05  # common delay that is tried
UNDER_WAY = 8  # commands, of which one is in force
APART = 6.0  # standard deviations between two commands, to be told apart
UNUSUAL = 1.0  # squares that a pass costs which hears another command than the common delay says
LATEST, AT_ONCE = 0.98, 0.02  # quantile by which a spread is told if more than the latter came at once
EVEN = np.sqrt(3.0)  # half the width of what is evenly spread, in standard deviations
EDGE_S = 1e-6  # by which stamps are off because they are rounded
FEWEST, FINEST = 30, 0.25  # commands by which a spread is told, and the least one, in passes


@dataclass(frozen=True)
class Passes:
    """Of a rate loop, step_s apart. t (n,) s; heard (n, 4): rates rad/s and throttle 0..1; told (n,): where the motors
    tell them; sent (k, 4): commands; first (k,) s: the pass at which each could come into force."""

    t: np.ndarray
    step_s: float
    heard: np.ndarray
    told: np.ndarray
    sent: np.ndarray
    first: np.ndarray

    @classmethod
    def of(cls, t, step_s: float, stamps, sent) -> "Passes":
        """Return passes of which nothing is told yet; stamps (k,) s: when each command was sent."""
        at = np.searchsorted(t, stamps - EDGE_S).clip(0, len(t) - 1)
        first = np.where(np.abs(t[at] - stamps) < 1.5 * step_s, t[at], stamps)
        return cls(t, step_s, np.zeros((len(t), 4)), np.zeros(len(t), bool), sent, first)

    def newest(self, due, by: float = 0.0) -> np.ndarray:
        """Return which command (n,) is in force at each pass, or `by` passes later; due (k,) s: when they come, one
        after the other."""
        return np.clip(np.searchsorted(due, self.t + by * self.step_s + EDGE_S, "right") - 1, 0, None)

    def in_force(self, due) -> np.ndarray:
        """Return the command (n, 4) in force over each pass: the newest that came, blended by the share of the pass
        where one comes amidst it. due (k,) s: when each comes, infinite if never."""
        due = np.minimum.accumulate(due[::-1])[::-1]  # what a newer one overtook never acts
        now, later = self.newest(due), self.newest(due, 1.0)
        share = np.where(later > now, (self.t + self.step_s - due[later]) / self.step_s, 0.0)
        return self.sent[now] + np.clip(share, 0.0, 1.0)[:, None] * (self.sent[later] - self.sent[now])


@dataclass(frozen=True)
class CommandTiming:
    """What became of k commands. lost (k,): never in force; plain (k,): a loss would show; late_s (k,): beyond the
    common delay, zero where nothing tells; jitter_s: the deviation of that; timed: how many tell it."""

    lost: np.ndarray
    plain: np.ndarray
    late_s: np.ndarray
    jitter_s: float = 0.0
    timed: int = 0


def of(passes: Passes) -> CommandTiming:
    """Return what became of the commands."""
    t, first, count = passes.t, passes.first, len(passes.first)
    delay_s, gain, offset = _aligned(passes)
    sent = offset + gain * passes.sent
    usual = passes.newest(first + delay_s)
    noise = np.maximum(1.4826 * np.median(np.abs(passes.heard - sent[usual])[passes.told], axis=0), LEAST)
    index = _sequence(passes, sent / noise, passes.heard / noise, usual)
    seen, at = np.unique(index, return_index=True)
    every = np.arange(count)
    before = seen[np.clip(np.searchsorted(seen, every) - 1, 0, None)]
    period_s = float(np.median(np.diff(first)))
    fine = np.maximum(noise * np.sqrt(passes.step_s / period_s), LEAST)
    total = np.concatenate([[0], np.cumsum(passes.told)])
    begin, end = (np.searchsorted(t, first + delay_s + more - EDGE_S) for more in (0.0, period_s))
    plain = (np.linalg.norm((sent - sent[before]) / fine, axis=1) > APART) & (total[end] > total[begin]) & (every > 0)
    came = np.full(count, np.nan)
    came[seen] = t[at]
    lost = plain & np.isnan(came)
    known = np.zeros(count, bool)
    whole = np.diff(t, prepend=-np.inf)[at] < 1.5 * passes.step_s
    known[seen] = plain[seen] & passes.told[at] & passes.told[np.maximum(at - 1, 0)] & whole
    return _spread(CommandTiming(lost, plain, np.zeros(count)), first, came, known, passes.step_s)


def _spread(found: CommandTiming, first, came, known, step_s: float) -> CommandTiming:
    """Return the arrivals with how the delays scatter, if they do. first, came (k,) s: when each could come and did, no
    number for those never in force; known (k,): told by the motors."""
    delay_s = came - first
    sample = delay_s[known]
    width_s = np.sqrt(max(np.var(sample) - step_s**2 / 12.0, 0.0)) * EVEN if len(sample) >= FEWEST else 0.0
    if width_s < FINEST * EVEN * step_s:
        return found
    middle_s, immediate_share = np.mean(sample) - 0.5 * step_s, np.mean(sample < 0.5 * step_s)
    if immediate_share > AT_ONCE:
        width_s = (np.quantile(sample, LATEST) - 0.5 * step_s) / (2.0 * LATEST - 2.0 * immediate_share)
        middle_s = width_s * (1.0 - 2.0 * immediate_share)
    after = np.minimum.accumulate(np.where(np.isnan(came), np.inf, came)[::-1])[::-1]
    overtaken_s = np.append(after[1:], np.inf) - first  # a command that comes later than this never acts
    may = overtaken_s < np.max(sample) + step_s
    late_s = np.where(known, delay_s - middle_s, 0.0)
    late_s = np.where(found.lost & may, 0.5 * (overtaken_s + width_s - middle_s), late_s)
    return CommandTiming(found.lost & ~may, found.plain & ~may, late_s, float(width_s / EVEN), len(sample))


def _sequence(passes: Passes, sent, heard, usual) -> np.ndarray:
    """Return the command (n,) in force at each pass, of the sequences in which none is older than the one before the
    likeliest; sent (k, 4), heard (n, 4): in standard deviations; usual (n,): by the common delay."""
    agrees = np.sum((heard - sent[usual]) ** 2, axis=1) < APART**2
    if np.all(agrees | ~passes.told):
        return usual
    newest = passes.newest(passes.first)
    under_way = np.clip(newest[:, None] - np.arange(UNDER_WAY), 0, None)
    apart = np.sum((heard[:, None] - sent[under_way]) ** 2, axis=2)
    cost = np.where(passes.told[:, None], apart, 0.0) + UNUSUAL * (under_way != usual[:, None])
    older = np.clip(np.diff(newest, prepend=newest[0]), 0, UNDER_WAY)
    reached = np.empty_like(cost)  # by age: what the best sequence costs that ends so, before the pass itself
    best = np.zeros(UNDER_WAY)
    for i, by in enumerate(older):
        reached[i] = np.append(np.full(by, np.inf), best[: UNDER_WAY - by]) if by < UNDER_WAY else best.min()
        best = np.minimum.accumulate(reached[i][::-1])[::-1] + cost[i]
    age, ages = int(np.argmin(best)), np.empty(len(newest), int)
    for i in range(len(newest) - 1, -1, -1):
        ages[i] = age
        age = age + int(np.argmin(reached[i][age:])) - int(older[i])
        age = min(max(age, 0), UNDER_WAY - 1)
    return np.maximum.accumulate(under_way[np.arange(len(newest)), ages])


def _aligned(passes: Passes) -> tuple[float, np.ndarray, np.ndarray]:
    """Return by how much commands are late, s, and gain and offset (4,) of what is heard of them."""
    best, heard = None, passes.heard[passes.told]
    for delay_s in np.arange(0.0, LONGEST_S, passes.step_s):
        sent = passes.sent[passes.newest(passes.first + delay_s)][passes.told]
        apart = sent - sent.mean(axis=0)
        gain = np.sum(apart * heard, axis=0) / np.maximum(np.sum(apart**2, axis=0), 1e-12)
        offset = heard.mean(axis=0) - gain * sent.mean(axis=0)
        off = np.sum(((heard - offset - gain * sent) / np.maximum(heard.std(axis=0), LEAST)) ** 2)
        if best is None or off < best[0]:
            best = off, delay_s, gain, offset
    return best[1:]
