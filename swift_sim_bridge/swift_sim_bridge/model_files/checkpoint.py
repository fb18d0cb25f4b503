"""Checkpoints: the whole state of a training in one file, which is replaced at once or not at all."""

import json
import zipfile
from pathlib import Path

import jax
import numpy as np

from swift_ros.errors import UsageError
from swift_sim_bridge.model_files.whole_file import replacing

RECORD = "record"  # name of the array that holds what a checkpoint belongs to, as JSON


def save(path: Path, tree, *, record: dict) -> None:
    """Write a pytree of arrays.

    Args:
        path: the file, .npz.
        tree: the pytree.
        record: what the training is, as `read_record` returns it.
    """
    leaves = {f"leaf_{i:03d}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(tree))}
    with replacing(path) as partial, open(partial, "wb") as file:
        np.savez(file, **{RECORD: np.array(json.dumps(record))}, **leaves)


def read_record(path: Path) -> dict:
    """Return the record of the checkpoint at `path`. Raises UsageError if the file is no checkpoint."""
    try:
        return json.loads(str(_arrays(path)[RECORD]))
    except (KeyError, ValueError) as error:
        raise UsageError(f"{path} is of another version of swiftros; use another --out or remove the folder") from error


def load(path: Path, like):
    """Return the pytree stored at `path`.

    Args:
        path: the file.
        like: a pytree of the same structure, of arrays or shapes.

    Raises:
        UsageError: the file is unreadable or holds other shapes.
    """
    stored = _arrays(path)
    leaves, structure = jax.tree.flatten(like)
    names = sorted(name for name in stored if name.startswith("leaf_"))
    shapes = [stored[name].shape for name in names]
    if shapes != [leaf.shape for leaf in leaves]:
        raise UsageError(f"{path} holds a training of another shape; use another --out or remove the folder")
    return jax.tree.unflatten(structure, [jax.numpy.asarray(stored[name]) for name in names])


def _arrays(path: Path) -> dict[str, np.ndarray]:
    try:
        with np.load(path) as file:
            return {name: file[name] for name in file.files}
    except (OSError, ValueError, EOFError, AttributeError, zipfile.BadZipFile) as error:
        raise UsageError(f"{path} is not a readable checkpoint; remove it or name another") from error
