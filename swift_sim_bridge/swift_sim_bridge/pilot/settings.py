"""The settings of the policy's training, and their schedules."""

import dataclasses
from typing import NamedTuple

import jax.numpy as jnp

from swift_sim_bridge.pilot import rewards
from swift_sim_bridge.pilot.world import EnvironmentSettings


@dataclasses.dataclass(frozen=True)
class FineTuning:
    """Section `policy.fine_tuning` of config/training.yaml: a training that begins with the networks of another.

    Attributes:
        interactions: length of the training.
        critic_first: of them, interactions at the beginning in which only the critic learns. The pilot of an ONNX file
            has none, and that of another track or vehicle has a wrong one, by which the pilot would be destroyed.
        schedule_share: where on the schedules it begins, 0..1.
    """

    interactions: int
    critic_first: int
    schedule_share: float

    def __post_init__(self):
        if not 0 <= self.schedule_share <= 1:
            raise ValueError("'fine_tuning.schedule_share' must lie in 0..1")


@dataclasses.dataclass(frozen=True)
class PolicySettings:
    """Section `policy` of config/training.yaml.

    An interaction is one control tick of one agent. A pair is a schedule: the value at the first and at the last
    interaction.

    Attributes:
        interactions: length of the training.
        agents: races that are flown side by side.
        steps: ticks of every agent between two updates.
        minibatch: interactions in one gradient step; divides agents x steps.
        epochs: passes over the interactions of one update.
        clip: largest relative change of an action's probability that is rewarded.
        discount: of rewards, a tick.
        gae: lambda of the generalised advantages.
        sigma: standard deviation of the exploration, in units of the action.
        learning_rate: upper bound; the actual rate follows the Kullback-Leibler divergence of the updates.
        kl_target: divergence of one update above which the learning rate falls and below which it rises.
        gradient_norm: gradients are clipped to this norm.
        reward_scale: factor on all rewards.
        difficulty_from, difficulty_full: shares of the schedules at which randomisation begins and is complete.
        trial_every: interactions between two trials.
        trial_races, final_races: races of a trial, and of the last one of the best pilot.
        rewards: scale of each term of `rewards.TERMS`.
        environment: see `EnvironmentSettings`.
        fine_tuning: see `FineTuning`.
    """

    interactions: int
    agents: int
    steps: int
    minibatch: int
    epochs: int
    clip: float
    discount: float
    gae: tuple[float, float]
    sigma: tuple[float, float]
    learning_rate: tuple[float, float]
    kl_target: float
    gradient_norm: float
    reward_scale: float
    difficulty_from: float
    difficulty_full: float
    trial_every: int
    trial_races: int
    final_races: int
    rewards: dict[str, tuple[float, float]]
    environment: EnvironmentSettings
    fine_tuning: FineTuning

    def __post_init__(self):
        undefined = set(self.rewards) - set(rewards.TERMS)
        if undefined:
            raise ValueError(f"unknown reward '{min(undefined)}'; known are {', '.join(rewards.TERMS)}")
        if self.batch % self.minibatch:
            raise ValueError("'minibatch' must divide agents x steps")
        if not 0 <= self.difficulty_from <= self.difficulty_full <= 1:
            raise ValueError(
                "'difficulty_from' and 'difficulty_full' are shares of the training, 0..1, the first smaller"
            )

    @property
    def batch(self) -> int:
        """Interactions of one update."""
        return self.agents * self.steps


@dataclasses.dataclass(frozen=True)
class Plan:
    """Where a training begins on its schedules, and how long they are.

    Attributes:
        schedule: length, interactions. A training that is prolonged goes on with the values at the end.
        critic_first: interactions in which only the critic learns; the place on the schedules stays meanwhile.
        first_share: of the schedules, at which the training begins.
    """

    schedule: int
    critic_first: int = 0
    first_share: float = 0.0

    def __post_init__(self):
        if self.schedule <= self.critic_first:
            raise ValueError(
                f"{self.schedule} interactions leave none after the {self.critic_first} of 'fine_tuning.critic_first', "
                "in which only the critic learns"
            )

    def place(self, interactions):
        """Return the place on the schedules, 0 to `schedule`, after a number of interactions."""
        first = self.first_share * self.schedule
        slope = (self.schedule - first) / (self.schedule - self.critic_first)
        return first + slope * jnp.maximum(interactions - self.critic_first, 0.0)


class Schedule(NamedTuple):
    """The scheduled values of one update; names as in `PolicySettings`."""

    sigma: jnp.ndarray
    gae: jnp.ndarray
    learning_rate_cap: jnp.ndarray
    difficulty: jnp.ndarray
    rewards: dict


def schedule_at(settings: PolicySettings, plan: Plan, updates) -> Schedule:
    """Return the schedule after `updates` updates: sigma and learning rate change geometrically, the rest linearly."""
    place = plan.place(updates * float(settings.batch))
    share = jnp.clip(place / plan.schedule, 0.0, 1.0)

    def linear(pair):
        return pair[0] + share * (pair[1] - pair[0])

    def geometric(pair):
        return pair[0] * (pair[1] / pair[0]) ** share

    begin, full = (float(at * plan.schedule) for at in (settings.difficulty_from, settings.difficulty_full))
    ramp = (place - begin) / max(full - begin, 1.0)
    return Schedule(
        geometric(settings.sigma),
        linear(settings.gae),
        geometric(settings.learning_rate),
        jnp.clip(ramp, 0.0, 1.0),
        {name: linear(pair) for name, pair in settings.rewards.items()},
    )
