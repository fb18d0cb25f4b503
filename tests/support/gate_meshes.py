"""Gates of triangles with a known opening, for the tests of own gates."""

import numpy as np
import trimesh

INNER, OUTER, DEPTH = 1.5, 2.1, 0.2  # m


def box(low, high) -> trimesh.Trimesh:
    """Return a box between two corners (3,)."""
    return trimesh.creation.box(bounds=[low, high])


def frame(inner=(INNER, INNER), bar=0.5 * (OUTER - INNER), depth=DEPTH) -> trimesh.Trimesh:
    """Return a frame of four boxes with z up; its opening of a size (width, height) is around the origin, along y."""
    x, z = inner[0] / 2, inner[1] / 2
    y = depth / 2
    boxes = [box((-x - bar, -y, -z - bar), (-x, y, z + bar)), box((x, -y, -z - bar), (x + bar, y, z + bar))]
    boxes += [box((-x, -y, z), (x, y, z + bar)), box((-x, -y, -z - bar), (x, y, -z))]
    return trimesh.util.concatenate(boxes)


def turned(mesh: trimesh.Trimesh, degrees: float, axis) -> trimesh.Trimesh:
    """Return a mesh turned about an axis (3,)."""
    return mesh.copy().apply_transform(trimesh.transformations.rotation_matrix(np.radians(degrees), axis))
