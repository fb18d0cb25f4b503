"""Updates of a training as one compiled function, which each device runs on its share of the agents."""

from typing import Any

import jax
import jax.numpy as jnp

from swift_sim_bridge.parallel import SPLIT, WHOLE, compile_for_devices, devices_for
from swift_sim_bridge.pilot import backpropagation, ppo
from swift_sim_bridge.pilot.learner import Training
from swift_sim_bridge.pilot.settings import Plan, PolicySettings

UPDATES = {"ppo": ppo.update, "backpropagation": backpropagation.update}


def compile_updates(world, settings: PolicySettings, plan: Plan, count: int):
    """Return the jitted function: training -> (training after `count` updates, mean of their figures)."""
    update = UPDATES[settings.algorithm]

    def improve(training):
        training, figures = jax.lax.scan(lambda t, _: update(world, settings, plan, t), training, None, length=count)
        return training, jax.tree.map(jnp.mean, figures)

    devices = devices_for(settings.agents, settings.minibatch)
    return compile_for_devices(improve, devices, (placement(),), (placement(), WHOLE))


def placement() -> Training:
    """Return which parts of a training are split over the devices: the agents."""
    parts: Any = dict.fromkeys(Training._fields, WHOLE) | {"agents": SPLIT}
    return Training(**parts)
