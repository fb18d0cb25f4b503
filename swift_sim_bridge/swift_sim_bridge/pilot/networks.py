"""Actor and critic as functions of parameters: two hidden layers of 128, LeakyReLU 0.2 (Methods, "Policy training")."""

import jax
import jax.numpy as jnp

WIDTH = 128  # units of a hidden layer, as in the paper
SLOPE = 0.2  # of LeakyReLU for negative inputs, as in the paper
THRUST_BIAS = -0.3  # thrust action of an untrained policy: 12 of 35 N, 1.4 times the weight of the shipped vehicle


def make(key, inputs: int, outputs: int, last_scale: float):
    """Return random parameters of a network: a list of (weight (in, out), bias (out,)).

    Args:
        key: of the random numbers.
        inputs, outputs: number of each.
        last_scale: of the last layer's orthogonal weights; hidden layers have sqrt(2).
    """
    sizes = [(inputs, WIDTH, 2**0.5), (WIDTH, WIDTH, 2**0.5), (WIDTH, outputs, last_scale)]
    keys = jax.random.split(key, len(sizes))
    orthogonal = jax.nn.initializers.orthogonal
    return [
        (orthogonal(scale)(k, (rows, columns), jnp.float32), jnp.zeros((columns,), jnp.float32))
        for k, (rows, columns, scale) in zip(keys, sizes, strict=True)
    ]


def make_actor_and_critic(key, observation_size: int, critic_size: int) -> dict:
    """Return {"actor", "critic"}; the actor's first actions are near zero rates and `THRUST_BIAS`."""
    actor_key, critic_key = jax.random.split(key)
    actor = make(actor_key, observation_size, 4, 0.01)
    weight, bias = actor[-1]
    actor[-1] = (weight, bias.at[0].set(THRUST_BIAS))
    return {"actor": actor, "critic": make(critic_key, critic_size, 1, 1.0)}


def apply(parameters, inputs):
    """Return the outputs (..., out) for inputs (..., in)."""
    hidden = inputs
    for weight, bias in parameters[:-1]:
        hidden = jax.nn.leaky_relu(hidden @ weight + bias, SLOPE)
    weight, bias = parameters[-1]
    return hidden @ weight + bias
