"""Packing of trees of arrays into one vector for each data type.

Each array argument costs a compiled call 1 to 3 us; a packed flight has a few vectors instead of a hundred arrays.
"""

import math
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


@dataclass(frozen=True)
class Layout:
    """Layout of a packed tree. Hashable, so it can be a static argument of `jax.jit`.

    Attributes:
        structure: structure of the tree (`jax.tree_util.PyTreeDef`).
        leaves: (data type, shape) of each leaf.
    """

    structure: Any
    leaves: tuple[tuple[str, tuple[int, ...]], ...]

    @property
    def types(self) -> list[str]:
        """The data types of the vectors, in their order."""
        return sorted({dtype for dtype, _ in self.leaves})

    def pack(self, tree) -> tuple:
        """Return the vectors of a tree: traced arrays if a leaf is traced, else NumPy arrays."""
        leaves = jax.tree.leaves(tree)
        xp = jnp if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves) else np
        rows = zip(self.leaves, leaves, strict=True)
        rows = [(dtype, xp.ravel(xp.asarray(leaf, dtype=dtype))) for (dtype, _), leaf in rows]
        return tuple(xp.concatenate([row for dtype, row in rows if dtype == wanted]) for wanted in self.types)

    def unpack(self, vectors: tuple):
        """Return the tree of these vectors; its leaves are views of NumPy vectors."""
        pieces = {}
        for dtype, vector in zip(self.types, vectors, strict=True):
            bounds = accumulate(
                (math.prod(shape) for leaf_dtype, shape in self.leaves if leaf_dtype == dtype), initial=0
            )
            pieces[dtype] = iter([vector[begin:end] for begin, end in pairwise(bounds)])
        return jax.tree.unflatten(self.structure, [next(pieces[dtype]).reshape(shape) for dtype, shape in self.leaves])


def layout_of(tree) -> Layout:
    """Return the layout of this tree, for all trees of the same structure, shapes and types."""
    leaves, structure = jax.tree.flatten(tree)
    arrays = [jnp.asarray(leaf) for leaf in leaves]
    return Layout(structure, tuple((str(array.dtype), array.shape) for array in arrays))
