"""Which effects the flights call for. Pure: all of it is algebra on sums over seconds (`footprints.Sums`).

An effect is taken in with all its parameters and its whole footprint, and only where every gate lets it pass: what
twins never show, seconds of flight that agree, and parts of the flight that the fit has not seen.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy import special, stats

from swift_sim_bridge.gap.inference.normal_equations import NormalEquations, fit_gain, solve
from swift_sim_bridge.gap.inference.null_distribution import OWN_MAKING, NullDistribution

BLOCKS = 8
LEAST_ERRORS = 1.5  # standard errors by which unseen blocks must improve
FAMILY = 1e-3  # chance of any false effect that the seconds' agreement alone would let pass
UNTOLD, SHOWN = 0.005, 0.01  # of what the whole flight tells of a parameter
LIKELY = 0.05  # weight from which on a look-alike is named
CLEARLY = 3.0  # log-likelihoods by which one must explain more to take another's place (Kass and Raftery: strong)
INEXACT = 0.002  # of what an effect explains, by which rivals for it may differ because the simulator is not exact
MADE_AT_MOST = 60.0  # squares by which rivals may differ for what the pipeline makes; a strong effect makes that grow
BEYOND = 2.0  # standard errors by which a size may be off what is physical
TELLABLE = 1.0  # of squares, that a parameter must change where it is as far from the file's value as can be
ALIKE_SHARE = 0.25  # of its gain that an effect may lose to a look-alike


@dataclass(frozen=True)
class SelectionProblem:
    """What the selection works on. sums: of the recording against the nominal vehicle to first order; slices: where the
    parameters of each effect stand; nulls; whole: the sums with what the pipeline makes itself; low, high (p,): sizes
    that are physical, in steps from the file's."""

    sums: NormalEquations
    slices: dict[str, slice]
    null_distribution: NullDistribution
    whole: NormalEquations | None = None
    low: np.ndarray | None = None
    high: np.ndarray | None = None

    def rows(self, keys: Iterable[str]) -> np.ndarray:
        """Return where the parameters of these effects stand."""
        return np.concatenate(
            [np.arange(s.start, s.stop) for s in (self.slices[key] for key in keys)] or [np.empty(0, int)]
        ).astype(int)

    def gain(self, keys: Iterable[str]) -> float:
        """Return by how much these effects lower the sum of squares."""
        rows = self.rows(keys)
        return fit_gain(self.sums, rows) if len(rows) else 0.0

    def score(self, key: str, gain: float) -> float:
        """Return what an effect's gain is worth: a log-likelihood less what its parameters cost."""
        return 0.5 * gain / self.null_distribution.variance_inflation(key) - self.cost(key)

    def cost(self, key: str) -> float:
        """Return what an effect's parameters cost of a log-likelihood (Schwarz)."""
        return 0.5 * (self.slices[key].stop - self.slices[key].start) * np.log(max(self.sums.samples.sum(), 2.0))


@dataclass(frozen=True)
class Fit:
    """Sizes (k,) of the parameters `rows` (k,) in their steps, and their covariance (k, k) by seconds that scatter."""

    rows: np.ndarray
    sizes: np.ndarray
    covariance: np.ndarray


def fit(sums: NormalEquations, rows, copies: float = 1.0) -> Fit:
    """Return the fit of some parameters. The covariance is the sandwich over seconds (Liang and Zeger), at least that
    of independent samples times `copies`."""
    matrix = sums.matrix.sum(axis=0)[np.ix_(rows, rows)]
    sizes = -solve(matrix, sums.products.sum(axis=0)[rows])
    inverse = solve(matrix, np.eye(len(rows)))
    score = sums.products[:, rows] + sums.matrix[:, rows][:, :, rows] @ sizes
    seconds = np.count_nonzero(sums.samples)
    meat = score.T @ score * seconds / max(seconds - len(rows), 1)
    sandwich, plain = inverse @ meat @ inverse, copies * inverse
    wider = np.sqrt(np.maximum(1.0, np.diag(plain) / np.maximum(np.diag(sandwich), 1e-300)))
    return Fit(rows, sizes, sandwich * np.outer(wider, wider))


def step(sums: NormalEquations, damping: float, low, high) -> np.ndarray:
    """Return the step (p,) between low and high (p,) that lowers the squares most; damping: as a share of what they
    tell of each parameter, which shortens the step most where they tell least (Levenberg and Marquardt).

    What stops at a bound stays there, and the others make the best of it.
    """
    matrix, products = sums.matrix.sum(axis=0), sums.products.sum(axis=0)
    matrix = matrix + damping * np.diag(np.diag(matrix))
    found, free = np.zeros(len(products)), np.ones(len(products), bool)
    while free.any():
        rows = np.flatnonzero(free)
        slope = products[rows] + matrix[np.ix_(rows, ~free)] @ found[~free]
        found[rows] = -solve(matrix[np.ix_(rows, rows)], slope)
        beyond = free & ((found < low) | (found > high))
        if not beyond.any():
            break
        found, free = np.clip(found, low, high), free & ~beyond
    return found


def told(sums: NormalEquations, low, high) -> np.ndarray:
    """Return of which parameters (p,) the flights tell anything: an accelerometer's scale on an axis that feels nothing
    would be anything. low, high (p,): how far they may be off in steps."""
    reach = np.maximum(np.abs(low), np.abs(high))
    with np.errstate(invalid="ignore"):
        return ~(reach**2 * np.einsum("spp->p", sums.matrix) < TELLABLE)


def restricted_to(sums: NormalEquations, kept: np.ndarray) -> NormalEquations:
    """Return the sums in which the other parameters do nothing. kept (p,): whether one is kept."""
    return replace(sums, products=sums.products * kept, matrix=sums.matrix * np.outer(kept, kept))


def passes(scene: SelectionProblem, taken: list[str], key: str) -> tuple[bool, float]:
    """Return whether an effect may join those taken, and its significance in standard deviations."""
    gain = scene.gain([*taken, key]) - scene.gain(taken)
    size = scene.slices[key].stop - scene.slices[key].start
    sigma = significance(gain / scene.null_distribution.variance_inflation(key), size)
    if gain < scene.null_distribution.threshold(key) or not _believable(scene, taken, key):
        return False, sigma
    found = fit(scene.sums, scene.rows([*taken, key]), scene.null_distribution.variance_inflation(key))
    if not _physical(scene, found, size):
        return False, sigma
    wald = found.sizes[-size:] @ solve(found.covariance[-size:, -size:], found.sizes[-size:])
    seconds = np.count_nonzero(scene.sums.samples)
    chance = stats.f.sf(wald / size * (seconds - size) / max(seconds - 1, 1), size, max(seconds - size, 1))
    if chance > FAMILY / len(scene.slices):
        return False, sigma
    return passes_cross_validation(scene, taken, key), sigma


def _physical(scene: SelectionProblem, found: Fit, size: int) -> bool:
    """Return whether the last `size` parameters of a fit can be true: no drag pushes, but an estimate may be off by its
    error. What does not pass leaves its place to the next."""
    if scene.low is None:
        return True
    rows, sizes = found.rows[-size:], found.sizes[-size:]
    room = BEYOND * np.sqrt(np.diag(found.covariance)[-size:])
    return bool(np.all((sizes > scene.low[rows] - room) & (sizes < scene.high[rows] + room)))


def _believable(scene: SelectionProblem, taken: list[str], key: str) -> bool:
    """Return whether an effect is more than what the pipeline itself would make of it: where noise in a quantity
    outweighs its motion, as in hover, sizes are worth little."""
    if scene.whole is None:
        return True
    rows, size = scene.rows([*taken, key]), scene.slices[key].stop - scene.slices[key].start
    bare, whole = (fit(sums, rows) for sums in (scene.sums, scene.whole))
    inverse = solve(scene.sums.matrix.sum(axis=0)[np.ix_(rows, rows)], np.eye(len(rows)))[-size:, -size:]
    own, made = bare.sizes[-size:], whole.sizes[-size:] - bare.sizes[-size:]
    return bool(made @ solve(inverse, made) < OWN_MAKING * (own @ solve(inverse, own)))


def significance(gain: float, size: int) -> float:
    """Return how many standard deviations a normal variable must be off to be as unlikely as a gain of `size`
    parameters by chance."""
    if gain < 1000.0:
        return float(max(stats.norm.isf(0.5 * stats.chi2.sf(max(gain, 0.0), size)), 0.0))
    half = 0.5 * size
    unlikely = (half - 1.0) * np.log(0.5 * gain) - 0.5 * gain - special.gammaln(half)  # the distribution's tail
    return float(np.sqrt(-2.0 * unlikely - np.log(-np.pi * unlikely)))  # and the normal one's


def passes_cross_validation(scene: SelectionProblem, taken: list[str], key: str) -> bool:
    """Return whether an effect that joins those taken explains what its fit has not seen, in at least two blocks."""
    unseen = cross_validation_gains(scene, taken, key)
    if len(unseen) < 2:
        return False
    return bool(unseen.mean() > LEAST_ERRORS * unseen.std(ddof=1) / np.sqrt(len(unseen)))


def cross_validation_gains(scene: SelectionProblem, taken: list[str], key: str) -> np.ndarray:
    """Return by how much an effect lowers the squares of each block of the flight in which it can show, fitted on the
    others; a second on each side of a block is seen by neither. What the others hardly tell stays near nothing: a
    draught has one place."""
    sums, seconds, found = scene.sums, np.arange(len(scene.sums.samples)), []
    told = np.einsum("spp->sp", sums.matrix)
    whole, own = np.diag(told.sum(axis=0)), scene.rows([key])
    for block in np.array_split(seconds, min(BLOCKS, len(seconds))):
        if np.all(told[block][:, own].sum(axis=0) <= SHOWN * told[:, own].sum(axis=0)):
            continue
        seen = (seconds < block[0] - 1) | (seconds > block[-1] + 1)
        losses = []
        for keys in (taken, [*taken, key]):
            rows = scene.rows(keys)
            known = sums.matrix[seen].sum(axis=0)[np.ix_(rows, rows)] + UNTOLD * whole[np.ix_(rows, rows)]
            sizes = -solve(known, sums.products[seen].sum(axis=0)[rows])
            matrix = sums.matrix[block].sum(axis=0)[np.ix_(rows, rows)]
            losses.append(2 * sizes @ sums.products[block].sum(axis=0)[rows] + sizes @ matrix @ sizes)
        found.append(losses[0] - losses[1])
    return np.array(found)


def forward(scene: SelectionProblem, taken: list[str], excluded: Iterable[str] = ()) -> tuple[str | None, float]:
    """Return the effect that should join those taken, None where none passes, and its significance. If the best fails
    the next is tried."""
    excluded = set(excluded) | set(taken)
    base = scene.gain(taken)
    scores = {key: scene.score(key, scene.gain([*taken, key]) - base) for key in scene.slices if key not in excluded}
    for key in sorted(scores, key=scores.get, reverse=True):
        if scores[key] <= 0:
            break
        good, sigma = passes(scene, taken, key)
        if good:
            return key, sigma
    return None, 0.0


def better(
    scene: SelectionProblem, others: list[str], key: str, excluded: Iterable[str] = ()
) -> tuple[str | None, float]:
    """Return the effect that in the place of one taken explains clearly more beside the others, None where there is
    none, and how much more: what came first may have stood for what came later."""
    excluded = {*others, *excluded, key}
    found = {rival: _ahead(scene, others, rival, key) for rival in scene.slices if rival not in excluded}
    for rival in sorted(found, key=found.get, reverse=True):
        if found[rival] < CLEARLY:
            break
        if passes(scene, others, rival)[0]:
            return rival, found[rival]
    return None, 0.0


def simpler(
    scene: SelectionProblem, taken: list[str], excluded: Callable[[list[str]], set[str]]
) -> tuple[list[str], str | None]:
    """Return two effects taken and the one that explains as much in their place, none and None where none does: a
    propeller that lifts less also leans, as weight and balance do together. excluded: those that cannot stand beside
    some."""
    found, whole = [], scene.gain(taken)
    for pair in combinations(taken, 2):
        others = [key for key in taken if key not in pair]
        beside = scene.gain(others)
        for rival in set(scene.slices) - {*taken, *excluded(others)}:
            less = whole - scene.gain([*others, rival]) - INEXACT * (whole - beside)
            saved = sum(scene.cost(key) for key in pair) - scene.cost(rival)
            found.append(
                (saved - 0.5 * max(less, 0.0) / scene.null_distribution.variance_inflation(rival), list(pair), rival)
            )
    for worth, pair, rival in sorted(found, reverse=True):
        if worth < CLEARLY:
            break
        if passes(scene, [key for key in taken if key not in pair], rival)[0]:
            return pair, rival
    return [], None


def _ahead(scene: SelectionProblem, others: list[str], rival: str, key: str) -> float:
    """Return by what log-likelihood a rival explains more than an effect beside others, less what its further
    parameters cost. Where seconds differ on it by more than noise, it is worth less (Vuong): neither is the truth. Of a
    strong effect a small share may be the simulator's own error, and what the pipeline makes of a small difference is
    of the twins' vehicle, not of either rival's: it may be as much again."""
    apart = _apart(scene.sums, scene, others, rival, key)
    made = 0.0 if scene.whole is None else abs(np.sum(_apart(scene.whole, scene, others, rival, key) - apart))
    made = min(made, MADE_AT_MOST)
    scatter = np.var(apart) * np.count_nonzero(scene.sums.samples) / max(4.0 * abs(apart.sum()), 1e-300)
    copies = max(scatter, scene.null_distribution.variance_inflation(key))  # rivals for one gain: of the same noise
    explained = max(scene.gain([*others, rival]), scene.gain([*others, key])) - scene.gain(others)
    more = np.sign(apart.sum()) * max(abs(apart.sum()) - INEXACT * explained - made, 0.0)
    return 0.5 * more / copies - scene.cost(rival) + scene.cost(key)


def _apart(sums: NormalEquations, scene: SelectionProblem, others: list[str], rival: str, key: str) -> np.ndarray:
    """Return by how much more than an effect a rival lowers the squares of each second (s,) beside others."""
    return _lowered(sums, scene.rows([*others, rival])) - _lowered(sums, scene.rows([*others, key]))


def _lowered(sums: NormalEquations, rows) -> np.ndarray:
    """Return by how much the fit of the parameters `rows` lowers the squares of each second (s,)."""
    sizes = -solve(sums.matrix.sum(axis=0)[np.ix_(rows, rows)], sums.products.sum(axis=0)[rows])
    matrix = sums.matrix[:, rows][:, :, rows]
    return -2.0 * sums.products[:, rows] @ sizes - np.einsum("i,sij,j->s", sizes, matrix, sizes)


def without(sums: NormalEquations, rows, sizes) -> NormalEquations:
    """Return the sums as they would be with the parameters `rows` smaller by `sizes`, to first order."""
    turned = np.einsum("spk,k->sp", sums.matrix[:, :, rows], sizes)
    squares = sums.squares - 2 * sums.products[:, rows] @ sizes + turned[:, rows] @ sizes
    return replace(sums, squares=squares, products=sums.products - turned)


def backward(scene: SelectionProblem, taken: list[str]) -> list[str]:
    """Return those of the effects taken that the others do not make superfluous."""
    kept = list(taken)
    while len(kept) > 1:
        weak = [key for key in kept if not passes(scene, [other for other in kept if other != key], key)[0]]
        if not weak:
            break
        kept.remove(min(weak, key=lambda key: scene.score(key, scene.gain(kept) - scene.gain(set(kept) - {key}))))
    return kept


def find_confounders(
    scene: SelectionProblem, taken: list[str], key: str, excluded: Iterable[str] = ()
) -> dict[str, float]:
    """Return the effects that could stand in for one of those taken with their weights, itself included: those that
    lower the squares as much, would be taken in, and beside which the one taken would not."""
    others = [other for other in taken if other != key]
    base, best = scene.gain(others), scene.gain(taken)
    own, excluded = best - base, set(excluded) | set(taken)
    scores = {key: 0.0}
    for rival in (rival for rival in scene.slices if rival not in excluded):
        gain = scene.gain([*others, rival]) - base
        if own - gain > ALIKE_SHARE * own or gain < scene.null_distribution.threshold(rival):
            continue
        if passes(scene, others, rival)[0] and not passes(scene, [*others, rival], key)[0]:
            scores[rival] = _ahead(scene, others, rival, key)
    highest = max(scores.values())
    weights = {name: float(np.exp(score - highest)) for name, score in scores.items()}
    total = sum(weights.values())
    likely = {name: weight / total for name, weight in weights.items() if weight / total > LIKELY or name == key}
    return dict(sorted(likely.items(), key=lambda item: -item[1]))
