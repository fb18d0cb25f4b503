"""What changes during a training of the policy, whatever the algorithm: its first state, and Adam on the mean gradient
of all devices.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax

from swift_ros.policy.observation import SIZE as OBSERVATION_SIZE
from swift_sim_bridge.parallel import DEVICES
from swift_sim_bridge.pilot import networks
from swift_sim_bridge.pilot.episodes import environment, starts
from swift_sim_bridge.pilot.episodes.randomization import TICK
from swift_sim_bridge.pilot.settings import PolicySettings

CRITIC_SIZE = OBSERVATION_SIZE + environment.TRUE_OBSERVATION_SIZE
# Lower bound of the learning rate, which falls while the updates' divergence is too large. A fine-tuning with a sigma
# of 0.01 needs 3e-6; from the bound, the rate needs 31 updates back to 2.5e-4.
MIN_LEARNING_RATE = 1e-6


class Training(NamedTuple):
    """Everything that changes during a training.

    Attributes:
        networks: {"actor", "critic"}, see `networks`.
        optimizer: state of Adam.
        agents: the races.
        bank: states to start episodes from, see `starts`.
        key: of the random numbers.
        updates: done so far.
        learning_rate: of the next update.
    """

    networks: dict
    optimizer: optax.OptState
    agents: environment.Agents
    bank: jnp.ndarray
    key: jnp.ndarray
    updates: jnp.ndarray
    learning_rate: jnp.ndarray


def begin(world, settings: PolicySettings, seed) -> Training:
    """Return the training before its first update, with random networks."""
    key, network_key, reset_key, age_key = jax.random.split(jax.random.PRNGKey(seed), 4)
    parameters = networks.make_actor_and_critic(network_key, OBSERVATION_SIZE, CRITIC_SIZE)
    bank = starts.first_bank(world)
    agents = environment.reset(world, bank, reset_key, settings.agents, environment.Conditions(jnp.float32(0.0)))
    # Random ages: otherwise all episodes would time out in the same tick.
    longest = int(settings.environment.episode_s / TICK)
    agents = agents._replace(age=jax.random.randint(age_key, (settings.agents,), 0, longest))
    return Training(
        networks=parameters,
        optimizer=make_optimizer(settings).init(parameters),
        agents=agents,
        bank=bank,
        key=key,
        updates=jnp.int32(0),
        learning_rate=jnp.float32(settings.learning_rate[0]),
    )


def start_from(training: Training, networks: dict) -> Training:
    """Return the training before its first update, with given networks instead of random ones.

    The learning rate begins at its lower bound: at the small sigma of a trained pilot, a large one undoes it.
    """
    return training._replace(networks=networks, learning_rate=jnp.float32(MIN_LEARNING_RATE))


def make_optimizer(settings: PolicySettings):
    """Return Adam on clipped gradients, without a learning rate: that changes from update to update.

    The mean gradient of whole races is always longer than the limit, which there makes all gradients equally long.
    """
    return optax.chain(optax.clip_by_global_norm(settings.gradient_norm), optax.scale_by_adam(eps=1e-5))


def mean_over_devices(tree):
    """Return the mean of each array over the devices."""
    return jax.lax.pmean(tree, DEVICES)
