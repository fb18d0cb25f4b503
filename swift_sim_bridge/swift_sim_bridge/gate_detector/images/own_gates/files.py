"""The folder of own gates: pictures, meshes and folders of labelled photographs."""

from pathlib import Path

from swift_ros.errors import UsageError
from swift_sim_bridge.gate_detector.images.own_gates import mesh, opening, photographs, picture
from swift_sim_bridge.gate_detector.images.own_gates.opening import MeshGate
from swift_sim_bridge.gate_detector.images.own_gates.picture import PictureGate
from swift_sim_bridge.labels.folder import LABELS

PICTURES = (".png",)
NAMING_TEXTURES = (".mtl", ".gltf")  # files that name the textures of a mesh


def read(folder: Path, bar: float, fov_deg: float | None = None) -> tuple[PictureGate | MeshGate, ...]:
    """Return the gates in a folder and below it, in the order of their names.

    A folder with `labels.json` holds photographs, and nothing else is looked for in it. A PNG file that a mesh names as
    its texture is no picture of a gate.

    Args:
        folder: the folder.
        bar: width of the frames in photographs, in sides of the opening.
        fov_deg: assumed horizontal field of view of photographs without `camera.yaml`, degrees.

    Raises:
        UsageError: it holds no gate, or a file cannot be used.
    """
    if not folder.is_dir():
        raise UsageError(
            f"{folder} is not a folder; give a folder of pictures, meshes or labelled photographs of gates"
        )
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    labelled = {file.parent for file in files if file.name == LABELS}
    others = [file for file in files if labelled.isdisjoint(file.parents)]
    textures = [file.read_text(errors="replace") for file in others if file.suffix.lower() in NAMING_TEXTURES]
    found: list[PictureGate | MeshGate] = []
    for file in others:
        if file.suffix.lower() in mesh.SUFFIXES:
            found.append(opening.read(file))
        elif file.suffix.lower() in PICTURES and not any(file.name in text for text in textures):
            found.append(picture.read(file))
    for path in sorted(labelled):
        found += photographs.read(path, bar, fov_deg)
    if not found:
        raise UsageError(
            f"{folder} holds no gate ({', '.join((*PICTURES, *mesh.SUFFIXES))}, or {LABELS} with its photographs); "
            "give frontal pictures, meshes or labelled photographs"
        )
    return tuple(found)
