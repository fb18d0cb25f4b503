"""Mesh files: triangles with their colours and textures."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from swift_ros.errors import UsageError

SUFFIXES = (".obj", ".stl", ".ply", ".glb", ".gltf")
UP_IS_Y = (".glb", ".gltf")  # by their standard; in the other files z points up
MAX_TRIANGLES = 50_000  # with more, a mesh costs more than the rest of its image
FARTHEST = 1e9  # of a corner from the origin, in any unit; more, or NaN, is no place
MAX_TEXTURE_PX = 512  # longer side; a gate fills at most as many pixels
R_UP_FROM_Y = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles and what covers them.

    Attributes:
        triangles: (n, 3, 3), corners in any unit.
        colours: (n, 3) uint8, blue, green, red.
        coloured: (n,), the file gives a colour; the others take a drawn one.
        texture: (n,), index of the texture, -1 without.
        texels: (n, 3, 2), corners in pixels of the texture, which is repeated.
        textures: (h, w, 3) uint8 each, blue first.
    """

    triangles: np.ndarray
    colours: np.ndarray
    coloured: np.ndarray
    texture: np.ndarray
    texels: np.ndarray
    textures: tuple[np.ndarray, ...]


def read(path: Path) -> Mesh:
    """Return the mesh of a file, with z up.

    Raises:
        UsageError: it is not readable, has no triangles or too many, or a corner that is not a number.
    """
    try:
        parts = _parts(path)
    except Exception as error:  # each format has its own reader, and each reader its own errors
        raise UsageError(f"{path} is not a readable mesh; export it again as {', '.join(SUFFIXES)}") from error
    if not parts:
        raise UsageError(f"{path} has no triangles; export the surface of the gate, and no curves or points alone")
    found = _joined(parts)
    if len(found.triangles) > MAX_TRIANGLES:
        raise UsageError(
            f"{path} has {len(found.triangles)} triangles, more than {MAX_TRIANGLES}; decimate it, as with the "
            "modifier Decimate of Blender or Simplification: Quadric Edge Collapse of MeshLab"
        )
    if not (np.abs(found.triangles) < FARTHEST).all():
        raise UsageError(f"{path} has a corner that is not a number; repair the mesh and export it again")
    return replace(found, triangles=found.triangles @ R_UP_FROM_Y.T) if path.suffix.lower() in UP_IS_Y else found


def _parts(path: Path) -> list[Mesh]:
    """Return the meshes of a file, each with the axes of the file. Raises errors of many kinds."""
    import trimesh  # takes a second, which a training without own meshes does not need

    scene = trimesh.load_scene(str(path), process=False)
    placed = [(scene.geometry[name], transform) for transform, name in map(scene.graph.get, scene.graph.nodes_geometry)]
    parts = [_part(geometry, transform) for geometry, transform in placed if isinstance(geometry, trimesh.Trimesh)]
    return [part for part in parts if len(part.triangles)]


def _part(geometry, transform) -> Mesh:
    """Return the mesh of one geometry of a scene, moved by a transform (4, 4)."""
    corners = np.asarray(geometry.vertices, float) @ transform[:3, :3].T + transform[:3, 3]
    faces, count = np.asarray(geometry.faces), len(geometry.faces)
    mesh = Mesh(
        triangles=corners[faces].reshape(-1, 3, 3),
        colours=np.zeros((count, 3), np.uint8),
        coloured=np.zeros(count, bool),
        texture=np.full(count, -1),
        texels=np.zeros((count, 3, 2)),
        textures=(),
    )
    visual = geometry.visual
    if visual.kind == "texture":
        return _textured(mesh, visual, faces)
    if visual.kind in ("face", "vertex"):
        return replace(mesh, colours=_blue_first(visual.face_colors), coloured=np.ones(count, bool))
    return mesh


def _textured(mesh: Mesh, visual, faces) -> Mesh:
    """Return a mesh with the picture of its material, or with the colour of a material that has one."""
    material, count = visual.material, len(faces)
    image = getattr(material, "image", None) or getattr(material, "baseColorTexture", None)
    if image is None or visual.uv is None:
        if getattr(material, "baseColorFactor", material.main_color) is None:  # of glTF; `main_color` is then a default
            return mesh
        colours = np.repeat(_blue_first(np.asarray(material.main_color)[None]), count, axis=0)
        return replace(mesh, colours=colours, coloured=np.ones(count, bool))
    picture = _blue_first(np.asarray(image.convert("RGB")))
    share = MAX_TEXTURE_PX / max(picture.shape)
    picture = cv2.resize(picture, None, fx=share, fy=share, interpolation=cv2.INTER_AREA) if share < 1 else picture
    height, width = picture.shape[:2]
    u, v = np.moveaxis(np.asarray(visual.uv, float)[faces], -1, 0)
    texels = np.stack([u * width - 0.5, (1 - v) * height - 0.5], axis=-1)
    return replace(
        mesh, texture=np.zeros(count, int), texels=texels, textures=(picture,), coloured=np.ones(count, bool)
    )


def _blue_first(colours) -> np.ndarray:
    """Return colours (..., 3) uint8, blue first, of colours (..., 3 or 4) with red first."""
    return np.ascontiguousarray(np.asarray(colours, np.uint8)[..., 2::-1])


def _joined(parts: list[Mesh]) -> Mesh:
    """Return one mesh of several."""
    before = np.cumsum([0, *(len(part.textures) for part in parts)])[:-1]
    shifted = [np.where(part.texture < 0, -1, part.texture + k) for part, k in zip(parts, before, strict=True)]
    columns = (np.concatenate([getattr(part, name) for part in parts]) for name in ("triangles", "colours", "coloured"))
    texels = np.concatenate([part.texels for part in parts])
    return Mesh(*columns, np.concatenate(shifted), texels, tuple(one for part in parts for one in part.textures))
