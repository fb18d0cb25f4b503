"""Checkpoints: the whole state of a training in one file, which is replaced at once or not at all."""

import os
import zipfile
from pathlib import Path

import jax
import numpy as np

from swift_ros.errors import UsageError


def save(path: Path, tree, *, fingerprint: str) -> None:
    """Write a pytree of arrays.

    Args:
        path: the file, .npz.
        tree: the pytree.
        fingerprint: identifies the configuration that the training belongs to.
    """
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(tree)]
    partial = path.with_suffix(".partial")
    with open(partial, "wb") as file:
        np.savez(file, fingerprint=np.array(fingerprint), **{f"leaf_{i:03d}": leaf for i, leaf in enumerate(leaves)})
    os.replace(partial, path)


def load(path: Path, like, *, fingerprint: str | None):
    """Return the pytree stored at `path`.

    Args:
        path: the file.
        like: a pytree of the same structure, of arrays or shapes.
        fingerprint: of the configuration; None accepts any.

    Raises:
        UsageError: the file is unreadable, holds other shapes, or belongs to another configuration.
    """
    try:
        with np.load(path) as file:
            stored = {name: file[name] for name in file.files}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise UsageError(f"{path} is not a readable checkpoint; remove it or name another") from error
    if fingerprint is not None and str(stored["fingerprint"]) != fingerprint:
        raise UsageError(f"{path} belongs to a training with other settings; use another --out or remove the folder")
    leaves, structure = jax.tree.flatten(like)
    names = sorted(name for name in stored if name.startswith("leaf_"))
    shapes = [stored[name].shape for name in names]
    if shapes != [leaf.shape for leaf in leaves]:
        raise UsageError(f"{path} holds a training of another shape; use another --out or remove the folder")
    return jax.tree.unflatten(structure, [jax.numpy.asarray(stored[name]) for name in names])
