"""The gradient of whole races through the simulator: it is the slope of their reward, and descending on it helps."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_ros.track import Track
from swift_sim_bridge.benchmarks import physics_speed
from swift_sim_bridge.pilot import backpropagation, export, job, learner
from swift_sim_bridge.pilot.episodes.randomization import TICK
from swift_sim_bridge.pilot.episodes.world import make_world
from swift_sim_bridge.pilot.settings import Plan, schedule_at

FOLDER = configuration.configuration_folder()
RACES, TICKS, RATE = 4, 60, 3e-4
SETTINGS = replace(
    job.read_settings(FOLDER),
    algorithm="backpropagation",
    agents=RACES,
    steps=TICKS,
    ppo=None,
    rewards={"progress": (1.0, 1.0), "risk": (1.0, 1.0)},
    learning_rate=(RATE, RATE),
)
PLAN = Plan(10_000)


@pytest.fixture(scope="module")
def world():
    track, camera = (configuration.load(k, FOLDER / f"{n}.yaml") for k, n in ((Track, "track"), (Camera, "camera")))
    simple = physics_speed.models(FOLDER)[0].vehicle  # the paper's compiles in half the time
    return make_world(track, simple, camera, SETTINGS.environment, SETTINGS.estimate_errors)


@pytest.fixture(scope="module")
def shipped(world):
    """Return the training before its first update, with the shipped pilot."""
    training = jax.jit(lambda: learner.begin(world, SETTINGS, 0))()
    actor = export.read_actor(FOLDER / "models" / "pilot.onnx", training.networks["actor"])
    return learner.start_from(training, training.networks | {"actor": actor})


@pytest.fixture(scope="module")
def slope(world):
    """Return the function: actor, key -> ((cost, figures), gradient)."""
    schedule = schedule_at(SETTINGS, PLAN, 0)

    def cost(actor, key):
        return backpropagation.cost(world, SETTINGS, schedule, actor, key, RACES)

    return jax.jit(jax.value_and_grad(cost, has_aux=True))


def test_the_gradient_is_the_slope_of_the_reward(shipped, slope):
    actor, key = shipped.networks["actor"], jax.random.PRNGKey(1)
    _, gradient = slope(actor, key)
    norm = np.sqrt(sum(float(jnp.sum(part**2)) for part in jax.tree.leaves(gradient)))
    step = 1e-3 / norm
    (above, _), _ = slope(jax.tree.map(lambda weight, part: weight + step * part, actor, gradient), key)
    (below, _), _ = slope(jax.tree.map(lambda weight, part: weight - step * part, actor, gradient), key)
    assert (above - below) / (2.0 * step) == pytest.approx(norm**2, rel=0.02)


def test_steps_against_the_gradient_make_the_same_races_faster(shipped, slope):
    key, training, costs = jax.random.PRNGKey(2), shipped, []
    for _ in range(12):
        (cost, figures), gradient = slope(training.networks["actor"], key)
        assert figures["crashes_per_s"] == 0.0
        training, taken = backpropagation.descend(SETTINGS, training, gradient, RATE)
        assert taken["lost_updates"] == 0.0
        costs.append(cost)
    assert costs[-1] < costs[0] - 0.1  # m of progress towards the first gate in 0.6 s


def test_a_race_goes_on_through_what_it_touches(world, shipped):
    bounds = world.gates.bounds_min.at[2].set(world.gates.start[2] + 1.0)  # the flight volume begins above the podium
    blocked = world._replace(gates=world.gates._replace(bounds_min=bounds))
    settings = replace(SETTINGS, rewards={"progress": (1.0, 1.0)})
    schedule = schedule_at(settings, PLAN, 0)
    fly = jax.jit(lambda actor, key: backpropagation.cost(blocked, settings, schedule, actor, key, RACES))
    cost, figures = fly(shipped.networks["actor"], jax.random.PRNGKey(1))
    assert cost < -0.2  # m of progress towards the first gate in 0.6 s
    assert figures["crashes_per_s"] == pytest.approx(1.0 / (TICKS * TICK))


def test_a_gradient_that_is_not_finite_changes_no_weight(shipped):
    *hidden, (weight, bias) = jax.tree.map(jnp.zeros_like, shipped.networks["actor"])
    gradient = [*hidden, (weight, bias.at[0].set(jnp.nan))]
    after, figures = backpropagation.descend(SETTINGS, shipped, gradient, RATE)
    assert figures["lost_updates"] == 1.0
    for new, old in zip(jax.tree.leaves(after), jax.tree.leaves(shipped._replace(learning_rate=RATE)), strict=True):
        np.testing.assert_array_equal(new, old)
