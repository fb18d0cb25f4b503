"""Descent on the gradient of whole races, through the simulator and back in time.

The simulated race is a differentiable function of the policy's weights. Its exact gradient needs no exploration and no
critic: 25 updates of 24 races make a trained pilot faster than a hundred million explored ticks do. It has no share in
what happens at a threshold: a hull that touches a frame, a gate that is missed. The pilot must therefore fly already,
and the reward must price the way to frames and ground (`rewards.risk`).

`compiled` drives it. Analytic policy gradients: Freeman et al. 2021 (Brax).
"""

import jax
import jax.numpy as jnp
import optax

from swift_sim_bridge.parallel import DEVICES
from swift_sim_bridge.pilot import networks
from swift_sim_bridge.pilot.episodes import environment, randomization, starts
from swift_sim_bridge.pilot.episodes.randomization import TICK
from swift_sim_bridge.pilot.learner import Training, make_optimizer, mean_over_devices
from swift_sim_bridge.pilot.settings import Plan, PolicySettings, Schedule, schedule_at

# Updates in which the learning rate rises to its schedule. Adam's first steps are as large as the rate in every weight,
# several times a later one: without this, a rate that later is good ended one of two trainings in its first updates.
WARM_UP = 20


def update(world, settings: PolicySettings, plan: Plan, training: Training) -> tuple[Training, dict]:
    """Return (training after one update, its figures by name)."""
    key, race_key = jax.random.split(training.key)
    race_key = jax.random.fold_in(race_key, jax.lax.axis_index(DEVICES))
    schedule = schedule_at(settings, plan, training.updates)
    races, actor = training.agents.age.shape[0], training.networks["actor"]
    slope, figures = jax.grad(cost, argnums=3, has_aux=True)(world, settings, schedule, actor, race_key, races)
    learning_rate = schedule.learning_rate_cap * jnp.minimum(1.0, (training.updates + 1.0) / WARM_UP)
    descended, of_descent = descend(settings, training, mean_over_devices(slope), learning_rate)
    figures = mean_over_devices(figures) | of_descent | {"difficulty": schedule.difficulty}
    return descended._replace(key=key, updates=training.updates + 1), figures


def descend(settings: PolicySettings, training: Training, slope, learning_rate) -> tuple[Training, dict]:
    """Take one step of Adam against the slope of the actor's weights; return (training, figures by name).

    A slope that is not finite changes nothing; the share of such steps is `lost_updates`.
    """
    norm = optax.tree.norm(slope)
    usable = jnp.isfinite(norm)
    slopes = {"actor": slope, "critic": jax.tree.map(jnp.zeros_like, training.networks["critic"])}
    step, optimizer = make_optimizer(settings).update(slopes, training.optimizer)
    moved = jax.tree.map(lambda weight, change: weight - learning_rate * change, training.networks, step)
    changed = training._replace(networks=moved, optimizer=optimizer)
    training = jax.tree.map(lambda new, old: jnp.where(usable, new, old), changed, training)
    figures = {"gradient_norm": jnp.where(usable, norm, 0.0), "lost_updates": 1.0 - usable}
    return training._replace(learning_rate=learning_rate), figures | {"learning_rate": learning_rate}


def cost(world, settings: PolicySettings, schedule: Schedule, actor, key, races: int):
    """Return (cost of `races` races, figures by name). Those that do not start on the podium start along the guide.

    The cost is the negative mean reward. A race goes on through what it touches, and ends where it misses a gate: what
    it did wrong has its price until there.
    """
    start_key, key = jax.random.split(key)
    innovations = jax.random.normal(key, (settings.steps, races, randomization.ERRORS))
    conditions = environment.Conditions(schedule.difficulty, settings.environment.podium_share)
    agents = environment.reset(world, starts.first_bank(world), start_key, races, conditions)

    def tick(carry, innovation):
        agents, flies, untouched = carry
        observation, _ = environment.observations(world, agents)
        action = jnp.clip(networks.apply(actor, observation), -1.0, 1.0)
        moved, outcome = environment.step(world, agents, action, innovation, schedule.rewards, schedule.guide_reach_m)
        crashed, ended = untouched & outcome.crashed, outcome.missed | (outcome.done & ~outcome.crashed)
        happened = jnp.stack([outcome.reward, outcome.passed, crashed, outcome.missed]) * flies
        terms = {name: jax.lax.stop_gradient(jnp.sum(term * flies)) for name, term in outcome.terms.items()}
        return (starts.choose(flies, moved, agents), flies & ~ended, untouched & ~crashed), (happened, terms, flies)

    # Checkpointed: what is kept of a tick is its state, from which the way back computes the rest again.
    carry = (agents, jnp.ones(races, bool), jnp.ones(races, bool))
    _, (happened, terms, flew) = jax.lax.scan(jax.checkpoint(tick), carry, innovations)
    sums, names = jnp.sum(happened, axis=(0, 2)), ("reward", "passages", "crashes", "misses")
    totals = dict(zip(names, sums, strict=True)) | {f"{name}_reward": jnp.sum(term) for name, term in terms.items()}
    flown_s = TICK * jnp.sum(flew)
    return -sums[0] / races, {f"{name}_per_s": total / flown_s for name, total in totals.items()}
