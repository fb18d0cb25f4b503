"""Packing: a packed tree is unpacked to the same values, integers and flags to the last bit."""

import jax
import jax.numpy as jnp
import numpy as np

from swift_sim_bridge.simulation.packing import layout_of

SEED = 4_294_967_295  # a 32-bit float cannot represent it


def tree():
    return {
        "p": np.array([1.0, -2.5], np.float32),
        "seed": np.uint32(SEED),
        "on": np.array([True, False]),
        "off": None,
        "turn": (np.eye(3, dtype=np.float32), np.float32(0.1)),
    }


def test_a_tree_is_unchanged_by_a_compiled_call_that_takes_it_as_vectors():
    layout = layout_of(tree())
    vectors = layout.pack(tree())
    assert [(str(vector.dtype), vector.shape) for vector in vectors] == [
        ("bool", (2,)),
        ("float32", (12,)),
        ("uint32", (1,)),
    ]
    changed = jax.jit(lambda packed: layout.pack({**layout.unpack(packed), "turn": (jnp.ones((3, 3)), jnp.ones(()))}))
    back = layout.unpack(tuple(map(np.asarray, changed(vectors))))
    assert int(back["seed"]) == SEED and back["off"] is None and back["on"].tolist() == [True, False]
    assert np.array_equal(back["p"], tree()["p"]) and back["turn"][0].shape == (3, 3) and back["turn"][1] == 1.0
    assert hash(layout) == hash(layout_of(tree())) and layout == layout_of(tree())
