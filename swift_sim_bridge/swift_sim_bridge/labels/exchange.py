"""Labels of other tools: four points of any names and order become the corners of a gate."""

import math
import re
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.text import described
from swift_sim_bridge.labels import coco
from swift_sim_bridge.labels.labelled_images import (
    CORNERS,
    IMPORTED,
    NOT_LABELLED,
    LabelledGate,
    LabelledImage,
    problem_of,
    r_world_camera,
)

VERTICAL = {"top": 0, "upper": 0, "t": 0, "bottom": 1, "lower": 1, "b": 1}
HORIZONTAL = {"left": 0, "l": 0, "right": 1, "r": 1}
CORNER_AT = ((0, 1), (3, 2))  # index in CORNERS by (vertical, horizontal)


@dataclass(frozen=True, eq=False)
class ForeignGate:
    """Points of one object as another tool stores them.

    Attributes:
        names: of the points; () where the tool has none.
        points: (n, 2) px, pixel centres at whole numbers.
        visibility: (n,), as in COCO.
    """

    names: tuple[str, ...]
    points: np.ndarray
    visibility: np.ndarray


@dataclass(frozen=True, eq=False)
class ForeignImage:
    """One image of another tool's file.

    Attributes:
        name: as the tool stores it; may be a path of another machine.
        width, height: px.
        gates: objects with points.
        others: number of shapes without points, such as boxes.
    """

    name: str
    width: int
    height: int
    gates: tuple[ForeignGate, ...]
    others: int = 0


@dataclass
class ImportCounts:
    """What an import has found and left out.

    Attributes:
        images, gates: taken.
        empty_images: listed without a gate; left out unless they are meant to show none.
        missing_images: not in the folder.
        by_position: gates whose corners were named by their position in the image.
        left_out: gates by the reason why they were left out.
    """

    images: int = 0
    gates: int = 0
    empty_images: int = 0
    missing_images: int = 0
    by_position: int = 0
    left_out: dict[str, int] = field(default_factory=dict)

    def sentences(self) -> list[str]:
        """Return what to print."""
        lines = [f"{self.images} images with {self.gates} gates"]
        if self.by_position:
            lines.append(f"warning: {self.by_position} gates have no names of corners; their position names them")
        if self.missing_images:
            lines.append(f"left out: {self.missing_images} images that are not in the folder")
        if self.empty_images:
            lines.append(
                f"left out: {self.empty_images} images without a gate; --empty takes them as images without one"
            )
        return lines + [f"left out: {number} gates that {why}" for why, number in sorted(self.left_out.items())]


def read_coco(path: Path) -> list[ForeignImage]:
    """Return the images of a COCO file with keypoints of any names. Raises UsageError."""
    content = coco.read_json(path)
    names = {row.get("id"): row.get("keypoints") for row in content["categories"]}
    objects: dict = {}
    for row in content["annotations"]:
        objects.setdefault(row["image_id"], []).append(row)
    images = []
    for row in content["images"]:
        where = f"{path}, image {described(row['file_name'])}"
        gates = [_coco_gate(one, names, where) for one in objects.get(row["id"], ()) if one.get("keypoints")]
        others = len(objects.get(row["id"], ())) - len(gates)
        images.append(ForeignImage(row["file_name"], *coco.image_size(row, where), tuple(gates), others))
    return images


def _coco_gate(row: dict, names: dict, where: str) -> ForeignGate:
    points = coco.keypoints(row, where)
    try:
        found = names.get(row.get("category_id"))
    except TypeError:  # a list as the identifier of a category
        found = None
    named = isinstance(found, list) and len(found) == len(points) and all(isinstance(name, str) for name in found)
    return ForeignGate(tuple(found) if named and found else (), points[:, :2], points[:, 2].astype(int))


def corner_of(name: str) -> int | None:
    """Return the index in CORNERS of a point's name, such as `TL`, `topLeft` or `inner upper left`; None if none."""
    text = name.lower()
    words = re.findall("top|upper|bottom|lower|left|right", text) or re.findall(r"\b([tb])([lr])\b", text)
    words = [letter for pair in words for letter in (pair if isinstance(pair, tuple) else (pair,))]
    vertical = {VERTICAL[word] for word in words if word in VERTICAL}
    horizontal = {HORIZONTAL[word] for word in words if word in HORIZONTAL}
    return CORNER_AT[vertical.pop()][horizontal.pop()] if len(vertical) == len(horizontal) == 1 else None


def arranged(gate: ForeignGate, image: LabelledImage) -> tuple[LabelledGate | None, bool, str]:
    """Return (the gate with its corners in order or None, whether their position named them, what is wrong)."""
    corners = [corner_of(name) for name in gate.names]
    known = [corner for corner in corners if corner is not None]
    if known and len(set(known)) == len(known) and (len(known) == len(CORNERS) or len(known) == len(corners)):
        return (*_checked(*_by_name(gate, corners), image, False),)
    if len(gate.points) != len(CORNERS):
        return None, False, f"have {len(gate.points)} points instead of 4"
    if (gate.visibility == NOT_LABELLED).any():
        return None, False, "have corners without a name and not all of them"
    order = clockwise_from_top_left(gate.points, image)
    return (*_checked(gate.points[order], gate.visibility[order], image, True),)


def _by_name(gate: ForeignGate, corners: list[int | None]) -> tuple[np.ndarray, np.ndarray]:
    points, visibility = np.full((4, 2), np.nan), np.zeros(4, dtype=int)
    for k, corner in enumerate(corners):
        if corner is not None:
            points[corner], visibility[corner] = gate.points[k], gate.visibility[k]
    return points, visibility


def _checked(points, visibility, image: LabelledImage, by_position: bool):
    points = np.where((visibility == NOT_LABELLED)[:, None], np.nan, points)
    found = LabelledGate(points, visibility)
    problem = problem_of(found, image.width, image.height)
    return (None, by_position, "are impossible, such as crossing sides") if problem else (found, by_position, "")


def clockwise_from_top_left(points, image: LabelledImage) -> np.ndarray:
    """Return the order (4,) in which points (4, 2) of an image run top-left, top-right, bottom-right, bottom-left."""
    up = r_world_camera(image).T @ np.array([0.0, 0.0, 1.0])
    roll = math.atan2(up[0], -up[1])  # of the world's up in the image, clockwise from the image's up
    cosine, sine = math.cos(roll), math.sin(roll)
    turned = (points - points.mean(axis=0)) @ np.array([[cosine, -sine], [sine, cosine]])
    order = np.argsort(np.arctan2(turned[:, 1], turned[:, 0]))  # y is down: clockwise
    return np.roll(order, -int(np.argmin(turned[order].sum(axis=1))))


def taken(foreign: list[ForeignImage], images: list[LabelledImage], empty: bool) -> tuple[list, ImportCounts]:
    """Return the labelled images that another tool's file describes, and what was left out.

    Args:
        foreign: images of the file.
        images: images of the folder, without gates. They are found by name, or by a file name that only one has.
        empty: images without a gate show none; otherwise they are left out as not labelled.

    Raises:
        UsageError: an image has another size in the file.
    """
    by_name = {image.file_name: image for image in images}
    short: dict = {}
    for image in images:
        short.setdefault(Path(image.file_name).name, []).append(image)
    found, counts = {}, ImportCounts()
    for one in foreign:
        name = one.name.replace("\\", "/")
        same = short.get(Path(name).name, [])
        image = by_name.get(name) or (same[0] if len(same) == 1 else None)
        if image is None:
            counts.missing_images += 1
            continue
        if (image.width, image.height) != (one.width, one.height):
            raise UsageError(
                f"{image.file_name} has {image.width} x {image.height} px and {one.width} x {one.height} px in the "
                "file; label and import images of one size"
            )
        gates = _gates(one, image, counts)
        if gates or (empty and not one.gates):
            found[image.file_name] = replace(image, gates=tuple(gates), source=IMPORTED)
            counts.images += 1
        else:
            counts.empty_images += not one.gates
    return list(found.values()), counts


def _gates(one: ForeignImage, image: LabelledImage, counts: ImportCounts) -> list[LabelledGate]:
    gates = []
    for foreign in one.gates:
        gate, by_position, problem = arranged(foreign, image)
        if gate is None:
            counts.left_out[problem] = counts.left_out.get(problem, 0) + 1
            continue
        counts.gates += 1
        counts.by_position += by_position
        gates.append(gate)
    return gates
