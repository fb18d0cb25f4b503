"""What a search works on, and what it takes in."""

from dataclasses import dataclass, field, replace

import numpy as np

from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.discovery.equation_search import EquationTerm, FeatureLibrary
from swift_sim_bridge.gap.inference.null_distribution import NullDistribution, with_effect
from swift_sim_bridge.gap.inference.sensitivity import LinearisationCache
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel


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

    residual_models: tuple[ResidualModel, ...]
    null_distribution: NullDistribution
    noises: tuple[np.ndarray, ...]
    sigmas: tuple[np.ndarray, ...]
    effects: tuple[Effect, ...]
    not_testable: dict[str, str]
    library: FeatureLibrary
    reference_difference_variance: tuple[np.ndarray, ...]
    rotor_noise_ratio: tuple[float, ...]
    local_wind_gains: np.ndarray | None = None
    reference_gust_significance: float = np.inf
    local_sigma: np.ndarray | None = None
    other_minimum_detectable: dict = field(default_factory=dict)
    search_payload: bool = True
    cache: LinearisationCache = field(default_factory=LinearisationCache)

    def widened(self, effect: Effect, gains) -> "Evidence":
        """Return the evidence with an effect that is sought at a place, by which each twin gains so much (k,)."""
        wider = with_effect(self.null_distribution, effect.key, len(effect.parameters), gains)
        return replace(self, effects=(*self.effects, effect), null_distribution=wider)


@dataclass(frozen=True)
class SelectedEffect:
    """An effect that was taken in: its parameters (k,), their covariance (k, k), significance in standard deviations,
    all that could stand in for it with their weights, itself included, and what each of them would change (k,); sure:
    no doubt is left beside these."""

    effect: Effect
    values: np.ndarray
    covariance: np.ndarray
    significance: float
    confounders: dict[str, float] = field(default_factory=dict)
    changes: dict[str, np.ndarray] = field(default_factory=dict)
    is_certain: bool = True

    @property
    def verdict(self) -> str:
        """How far the effect's name is to be trusted: confirmed, tentative, or ambiguous where others could be it."""
        if any(key != self.effect.key for key in self.confounders):
            return "ambiguous"
        return "confirmed" if self.is_certain else "tentative"


@dataclass(frozen=True)
class SearchResult:
    """What the recordings call for: effects that were taken in, and what is left beside them, as terms of a library.
    evidence: what was searched at last, with that library, and a draught among its effects where one was tried."""

    selected: tuple[SelectedEffect, ...] = ()
    equation_terms: tuple[EquationTerm, ...] = ()
    evidence: Evidence | None = None
