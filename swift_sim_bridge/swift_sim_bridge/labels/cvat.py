"""CVAT for images 1.1: shapes of other people's gates are read, and labelled images are written as skeletons.

CVAT's coordinates are continuous: the first pixel reaches from 0 to 1, and its centre is at 0.5. Here it is at 0.
"""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.text import described
from swift_sim_bridge.labels import coco
from swift_sim_bridge.labels.exchange import ForeignGate, ForeignImage
from swift_sim_bridge.labels.labelled_images import CORNERS, NOT_LABELLED, OCCLUDED, VISIBLE, LabelledImage

HALF_PIXEL = 0.5  # px, from CVAT's coordinates to those of pixel centres
SHAPES = ("points", "polygon", "polyline")  # with a list of points; skeletons have one shape for each point


def read(path: Path) -> list[ForeignImage]:
    """Return the images of an XML file of CVAT with their shapes. Raises UsageError that names file and image."""
    try:
        root = ElementTree.parse(path).getroot()
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}; give a file of CVAT for images 1.1") from error
    except ElementTree.ParseError as error:
        raise UsageError(f"{path} is not valid XML ({error}); export it again") from error
    if root.tag != "annotations" or root.find("track") is not None:
        raise UsageError(f"{path} is no file of CVAT for images; export the task as 'CVAT for images 1.1'")
    return [_image(item, path) for item in root.iter("image")]


def _image(item, path: Path) -> ForeignImage:
    name = item.get("name") or ""
    where = f"{path}, image {described(name)}"
    size = {key: _whole_number(item.get(key)) for key in ("width", "height")}
    width, height = coco.image_size(size, where)
    gates, others = [], 0
    for shape in item:
        if shape.tag == "skeleton":
            gates.append(_skeleton(shape, where))
        elif shape.tag in SHAPES:
            points = _points(shape, where)
            visibility = OCCLUDED if shape.get("occluded") == "1" else VISIBLE
            gates.append(ForeignGate((), points, np.full(len(points), visibility)))
        else:
            others += 1
    return ForeignImage(name, width, height, tuple(gates), others)


def _skeleton(shape, where: str) -> ForeignGate:
    names, points, visibility = [], [], []
    for part in shape.findall("points"):
        position = _points(part, where)
        if len(position) != 1:
            raise UsageError(f"{where} has a skeleton with {len(position)} positions of one point; export it again")
        names.append(part.get("label") or "")
        points.append(position[0])
        hidden = OCCLUDED if part.get("occluded") == "1" else VISIBLE
        visibility.append(NOT_LABELLED if part.get("outside") == "1" else hidden)
    return ForeignGate(tuple(names), np.reshape(points, (-1, 2)), np.array(visibility, dtype=int))


def _points(shape, where: str) -> np.ndarray:
    """Return the points (n, 2) px of a shape, pixel centres at whole numbers."""
    text = shape.get("points") or ""
    try:
        points = np.array([[float(value) for value in pair.split(",")] for pair in text.split(";")])
    except ValueError:
        points = np.empty(0)
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise UsageError(f"{where} has a shape with the points {described(text)}, which are not pairs of numbers")
    return points - HALF_PIXEL


def _whole_number(text: str | None) -> int | None:
    return int(text) if text and text.isdecimal() and len(text) < 10 else None


def write(path: Path, images: list[LabelledImage]) -> None:
    """Write labelled images as skeletons `gate`, whole or not at all. Raises UsageError where it cannot write."""
    root = ElementTree.Element("annotations")
    ElementTree.SubElement(root, "version").text = "1.1"
    for number, image in enumerate(images):
        values = {"id": number, "name": image.file_name, "width": image.width, "height": image.height}
        item = ElementTree.SubElement(root, "image", {key: str(value) for key, value in values.items()})
        for gate in image.gates:
            shape = ElementTree.SubElement(item, "skeleton", label="gate", source="manual", z_order="0")
            for name, point, visibility in zip(CORNERS, gate.corners_px, gate.visibility, strict=True):
                u, v = np.nan_to_num(point) + HALF_PIXEL
                ElementTree.SubElement(
                    shape,
                    "points",
                    label=name,
                    source="manual",
                    outside=str(int(visibility == NOT_LABELLED)),
                    occluded=str(int(visibility == OCCLUDED)),
                    points=f"{u:.2f},{v:.2f}",
                )
    ElementTree.indent(root)
    coco.replace_text(path, "<?xml version='1.0' encoding='utf-8'?>\n" + ElementTree.tostring(root, "unicode") + "\n")
