"""The time at which each command came into force at the rate loop: its delay, and whether it was lost.

At each pass of the loop one of the recent commands is in force, and never one older than at the pass before. The
sequence of commands with the highest likelihood given what the loop received (Viterbi algorithm) gives the time of each
command. A command that was never in force was lost, or a newer one overtook it.
"""

from dataclasses import dataclass

import numpy as np

NEGLIGIBLE = np.array([0.01, 0.01, 0.01, 0.001])  # rates rad/s and throttle: differences without practical meaning
MAX_DELAY_S = 0.05  # longest common delay that is tried: the upper bound of the effect `command_latency`
QUEUE = 8  # most recent commands, one of which is in force
DISTINCT = 6.0  # standard deviations between two commands that noise does not confuse
UNUSUAL_COST = 1.0  # squared standard deviations that a pass costs with another command than the common delay gives
LATEST_QUANTILE = 0.98  # upper end of the delays: robust against single outliers
MAX_IMMEDIATE = 0.02  # share of commands without delay above which the distribution is cut off at zero delay
SQRT_3 = np.sqrt(3.0)  # half the width of a uniform distribution, in standard deviations
STAMP_TOLERANCE_S = 1e-6  # time stamps are rounded to whole microseconds
MIN_TIMED = 30  # commands from which a jitter is estimated
MIN_JITTER = 0.25  # smallest jitter that is distinguished from the resolution of whole passes, in passes


@dataclass(frozen=True)
class Passes:
    """The passes of a rate loop, and the commands that were sent to it.

    Attributes:
        t: (n,) s.
        step_s: period of the loop.
        received: (n, 4) rates rad/s and throttle 0..1, reconstructed from the motor commands.
        observable: (n,) bool, where the motor commands determine `received`.
        sent: (k, 4) commands.
        first: (k,) s, the first pass at which each command could be in force.
    """

    t: np.ndarray
    step_s: float
    received: np.ndarray
    observable: np.ndarray
    sent: np.ndarray
    first: np.ndarray

    @classmethod
    def of(cls, t, step_s: float, stamps, sent) -> "Passes":
        """Return passes whose received commands are not reconstructed yet.

        Args:
            t: (n,) s, times of the passes.
            step_s: period of the loop.
            stamps: (k,) s, times at which the commands were sent.
            sent: (k, 4).
        """
        at = np.searchsorted(t, stamps - STAMP_TOLERANCE_S).clip(0, len(t) - 1)
        first = np.where(np.abs(t[at] - stamps) < 1.5 * step_s, t[at], stamps)
        return cls(t, step_s, np.zeros((len(t), 4)), np.zeros(len(t), bool), sent, first)

    def newest(self, due, by: float = 0.0) -> np.ndarray:
        """Return the index (n,) of the command in force at each pass.

        Args:
            due: (k,) s, arrival of each command, ascending.
            by: evaluate so many passes later.
        """
        return np.clip(np.searchsorted(due, self.t + by * self.step_s + STAMP_TOLERANCE_S, "right") - 1, 0, None)

    def in_force(self, due) -> np.ndarray:
        """Return the command (n, 4) in force over each pass.

        It is the newest that arrived; where one arrives within the pass, the mean of both, weighted by time.

        Args:
            due: (k,) s, arrival of each command, infinite for a lost one.
        """
        due = np.minimum.accumulate(due[::-1])[::-1]  # a command that a newer one overtakes never acts
        now, later = self.newest(due), self.newest(due, 1.0)
        share = np.where(later > now, (self.t + self.step_s - due[later]) / self.step_s, 0.0)
        return self.sent[now] + np.clip(share, 0.0, 1.0)[:, None] * (self.sent[later] - self.sent[now])


@dataclass(frozen=True)
class CommandTiming:
    """Loss and delay of k commands.

    Attributes:
        lost: (k,) bool, never in force.
        distinct: (k,) bool, so different from the command before that a loss is visible.
        excess_delay_s: (k,) delay beyond the common one, zero where it is not observable.
        jitter_s: standard deviation of the delay.
        timed: number of commands from which the jitter is estimated.
    """

    lost: np.ndarray
    distinct: np.ndarray
    excess_delay_s: np.ndarray
    jitter_s: float = 0.0
    timed: int = 0


def estimate_command_timing(passes: Passes) -> CommandTiming:
    """Return which commands were lost, and how the delays of the others scatter."""
    t, first, count = passes.t, passes.first, len(passes.first)
    delay_s, gain, offset = _common_delay(passes)
    sent = offset + gain * passes.sent
    usual = passes.newest(first + delay_s)
    errors = np.abs(passes.received - sent[usual])[passes.observable]
    noise = np.maximum(1.4826 * np.median(errors, axis=0), NEGLIGIBLE)
    index = _most_likely_sequence(passes, sent / noise, passes.received / noise, usual)
    acting, at = np.unique(index, return_index=True)
    every = np.arange(count)
    before = acting[np.clip(np.searchsorted(acting, every) - 1, 0, None)]
    period_s = float(np.median(np.diff(first)))
    noise_of_command = np.maximum(noise * np.sqrt(passes.step_s / period_s), NEGLIGIBLE)
    total = np.concatenate([[0], np.cumsum(passes.observable)])
    begin, end = (np.searchsorted(t, first + delay_s + more - STAMP_TOLERANCE_S) for more in (0.0, period_s))
    differs = np.linalg.norm((sent - sent[before]) / noise_of_command, axis=1) > DISTINCT
    distinct = differs & (total[end] > total[begin]) & (every > 0)
    came = np.full(count, np.nan)
    came[acting] = t[at]
    lost = distinct & np.isnan(came)
    timed = np.zeros(count, bool)
    contiguous = np.diff(t, prepend=-np.inf)[at] < 1.5 * passes.step_s
    timed[acting] = distinct[acting] & passes.observable[at] & passes.observable[np.maximum(at - 1, 0)] & contiguous
    return _with_jitter(CommandTiming(lost, distinct, np.zeros(count)), came, timed, passes)


def _with_jitter(found: CommandTiming, came, timed, passes: Passes) -> CommandTiming:
    """Return the timing with its jitter, modelled as uniform, if the delays scatter.

    Args:
        found: timing without jitter.
        came: (k,) s, the pass at which each command came into force, NaN for never.
        timed: (k,) bool, where the delay is observable.
        passes: gives `first` and the resolution.
    """
    step_s, delay_s = passes.step_s, came - passes.first
    sample = delay_s[timed]
    width_s = np.sqrt(max(np.var(sample) - step_s**2 / 12.0, 0.0)) * SQRT_3 if len(sample) >= MIN_TIMED else 0.0
    if width_s < MIN_JITTER * SQRT_3 * step_s:
        return found
    middle_s, immediate = np.mean(sample) - 0.5 * step_s, np.mean(sample < 0.5 * step_s)
    if immediate > MAX_IMMEDIATE:
        width_s = (np.quantile(sample, LATEST_QUANTILE) - 0.5 * step_s) / (2.0 * LATEST_QUANTILE - 2.0 * immediate)
        middle_s = width_s * (1.0 - 2.0 * immediate)
    after = np.minimum.accumulate(np.where(np.isnan(came), np.inf, came)[::-1])[::-1]
    overtaken_s = np.append(after[1:], np.inf) - passes.first  # a command that comes later than this never acts
    may_be_late = overtaken_s < np.max(sample) + step_s
    excess_s = np.where(timed, delay_s - middle_s, 0.0)
    excess_s = np.where(found.lost & may_be_late, 0.5 * (overtaken_s + width_s - middle_s), excess_s)
    jitter_s = float(width_s / SQRT_3)
    return CommandTiming(found.lost & ~may_be_late, found.distinct & ~may_be_late, excess_s, jitter_s, len(sample))


def _most_likely_sequence(passes: Passes, sent, received, usual) -> np.ndarray:
    """Return the index (n,) of the command in force at each pass, never falling, with the highest likelihood.

    Args:
        passes: the passes and commands.
        sent: (k, 4) in standard deviations.
        received: (n, 4) in standard deviations.
        usual: (n,) index of the command in force with the common delay.
    """
    agrees = np.sum((received - sent[usual]) ** 2, axis=1) < DISTINCT**2
    if np.all(agrees | ~passes.observable):
        return usual
    newest = passes.newest(passes.first)
    candidates = np.clip(newest[:, None] - np.arange(QUEUE), 0, None)
    squares = np.sum((received[:, None] - sent[candidates]) ** 2, axis=2)
    cost = np.where(passes.observable[:, None], squares, 0.0) + UNUSUAL_COST * (candidates != usual[:, None])
    arrived = np.clip(np.diff(newest, prepend=newest[0]), 0, QUEUE)
    reached = np.empty_like(cost)  # by age of the command: lowest cost of a sequence up to before this pass
    best = np.zeros(QUEUE)
    for i, new in enumerate(arrived):
        reached[i] = np.append(np.full(new, np.inf), best[: QUEUE - new]) if new < QUEUE else best.min()
        best = np.minimum.accumulate(reached[i][::-1])[::-1] + cost[i]
    age, ages = int(np.argmin(best)), np.empty(len(newest), int)
    for i in range(len(newest) - 1, -1, -1):
        ages[i] = age
        age = age + int(np.argmin(reached[i][age:])) - int(arrived[i])
        age = min(max(age, 0), QUEUE - 1)
    return np.maximum.accumulate(candidates[np.arange(len(newest)), ages])


def _common_delay(passes: Passes) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the common delay s of the commands, with gain and offset (4,) of the received on the sent commands."""
    fits = [(*delayed_fit(passes, delay_s), delay_s) for delay_s in np.arange(0.0, MAX_DELAY_S, passes.step_s)]
    _, gain, offset, delay_s = min(fits, key=lambda one: one[0])
    return delay_s, gain, offset


def delayed_fit(passes: Passes, delay_s: float) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the misfit of the received to the sent commands after a delay, and its gain and offset (4,)."""
    received = passes.received[passes.observable]
    sent = passes.sent[passes.newest(passes.first + delay_s)][passes.observable]
    centred = sent - sent.mean(axis=0)
    gain = np.sum(centred * received, axis=0) / np.maximum(np.sum(centred**2, axis=0), 1e-12)
    offset = received.mean(axis=0) - gain * sent.mean(axis=0)
    scale = np.maximum(received.std(axis=0), NEGLIGIBLE)
    return float(np.sum(((received - offset - gain * sent) / scale) ** 2)), gain, offset
