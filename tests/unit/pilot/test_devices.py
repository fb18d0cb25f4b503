"""A training on several devices: agents are split over them, all learn from the mean of their gradients."""

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from swift_ros import configuration
from swift_ros.policy.observation import SIZE
from swift_sim_bridge.parallel import SPLIT, WHOLE, InBackground, compile_for_devices, devices_for
from swift_sim_bridge.pilot import job, learner, networks, ppo

SETTINGS = job.read_settings(configuration.configuration_folder())


def test_as_many_devices_are_used_as_divide_the_arrays_evenly():
    assert len(jax.devices()) == 2  # of the tests, see conftest.py
    assert [devices_for(4, 6), devices_for(4, 7), devices_for(1)] == [2, 1, 1]


def test_two_devices_learn_from_their_halves_what_one_learns_from_all_rows():
    keys = jax.random.split(jax.random.PRNGKey(0), 6)
    given = networks.make_actor_and_critic(keys[0], SIZE, learner.CRITIC_SIZE)
    shapes = ((512, learner.CRITIC_SIZE), (512, 4), (512, 4), (512,), (512,))
    rows = ppo.Rows(*(jax.random.normal(key, shape) for key, shape in zip(keys[1:], shapes, strict=True)))
    own = replace(ppo.own_settings(SETTINGS), minibatch=512, epochs=2)
    settings = replace(SETTINGS, agents=32, steps=16, ppo=own)
    state = learner.make_optimizer(settings).init(given)
    nothing: Any = None  # the rest is not read
    training = learner.Training(given, state, *[nothing] * 5)
    rates = {"actor": 1e-2, "critic": 1e-2}

    def learn(rows):
        return ppo.descend(settings, training, rows, 0.5, rates, jax.random.PRNGKey(1))

    (one, _, divergence), (two, _, same) = (compile_for_devices(learn, n, (SPLIT,), WHOLE)(rows) for n in (1, 2))
    assert float(divergence) > 0.01 and abs(float(divergence) - float(same)) < 1e-4
    moved = jax.tree.map(lambda before, after: float(jnp.abs(after - before).max()), given, one)
    assert min(jax.tree.leaves(moved)) > 1e-3
    jax.tree.map(partial(np.testing.assert_allclose, atol=1e-4), one, two)


def test_an_error_in_the_background_is_raised_by_the_next_call():
    seen = []

    def note(value):
        seen.append(1 / value)

    call = InBackground(note)
    call(1)
    call(0)
    with pytest.raises(ZeroDivisionError):
        call(2)
    call(4)
    call.wait()
    assert seen == [1.0, 0.25]
