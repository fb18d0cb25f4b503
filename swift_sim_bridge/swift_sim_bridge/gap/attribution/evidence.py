"""What a search works on, and what it takes in."""

from dataclasses import dataclass, field, replace

import numpy as np

from swift_sim_bridge.gap.discovery.equation_search import Library, Term
from swift_sim_bridge.gap.effects.spec import Effect
from swift_sim_bridge.gap.inference.null_distribution import Nulls, extended
from swift_sim_bridge.gap.inference.sensitivity import Memory
from swift_sim_bridge.gap.residuals.replayer import Replayer


@dataclass(frozen=True)
class Evidence:
    """Replayers of the recordings, the null population, noise and sigma (c,) of each recording's residuals, the effects
    that can be told, why the others cannot, and the features by which what has no name may go. unrest (c,) of each
    recording's twins: see `nulls.unrest`; louder: how many times as much variance each recording's rotors' noise
    makes, as they turn faster than its twins' do. Air (none where nothing tells the wind): draughts (k,), by how much
    a draught at any place lowers the squares of each of k twins; gusts: how far the winds of their half seconds agree,
    in standard deviations; rough: see `air.scatter`, of the first recording; least_others: the smallest sizes of these,
    and of effects that are kept out of the search, that could be told, as `minimum_detectable` has them; payloads:
    whether one may be named; memory: of what was replayed."""

    replayers: tuple[Replayer, ...]
    nulls: Nulls
    noises: tuple[np.ndarray, ...]
    sigmas: tuple[np.ndarray, ...]
    effects: tuple[Effect, ...]
    untold: dict[str, str]
    library: Library
    unrest: tuple[np.ndarray, ...]
    louder: tuple[float, ...]
    draughts: np.ndarray | None = None
    gusts: float = np.inf
    rough: np.ndarray | None = None
    least_others: dict = field(default_factory=dict)
    payloads: bool = True
    memory: Memory = field(default_factory=Memory)

    def widened(self, effect: Effect, gains) -> "Evidence":
        """Return the evidence with an effect that is sought at a place, by which each twin gains so much (k,)."""
        wider = extended(self.nulls, effect.key, len(effect.parameters), gains)
        return replace(self, effects=(*self.effects, effect), nulls=wider)


@dataclass(frozen=True)
class Taken:
    """An effect that was taken in: its parameters (k,), their covariance (k, k), significance in standard deviations,
    all that could stand in for it with their weights, itself included, and what each of them would change (k,); sure:
    no doubt is left beside these."""

    effect: Effect
    values: np.ndarray
    covariance: np.ndarray
    sigma: float
    alike: dict[str, float] = field(default_factory=dict)
    changes: dict[str, np.ndarray] = field(default_factory=dict)
    sure: bool = True

    @property
    def verdict(self) -> str:
        """How far the effect's name is to be trusted: confirmed, tentative, or ambiguous where others could be it."""
        if any(key != self.effect.key for key in self.alike):
            return "ambiguous"
        return "confirmed" if self.sure else "tentative"


@dataclass(frozen=True)
class Found:
    """What the recordings call for: effects that were taken in, and what is left beside them, as terms of a library.
    evidence: what was searched at last, with that library, and a draught among its effects where one was tried."""

    taken: tuple[Taken, ...] = ()
    unknown: tuple[Term, ...] = ()
    evidence: Evidence | None = None
