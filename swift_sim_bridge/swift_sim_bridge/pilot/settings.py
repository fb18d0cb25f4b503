"""The settings of the policy's training, and their schedules."""

import dataclasses
import math
from typing import NamedTuple

import jax.numpy as jnp

from swift_ros.configuration import refuse_outside, within
from swift_ros.text import described, excerpt
from swift_sim_bridge.pilot.episodes import rewards
from swift_sim_bridge.pilot.episodes.randomization import EstimateErrors
from swift_sim_bridge.pilot.episodes.world import EnvironmentSettings

ALGORITHMS = ("ppo", "backpropagation")


@dataclasses.dataclass(frozen=True)
class FineTuning:
    """Section `policy.fine_tuning` of config/training.yaml: a training that begins with the networks of another.

    Attributes:
        interactions: length of the training.
        critic_first: of them, interactions at the beginning in which only the critic learns. The pilot of an ONNX file
            has none, and that of another track or vehicle has a wrong one, by which the pilot would be destroyed.
        schedule_share: where on the schedules it begins, 0..1.
    """

    interactions: int = within(1)
    critic_first: int = within(0)
    schedule_share: float = within(0.0, 1.0)

    def __post_init__(self):
        if self.critic_first >= self.interactions:
            raise ValueError(
                f"'critic_first' {described(self.critic_first)} must be less than 'interactions' "
                f"{described(self.interactions)}, of which it is a part; give less, or more 'interactions'"
            )


@dataclasses.dataclass(frozen=True)
class PpoSettings:
    """Section `policy.ppo` of config/training.yaml: what proximal policy optimisation alone reads.

    Attributes:
        minibatch: interactions in one gradient step; divides agents x steps.
        epochs: passes over the interactions of one update.
        clip: largest relative change of an action's probability that is rewarded.
        discount: of rewards, a tick.
        gae: lambda of the generalised advantages, a schedule.
        sigma: standard deviation of the exploration, in units of the action, a schedule.
        kl_target: divergence of one update above which the learning rate falls and below which it rises.
        reward_scale: factor on all rewards.
    """

    minibatch: int = within(1)
    epochs: int = within(1, 1000)
    clip: float = within(0.001, 1.0)
    discount: float = within(0.0, 0.99999)
    gae: tuple[float, float] = within(0.0, 1.0)
    sigma: tuple[float, float] = within(0.001, 10.0)
    kl_target: float = within(1e-6, 10.0)
    reward_scale: float = within(1e-6)


@dataclasses.dataclass(frozen=True)
class PolicySettings:
    """Section `policy` of config/training.yaml.

    An interaction is one control tick of one agent. A pair is a schedule: the value at the first and at the last
    interaction.

    Attributes:
        rewards: scale of each term of `rewards.TERMS`.
        algorithm: "ppo", or "backpropagation" for a pilot that flies already (`backpropagation`). That flies `agents`
            races of `steps` ticks an update, and its learning rate is that of the schedule.
        ppo: see `PpoSettings`; None with another algorithm.
        environment: see `EnvironmentSettings`.
        estimate_errors: see `EstimateErrors`.
        fine_tuning: see `FineTuning`.
        interactions: length of the training.
        agents: races that are flown side by side.
        steps: ticks of every agent between two updates.
        guide_reach_m: distance from the guide at which an episode ends as a crash.
        learning_rate: upper bound; the actual rate follows the Kullback-Leibler divergence of the updates.
        gradient_norm: gradients are clipped to this norm.
        difficulty_from, difficulty_full: shares of the schedules at which randomisation begins and is complete; where
            the first is 1 it never begins.
        trial_every: interactions between two trials.
        trial_races, final_races: races of a trial, and of the last one of the best pilot.
    """

    rewards: dict[str, tuple[float, float]]
    environment: EnvironmentSettings
    estimate_errors: EstimateErrors
    fine_tuning: FineTuning
    algorithm: str
    interactions: int = within(1)
    agents: int = within(1, 1_000_000)
    steps: int = within(1, 100_000)
    guide_reach_m: tuple[float, float] = within(0.1, 1000.0)
    learning_rate: tuple[float, float] = within(1e-8, 1.0)
    gradient_norm: float = within(1e-6)
    difficulty_from: float = within(0.0, 1.0)
    difficulty_full: float = within(0.0, 100.0)
    trial_every: int = within(1)
    trial_races: int = within(1, 100_000)
    final_races: int = within(1, 1_000_000)
    ppo: PpoSettings | None = None

    def __post_init__(self):
        refuse_outside(ALGORITHMS, algorithm=self.algorithm)
        if self.algorithm == "ppo" and self.ppo is None:
            raise ValueError("algorithm 'ppo' lacks its section 'ppo'; take that of the shipped training.yaml")
        if self.algorithm != "ppo" and self.ppo is not None:
            raise ValueError(f"algorithm '{self.algorithm}' does not read the section 'ppo'; remove it")
        undefined = set(self.rewards) - set(rewards.TERMS)
        if undefined:
            raise ValueError(f"unknown reward '{min(undefined)}'; known are {', '.join(rewards.TERMS)}")
        for name, scales in self.rewards.items():
            if min(scales) < 0:
                raise ValueError(f"'rewards.{excerpt(name)}' must be 0 or more: costs have their sign already")
        if not any(any(scales) for scales in self.rewards.values()):
            raise ValueError("'rewards' are all 0, so nothing is learned; give scales above 0")
        if self.batch % self.minibatch:
            raise ValueError(
                f"'ppo.minibatch' {described(self.minibatch)} must divide agents x steps, {self.agents} x {self.steps} "
                f"= {self.batch}; give {largest_divisor(self.batch, self.minibatch)}, or another divisor"
            )
        if not self.difficulty_from < self.difficulty_full:
            cure = "give a larger one" if self.difficulty_from == self.difficulty_full else "exchange them"
            raise ValueError(
                f"'difficulty_from' {self.difficulty_from:g} must be below 'difficulty_full' "
                f"{self.difficulty_full:g}, both shares of the training; {cure}"
            )

    @property
    def batch(self) -> int:
        """Interactions of one update."""
        return self.agents * self.steps

    @property
    def minibatch(self) -> int:
        """Interactions in one gradient step."""
        return self.ppo.minibatch if self.ppo else self.batch


def largest_divisor(number: int, limit: int | None) -> int:
    """Return the largest divisor of a number that is not above a limit, if there is one."""
    limit = limit or number
    small = [k for k in range(1, math.isqrt(number) + 1) if number % k == 0]
    return max(k for k in (*small, *(number // k for k in small)) if k <= limit)


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

    learning_rate_cap: jnp.ndarray
    difficulty: jnp.ndarray
    rewards: dict
    guide_reach_m: jnp.ndarray


def schedule_at(settings: PolicySettings, plan: Plan, updates) -> Schedule:
    """Return the schedule after `updates` updates.

    Learning rate and the guide's reach change geometrically, the rest linearly.
    """
    share = share_at(settings, plan, updates)
    ramp = (share - settings.difficulty_from) / (settings.difficulty_full - settings.difficulty_from)
    return Schedule(
        geometric(settings.learning_rate, share),
        jnp.clip(ramp, 0.0, 1.0),
        {name: linear(pair, share) for name, pair in settings.rewards.items()},
        geometric(settings.guide_reach_m, share),
    )


def share_at(settings: PolicySettings, plan: Plan, updates) -> jnp.ndarray:
    """Return the place on the schedules after `updates` updates, 0 to 1."""
    return jnp.clip(plan.place(updates * float(settings.batch)) / plan.schedule, 0.0, 1.0)


def linear(pair: tuple[float, float], share) -> jnp.ndarray:
    """Return the value between two of a schedule that changes by the same amount everywhere."""
    return pair[0] + share * (pair[1] - pair[0])


def geometric(pair: tuple[float, float], share) -> jnp.ndarray:
    """Return the value between two of a schedule that changes by the same factor everywhere."""
    return pair[0] * (pair[1] / pair[0]) ** share
