"""Evidence that a search for effects works on, and the result of the search."""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy import special

from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.discovery.equation_search import EquationTerm
from swift_sim_bridge.gap.discovery.feature_library import FeatureLibrary
from swift_sim_bridge.gap.inference import null_distribution
from swift_sim_bridge.gap.inference.marginal import Rival, mixture_quantile
from swift_sim_bridge.gap.inference.null_distribution import NullDistribution
from swift_sim_bridge.gap.inference.sensitivity import LinearisationCache
from swift_sim_bridge.gap.residuals.channels import Channel
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel

SIMULATOR_ERROR_SHARE = 0.002  # of a change: error of the simulation, which longer recordings do not lower


@dataclass(frozen=True)
class Evidence:
    """Recordings with their reference flights, and the hypotheses about them.

    Attributes:
        residual_models: residual model of each recording.
        null_distribution: null distribution of the reference flights, of all recordings together.
        noises: of each recording, (c,) noise of its residuals.
        sigmas: of each recording, (c,) the same, increased for correlated samples.
        noise_ratios: of each recording, (c,) by how much its sigmas are larger than those of its reference flights.
        effects: effects that the recordings can show.
        not_testable: reason why each other effect cannot be shown, by its id.
        library: features of the equation search.
        reference_difference_variance: of each recording, (c,) `null_distribution.difference_variance` of its reference
            flights.
        reference_squares: of each recording, (c,) the largest squares of a reference flight, in units of its sigma.
        reference_window_squares: the same of `null_distribution.window_squares`.
        rotor_noise_ratio: of each recording, variance of its rotors' noise relative to its reference flights', whose
            rotors may turn more slowly.
        local_wind_gains: (k,) gain of the best local wind in each reference flight; None if wind is not testable.
        reference_gust_significance: largest significance of gusts in a reference flight; infinite if not testable.
        local_sigma: (n, c) sigma of the first recording over time, see `wind.local_sigma`; None if not testable.
        other_minimum_detectable: minimum detectable changes of effects outside the linear search, by id and parameter.
        search_payload: whether a payload may be selected.
        start: effects with which the search starts, with their values, by key (see `far_start`).
        physics: ids of all effects of motors, forces and moments that the vehicle may have, testable or not.
        cache: linearisations of the recordings.
    """

    residual_models: tuple[ResidualModel, ...]
    null_distribution: NullDistribution
    noises: tuple[np.ndarray, ...]
    sigmas: tuple[np.ndarray, ...]
    noise_ratios: tuple[np.ndarray, ...]
    effects: tuple[Effect, ...]
    not_testable: dict[str, str]
    library: FeatureLibrary
    reference_difference_variance: tuple[np.ndarray, ...]
    reference_squares: tuple[np.ndarray, ...]
    reference_window_squares: tuple[np.ndarray, ...]
    rotor_noise_ratio: tuple[float, ...]
    local_wind_gains: np.ndarray | None = None
    reference_gust_significance: float = np.inf
    local_sigma: np.ndarray | None = None
    other_minimum_detectable: dict = field(default_factory=dict)
    search_payload: bool = True
    start: dict[str, np.ndarray] = field(default_factory=dict)
    physics: frozenset[str] = frozenset()
    cache: LinearisationCache = field(default_factory=LinearisationCache)

    @property
    def seconds(self) -> int:
        """The whole seconds of the recordings."""
        return sum(int(one.t[-1] - one.t[0]) for one in self.residual_models)

    def with_effect(self, effect: Effect, gains) -> "Evidence":
        """Return the evidence with one more effect.

        Args:
            effect: the effect.
            gains: (k,) its gain in each reference flight.
        """
        wider = null_distribution.with_effect(self.null_distribution, effect.key, len(effect.parameters), gains)
        return replace(self, effects=(*self.effects, effect), null_distribution=wider)


@dataclass(frozen=True)
class SelectedEffect:
    """An effect that the evidence calls for.

    Attributes:
        effect: the effect.
        values: (k,) estimated values of its parameters.
        covariance: (k, k) their covariance.
        significance: significance in standard deviations.
        confounders: relative likelihood of each effect that could replace it, by key, itself included.
        changes: by key, (k,) change that each of these would have in its parameters.
        is_certain: whether the effect is confirmed if it has no confounders.
        beside: explanations in which one more effect acts beside it.
    """

    effect: Effect
    values: np.ndarray
    covariance: np.ndarray
    significance: float
    confounders: dict[str, float] = field(default_factory=dict)
    changes: dict[str, np.ndarray] = field(default_factory=dict)
    is_certain: bool = True
    beside: tuple[Rival, ...] = ()

    @property
    def verdict(self) -> str:
        """Confirmed, tentative, or ambiguous if there are confounders."""
        if any(key != self.effect.key for key in self.confounders):
            return "ambiguous"
        return "confirmed" if self.is_certain else "tentative"

    @property
    def likeliest(self) -> str:
        """Key of the likeliest of its confounders, its own if there is none."""
        return max(self.confounders, key=self.confounders.__getitem__, default=self.effect.key)

    @property
    def rivals(self) -> tuple[Rival, ...]:
        """All other explanations than the effect alone: another one in its place, or beside it."""
        own = self.confounders.get(self.effect.key, 1.0)
        others = (weight for key, weight in self.confounders.items() if key != self.effect.key)
        absent = (Rival(weight / own, -self.changes[self.effect.key], np.zeros(len(self.values))) for weight in others)
        return (*absent, *self.beside)

    def interval95(self, seconds: int) -> np.ndarray:
        """Return the 95 % interval (2, k) of its parameters over all explanations, from `seconds` s of recordings.

        It ends at the physical bounds of the parameters. The value that is reported lies in it, however unlikely the
        effect is beside another one in its place.
        """
        rivals = self.rivals
        weights = np.array([1.0, *(one.weight for one in rivals)])
        means = self.values + np.array([np.zeros(len(self.values)), *(one.shift for one in rivals)])
        own = np.sqrt(np.diag(self.covariance) + self._simulator_errors() ** 2)
        errors = np.array([own, *(one.errors for one in rivals)])
        errors = errors * special.stdtrit(max(seconds - 1, 1), 0.975) / special.ndtri(0.975)
        low, high = (mixture_quantile(share, weights / weights.sum(), means, errors) for share in (0.025, 0.975))
        ends = np.minimum(low, self.values), np.maximum(high, self.values)
        return np.clip(ends, *np.array([(one.low, one.high) for one in self.effect.parameters]).T)

    def _simulator_errors(self) -> np.ndarray:
        """Return the standard error (k,) that a strong effect has by the simulation alone: of its largest change.

        Parameters of one unit share it: of four gains of rotors one may not change.
        """
        change = np.abs(self.changes.get(self.effect.key, np.zeros(len(self.values))))
        units = np.array([one.unit for one in self.effect.parameters])
        return SIMULATOR_ERROR_SHARE * np.array([change[units == unit].max() for unit in units])

    def excludes_file(self, seconds: int) -> np.ndarray:
        """Return for each parameter (k,) whether its 95 % interval excludes the value of the vehicle file."""
        file, (low, high) = self.values - self.changes[self.effect.key], self.interval95(seconds)
        return (file < low) | (file > high)

    def fitted_again(self, values: np.ndarray, covariance: np.ndarray) -> "SelectedEffect":
        """Return the effect with other values (k,) of its parameters and their covariance (k, k)."""
        key, more = self.effect.key, values - self.values
        changes = {other: change + more if other == key else change for other, change in self.changes.items()}
        return replace(self, values=values, covariance=covariance, changes=changes)

    def without_confounders(self, keys) -> "SelectedEffect":
        """Return the effect without some of its confounders, given by key."""
        kept = {key: weight for key, weight in self.confounders.items() if key not in keys}
        return replace(self, confounders={key: weight / sum(kept.values()) for key, weight in kept.items()})


@dataclass(frozen=True)
class Unexplained:
    """The residual of one channel that neither effects nor an equation explain.

    Attributes:
        channel: the channel.
        share: share of the channel's squared error, by the vehicle file, that is unexplained.
        significance: significance in standard deviations.
        quantity: name of the quantity over which the residual follows a curve; empty if there is none.
    """

    channel: Channel
    share: float
    significance: float
    quantity: str


@dataclass(frozen=True)
class SearchResult:
    """The result of a search.

    Attributes:
        selected: the selected effects, by decreasing significance.
        equation_terms: terms of the equation that describes what they leave unexplained.
        evidence: the evidence after the search, with its local wind and payload hypotheses and its library.
        withdrawn: effects that the evidence calls for, but of which an equation explains more.
        unexplained: channels whose residual neither effects nor equation explain.
    """

    selected: tuple[SelectedEffect, ...] = ()
    equation_terms: tuple[EquationTerm, ...] = ()
    evidence: Evidence | None = None
    withdrawn: tuple[SelectedEffect, ...] = ()
    unexplained: tuple[Unexplained, ...] = ()
