"""Proximal policy optimisation of the pilot's policy.

An update flies `steps` ticks with all agents, computes generalised advantages, and descends on shuffled minibatches.
Each device (see `parallel`) flies a share of the agents; all descend on the mean of their gradients. `compiled` drives
it.
PPO: Schulman et al. 2017; generalised advantages: Schulman et al. 2016.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from swift_ros.policy.observation import SIZE as OBSERVATION_SIZE
from swift_sim_bridge.parallel import DEVICES
from swift_sim_bridge.pilot import networks
from swift_sim_bridge.pilot.episodes import environment, randomization, starts
from swift_sim_bridge.pilot.episodes.randomization import TICK
from swift_sim_bridge.pilot.learner import MIN_LEARNING_RATE, Training, make_optimizer, mean_over_devices
from swift_sim_bridge.pilot.settings import (
    Plan,
    PolicySettings,
    PpoSettings,
    geometric,
    largest_divisor,
    linear,
    schedule_at,
    share_at,
)

BLOCK = 128  # rows whose activations stay in the cache of a core: gradients of more rows at once take longer there


class Batch(NamedTuple):
    """One rollout buffer, all with leading (steps, agents).

    Attributes:
        observation: of the critic, with the truth; the first entries are that of the policy.
        unclipped_action: mean of the policy plus exploration noise.
        noise: standard normal, the exploration in units of sigma.
        value: the critic's, before the tick.
        outcome: what the tick ended in; the terms of its reward are means over the agents, (steps,).
    """

    observation: jnp.ndarray
    unclipped_action: jnp.ndarray
    noise: jnp.ndarray
    value: jnp.ndarray
    outcome: environment.Outcome


class Rows(NamedTuple):
    """What the loss reads, with leading (n,): of a batch or a part of it; see `Batch`.

    Attributes:
        observation, unclipped_action, noise: as in the batch.
        advantage: normalised in each minibatch.
        target: of the critic.
    """

    observation: jnp.ndarray
    unclipped_action: jnp.ndarray
    noise: jnp.ndarray
    advantage: jnp.ndarray
    target: jnp.ndarray


def own_settings(settings: PolicySettings) -> PpoSettings:
    """Return the section that this algorithm alone reads. Raises ValueError on settings of another one."""
    if settings.ppo is None:
        raise ValueError(f"settings of '{settings.algorithm}' have no section 'ppo'")
    return settings.ppo


def exploration_at(settings: PolicySettings, plan: Plan, updates):
    """Return the standard deviation of the exploration after some updates."""
    return geometric(own_settings(settings).sigma, share_at(settings, plan, updates))


def roll_out(world, settings: PolicySettings, plan: Plan, training: Training, key):
    """Fly `steps` ticks with the device's agents under the exploring policy; return (agents, bank, batch).

    Finished episodes are reset. `key` is the same on all devices, and the bank too. All random numbers are drawn at
    once, and starts for the few episodes that end: drawing them in each tick takes longer than flying.
    """
    schedule = schedule_at(settings, plan, training.updates)
    sigma = exploration_at(settings, plan, training.updates)
    actor, critic = training.networks["actor"], training.networks["critic"]
    n, steps = training.agents.age.shape[0], settings.steps
    bank_key, own_key = jax.random.split(key)
    own_key = jax.random.fold_in(own_key, jax.lax.axis_index(DEVICES))
    noise_key, innovation_key, start_key = jax.random.split(own_key, 3)
    noise = jax.random.normal(noise_key, (steps, n, 4))
    innovations = jax.random.normal(innovation_key, (steps, n, randomization.ERRORS))
    share = settings.environment.podium_share
    conditions = environment.Conditions(schedule.difficulty, share)
    pool = environment.reset(world, training.bank, start_key, n + steps, conditions)

    def tick(carry, row):
        agents, earned = carry
        number, noise, innovation = row
        policy_observation, observation = environment.observations(world, agents)
        unclipped = networks.apply(actor, policy_observation) + sigma * noise
        value = networks.apply(critic, observation)[:, 0]
        action = jnp.clip(unclipped, -1.0, 1.0)
        moved, outcome = environment.step(world, agents, action, innovation, schedule.rewards, schedule.guide_reach_m)
        moved, earned = environment.commit(world, moved, earned, agents.gate, outcome.passed)
        # Another part of the pool in each tick: an agent that crashes again does not start again in the same state.
        fresh = jax.tree.map(lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, number, n), pool)
        agents = starts.choose(outcome.done | outcome.timeout, fresh, moved)
        outcome = outcome._replace(terms=jax.tree.map(jnp.mean, outcome.terms))
        return (agents, earned), Batch(observation, unclipped, noise, value, outcome)

    carry = (training.agents, starts.nothing_earned(training.bank, n))
    (agents, earned), batch = jax.lax.scan(tick, carry, (jnp.arange(steps), noise, innovations))
    earned = jax.tree.map(lambda rows: jax.lax.all_gather(rows, DEVICES, tiled=True), earned)
    return agents, starts.store(training.bank, earned, bank_key, settings.environment.bank_fixed), batch


def advantages(settings: PpoSettings, outcome: environment.Outcome, values, last_value, gae):
    """Return the generalised advantages (steps, agents).

    An episode that only ran out of time is continued by the value of its last observation.

    Args:
        settings: reward scale and discount.
        outcome: of the rollout, leading (steps, agents).
        values: (steps, agents), the critic's values before each tick.
        last_value: (agents,), the value after the last tick.
        gae: lambda, the share of the next tick's advantage that counts.
    """
    ended = outcome.done | outcome.timeout
    reward = settings.reward_scale * outcome.reward + settings.discount * values * outcome.timeout

    def back(carry, row):
        advantage, next_value = carry
        reward, value, ended = row
        discount = settings.discount * (1.0 - ended)
        advantage = reward + discount * next_value - value + discount * gae * advantage
        return (advantage, value), advantage

    _, result = jax.lax.scan(back, (jnp.zeros_like(last_value), last_value), (reward, values, ended), reverse=True)
    return result


def loss(parameters, rows: Rows, sigma, clip: float):
    """Return (loss, estimate of the Kullback-Leibler divergence) of PPO on rows of a batch.

    Args:
        parameters: {"actor", "critic"}.
        rows: of the batch.
        sigma: standard deviation of the exploration.
        clip: see `PpoSettings`.
    """
    mean = networks.apply(parameters["actor"], rows.observation[:, :OBSERVATION_SIZE])
    log_ratio = 0.5 * jnp.sum(rows.noise**2 - ((rows.unclipped_action - mean) / sigma) ** 2, axis=-1)
    ratio = jnp.exp(log_ratio)
    gain = jnp.minimum(ratio * rows.advantage, jnp.clip(ratio, 1 - clip, 1 + clip) * rows.advantage)
    value = networks.apply(parameters["critic"], rows.observation)[:, 0]
    return jnp.mean(0.5 * (value - rows.target) ** 2 - gain), jnp.mean(ratio - 1.0 - log_ratio)


def descend(settings: PolicySettings, training: Training, rows: Rows, sigma, learning_rates: dict, key):
    """Take `epochs` passes over shuffled minibatches; return (networks, optimizer state, divergence of the last).

    What is shuffled are blocks of rows in the order of the batch: some agents in the same tick. A minibatch takes its
    blocks one by one, and their gradients are added.

    Args:
        settings: of the training.
        training: before.
        rows: of the batch.
        sigma: standard deviation of the exploration.
        learning_rates: of "actor" and "critic".
        key: of the order.
    """
    own, optimizer = own_settings(settings), make_optimizer(settings)
    minibatches = settings.batch // own.minibatch
    size = largest_divisor(rows.target.shape[0] // minibatches, BLOCK if jax.default_backend() == "cpu" else None)
    blocks = jax.tree.map(lambda row: jnp.reshape(row, (-1, size, *row.shape[1:])), rows)

    def minibatch(carry, chosen):
        parameters, state = carry
        advantage = blocks.advantage[chosen]
        mean = mean_over_devices(jnp.mean(advantage))
        deviation = jnp.sqrt(mean_over_devices(jnp.mean((advantage - mean) ** 2))) + 1e-8

        def add(total, number):
            block = jax.tree.map(lambda row: jax.lax.dynamic_index_in_dim(row, number, keepdims=False), blocks)
            block = block._replace(advantage=(block.advantage - mean) / deviation)
            gradient, divergence = jax.grad(loss, has_aux=True)(parameters, block, sigma, own.clip)
            return jax.tree.map(jnp.add, total, gradient), divergence

        gradient, divergence = jax.lax.scan(add, jax.tree.map(jnp.zeros_like, parameters), chosen)
        gradient = mean_over_devices(jax.tree.map(lambda total: total / chosen.size, gradient))
        step, state = optimizer.update(gradient, state)
        rates = {
            name: jax.tree.map(lambda _, rate=rate: rate, parameters[name]) for name, rate in learning_rates.items()
        }
        parameters = jax.tree.map(lambda p, s, rate: p - rate * s, parameters, step, rates)
        return (parameters, state), jnp.mean(divergence)

    def epoch(carry, key):
        order = jax.random.permutation(key, blocks.target.shape[0]).reshape(minibatches, -1)
        return jax.lax.scan(minibatch, carry, order)

    carry = (training.networks, training.optimizer)
    (parameters, state), divergence = jax.lax.scan(epoch, carry, jax.random.split(key, own.epochs))
    return parameters, state, mean_over_devices(jnp.mean(divergence[-1]))


def update(world, settings: PolicySettings, plan: Plan, training: Training):
    """Return (training after one update, its figures by name)."""
    key, fly_key, learn_key = jax.random.split(training.key, 3)
    schedule, share = schedule_at(settings, plan, training.updates), share_at(settings, plan, training.updates)
    own, sigma = own_settings(settings), exploration_at(settings, plan, training.updates)
    agents, bank, batch = roll_out(world, settings, plan, training, fly_key)
    _, last_observation = environment.observations(world, agents)
    last_value = networks.apply(training.networks["critic"], last_observation)[..., 0]
    advantage = advantages(own, batch.outcome, batch.value, last_value, linear(own.gae, share))
    target = advantage + batch.value
    rows = Rows(batch.observation, batch.unclipped_action, batch.noise, advantage, target)
    rows = jax.tree.map(lambda row: jnp.reshape(row, (-1, *row.shape[2:])), rows)
    learning_rate = jnp.minimum(training.learning_rate, schedule.learning_rate_cap)
    rates = {"actor": learning_rate, "critic": learning_rate}
    if plan.critic_first:
        critic_only = training.updates * settings.batch < plan.critic_first
        # A critic that is still poor misleads the actor: it learns as fast as the schedule permits, and at first, while
        # the actor does not change, as fast as a new one.
        rates["actor"] = jnp.where(critic_only, 0.0, learning_rate)
        rates["critic"] = jnp.where(critic_only, settings.learning_rate[0], schedule.learning_rate_cap)
    parameters, state, divergence = descend(settings, training, rows, sigma, rates, learn_key)
    relative = divergence / own.kl_target
    factor = jnp.where(relative > 1.5, 1 / 1.2, jnp.where(relative < 1 / 1.5, 1.2, 1.0))
    if plan.critic_first:
        factor = jnp.where(critic_only, 1.0, factor)
    learning_rate = jnp.maximum(factor * learning_rate, MIN_LEARNING_RATE)
    happened = batch.outcome
    events = {"crashes": happened.crashed, "misses": happened.missed, "passages": happened.passed}
    events |= {"reward": happened.reward} | {f"{name}_reward": term for name, term in happened.terms.items()}
    figures = {f"{name}_per_s": mean_over_devices(jnp.mean(each) / TICK) for name, each in events.items()} | {
        "kl": divergence,
        "learning_rate": learning_rate,
        "sigma": sigma,
        "difficulty": schedule.difficulty,
        "explained": mean_over_devices(1 - jnp.var(advantage) / jnp.var(target)),
    }
    return Training(
        networks=parameters,
        optimizer=state,
        agents=agents,
        bank=bank,
        key=key,
        updates=training.updates + 1,
        learning_rate=learning_rate,
    ), figures
