"""Random numbers of the physics: a counter and a seed each vehicle, hashed afresh every step.

A generator of the usual kind would cost more than the rest of the step. What is random here drives filters that
remember hundreds of steps, so uniform numbers of unit variance do as well as normal ones. The hash is the 32-bit
integer mixer "lowbias32" of C. Wellons's hash prospector.
"""

import jax
import jax.numpy as jnp

GOLDEN = 0x9E3779B9  # 2^32 over the golden ratio: steps of the counter spread evenly


def start(key, shape):
    """Return {"seed", "count"}, unsigned 32-bit (shape): independent streams drawn from a key."""
    return {"seed": jax.random.bits(key, shape, jnp.uint32), "count": jnp.zeros(shape, jnp.uint32)}


def advance(noise):
    """Return the streams one step on."""
    return {"seed": noise["seed"], "count": noise["count"] + jnp.uint32(1)}


def _mixed(word):
    word = (word ^ (word >> 16)) * jnp.uint32(0x7FEB352D)
    word = (word ^ (word >> 15)) * jnp.uint32(0x846CA68B)
    return word ^ (word >> 16)


def white(noise, salt: int, count: int, dtype):
    """Return `count` numbers (...) of this step: uniform, mean 0, variance 1, independent between salts and steps.

    Two numbers share a hash, 16 bits each.
    """
    base = noise["seed"] + noise["count"] * jnp.uint32(GOLDEN)
    numbers = []
    for pair in range((count + 1) // 2):
        word = _mixed(base ^ jnp.uint32((salt + pair * GOLDEN) & 0xFFFFFFFF))
        numbers += [word & jnp.uint32(0xFFFF), word >> 16]
    return [_scaled(number.astype(jnp.int32).astype(dtype)) for number in numbers[:count]]


def _scaled(sixteen_bits):
    """Return numbers of 0..65535, evenly spread, as of mean 0 and variance 1."""
    return (sixteen_bits - 32767.5) * (12.0**0.5 / 65536.0)
