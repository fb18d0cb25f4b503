"""Trees of arrays as one vector for each type of number: every array by itself costs a compiled call 1 to 3 us."""

import math
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


@dataclass(frozen=True)
class Layout:
    """Where the leaves of a tree lie: its structure, and each leaf's type and shape. Hashable: static for `jax.jit`."""

    structure: Any
    leaves: tuple[tuple[str, tuple[int, ...]], ...]

    @property
    def types(self) -> list[str]:
        """The types of the vectors, in their order."""
        return sorted({kind for kind, _ in self.leaves})

    def pack(self, tree) -> tuple:
        """Return the vectors of a tree, traced where a leaf is, else NumPy's."""
        leaves = jax.tree.leaves(tree)
        xp = jnp if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves) else np
        rows = zip(self.leaves, leaves, strict=True)
        rows = [(kind, xp.ravel(xp.asarray(leaf, dtype=kind))) for (kind, _), leaf in rows]
        return tuple(xp.concatenate([row for kind, row in rows if kind == wanted]) for wanted in self.types)

    def unpack(self, vectors: tuple):
        """Return the tree of these vectors; of NumPy's, views of them."""
        pieces = {}
        for kind, vector in zip(self.types, vectors, strict=True):
            sizes = accumulate((math.prod(shape) for one, shape in self.leaves if one == kind), initial=0)
            pieces[kind] = iter([vector[begin:end] for begin, end in pairwise(sizes)])
        return jax.tree.unflatten(self.structure, [next(pieces[kind]).reshape(shape) for kind, shape in self.leaves])


def layout_of(tree) -> Layout:
    """Return how trees like this one are packed."""
    leaves, structure = jax.tree.flatten(tree)
    arrays = [jnp.asarray(leaf) for leaf in leaves]
    return Layout(structure, tuple((str(array.dtype), array.shape) for array in arrays))
