"""Random numbers of the physics: a seed for each vehicle and a counter of steps, hashed in every step.

A usual generator would take longer than the rest of the step. The numbers drive filters with a memory of hundreds of
steps, for which uniform numbers of unit variance are as good as normal ones. The hash is the 32 bit integer mixer
"lowbias32" of C. Wellons's hash prospector.
"""

import jax
import jax.numpy as jnp

GOLDEN = 0x9E3779B9  # 2^32 over the golden ratio: spreads consecutive counters evenly over 32 bits


def start(key, shape):
    """Return {"seed", "count"}, unsigned 32 bit (shape): independent streams from a JAX key."""
    return {"seed": jax.random.bits(key, shape, jnp.uint32), "count": jnp.zeros(shape, jnp.uint32)}


def advance(noise):
    """Return the streams after a step."""
    return {"seed": noise["seed"], "count": noise["count"] + jnp.uint32(1)}


def _mixed(word):
    """Return the hash of 32 bit words."""
    word = (word ^ (word >> 16)) * jnp.uint32(0x7FEB352D)
    word = (word ^ (word >> 15)) * jnp.uint32(0x846CA68B)
    return word ^ (word >> 16)


def white(noise, salt: int, count: int, dtype):
    """Return `count` numbers (...) of this step: uniform, mean 0, variance 1, independent between salts and steps.

    Two numbers come from one hash, 16 bits each.
    """
    base = noise["seed"] + noise["count"] * jnp.uint32(GOLDEN)
    numbers = []
    for pair in range((count + 1) // 2):
        word = _mixed(base ^ jnp.uint32((salt + pair * GOLDEN) & 0xFFFFFFFF))
        numbers += [word & jnp.uint32(0xFFFF), word >> 16]
    return [_scaled(number.astype(jnp.int32).astype(dtype)) for number in numbers[:count]]


def _scaled(sixteen_bits):
    """Return uniform integers 0..65535 as numbers of mean 0 and variance 1."""
    return (sixteen_bits - 32767.5) * (12.0**0.5 / 65536.0)
