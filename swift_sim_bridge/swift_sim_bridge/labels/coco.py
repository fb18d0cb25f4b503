"""`labels.json`: labelled images as COCO keypoints, read with all checks and written whole or not at all.

The category `gate` has the keypoints of `labelled_images.CORNERS`. Images carry keys that COCO does not have and other
tools ignore: `all_gates`, `q_world_camera`, `stamp_s`, `sequence` and `source`, see `LabelledImage`.
"""

import json
import math
import os
from collections import defaultdict
from pathlib import Path, PurePosixPath

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.text import described
from swift_sim_bridge.labels.labelled_images import (
    CORNERS,
    NOT_LABELLED,
    LabelledGate,
    LabelledImage,
    problem_of,
)

CATEGORY = {
    "id": 1,
    "name": "gate",
    "supercategory": "gate",
    "keypoints": list(CORNERS),
    "skeleton": [[1, 2], [2, 3], [3, 4], [4, 1]],
}
MAX_SIDE_PX = 20_000  # of an image; a larger number is damage
DIGITS = 3  # of a coordinate, after the point: 0.001 px


def read(path: Path) -> list[LabelledImage]:
    """Return the labelled images of a file whose category is that of this module.

    Raises:
        UsageError: the file cannot be read, lacks a key, or has a wrong value; it names the file and the image.
    """
    content = read_json(path)
    check_category(content, path)
    gates = defaultdict(list)
    for row in content["annotations"]:
        gates[row["image_id"]].append(row)
    return [_image(row, gates.pop(row["id"], []), path) for row in content["images"]]


def read_json(path: Path) -> dict:
    """Return the content of a COCO file with its three tables: rows are mappings, ids fit. Raises UsageError."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}; give a file of COCO keypoints") from error
    except RecursionError as error:
        raise UsageError(f"{path} has too many brackets within brackets; give a file of COCO keypoints") from error
    except ValueError as error:
        raise UsageError(f"{path} is not valid JSON ({error}); write or export it again") from error
    for name in ("images", "annotations", "categories"):
        rows = content.get(name) if isinstance(content, dict) else None
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            raise UsageError(f"{path} has no list '{name}'; give a file of COCO keypoints")
    _check_ids(content, path)
    return content


def _check_ids(content: dict, path: Path) -> None:
    ids, names = set(), set()
    for row in content["images"]:
        where = f"{path}, image {described(row.get('file_name'))}"
        if not _is_whole_number(row.get("id")) or row["id"] in ids:
            raise UsageError(f"{where} has the id {described(row.get('id'))}, which is no number of its own")
        if not isinstance(row.get("file_name"), str) or row["file_name"] in names:
            raise UsageError(f"{where} has no file_name of its own")
        ids.add(row["id"])
        names.add(row["file_name"])
    for row in content["annotations"]:
        if not _is_whole_number(row.get("image_id")) or row["image_id"] not in ids:
            raise UsageError(
                f"{path}, annotation {described(row.get('id'))} belongs to the image "
                f"{described(row.get('image_id'))}, which the file does not list"
            )


def _is_whole_number(value) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def check_category(content: dict, path: Path) -> None:
    """Raise UsageError unless the only category with keypoints is `gate` with the corners in this module's order."""
    found = [row.get("keypoints") for row in content["categories"] if row.get("keypoints")]
    if found != [list(CORNERS)] or len(content["categories"]) != 1:
        raise UsageError(
            f"{path} has other categories than one with the keypoints {', '.join(CORNERS)}; "
            "convert it with `swiftros label FOLDER --import FILE`"
        )


def image_size(row: dict, where: str) -> tuple[int, int]:
    """Return width and height (px) of a row of `images`. Raises UsageError."""
    size = row.get("width"), row.get("height")
    if not all(_is_whole_number(side) and 0 < side <= MAX_SIDE_PX for side in size):
        raise UsageError(f"{where} has the size {described(size)}; width and height are px, 1 to {MAX_SIDE_PX}")
    return size[0], size[1]


def keypoints(row: dict, where: str) -> np.ndarray:
    """Return the keypoints (n, 3) of an annotation: x px, y px, visibility. Raises UsageError."""
    values = row.get("keypoints")
    numbers = isinstance(values, list) and all(type(value) in (int, float) and _is_finite(value) for value in values)
    if not numbers or len(values) % 3:
        raise UsageError(f"{where} has a gate whose keypoints are not triples of numbers (x, y, visibility)")
    points = np.array(values, dtype=float).reshape(-1, 3)
    if not np.isin(points[:, 2], (0, 1, 2)).all():
        raise UsageError(f"{where} has a gate with a visibility other than 0 (not labelled), 1 (occluded), 2 (visible)")
    return points


def _is_finite(value) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number of very many digits
        return False


def gate_of(points: np.ndarray) -> LabelledGate:
    """Return the gate of four keypoints (4, 3) in the order of CORNERS."""
    visibility = points[:, 2].astype(int)
    return LabelledGate(np.where(visibility[:, None] == NOT_LABELLED, np.nan, points[:, :2]), visibility)


def _image(row: dict, annotations: list[dict], path: Path) -> LabelledImage:
    name = row["file_name"]
    where = f"{path}, image {name}"
    parts = PurePosixPath(name).parts
    if not parts or ".." in parts or PurePosixPath(name).is_absolute():
        raise UsageError(f"{where} lies outside of the folder; images lie beside labels.json or below it")
    width, height = image_size(row, where)
    gates = []
    for annotation in annotations:
        points = keypoints(annotation, where)
        if len(points) != len(CORNERS):
            raise UsageError(f"{where} has a gate with {len(points)} keypoints instead of {len(CORNERS)}")
        gates.append(gate_of(points))
    image = LabelledImage(
        file_name=name,
        width=width,
        height=height,
        gates=tuple(gates),
        all_gates=_typed(row, "all_gates", bool, True, where),
        q_world_camera=_attitude(row.get("q_world_camera"), where),
        stamp_s=_stamp(row.get("stamp_s"), where),
        sequence=_typed(row, "sequence", str, "", where),
        source=_typed(row, "source", str, "", where),
    )
    check(image, path)
    return image


def _typed(row: dict, key: str, kind: type, default, where: str):
    value = row.get(key, default)
    if not isinstance(value, kind):
        raise UsageError(f"{where}: '{key}' must be of type {kind.__name__}, not {described(value)}")
    return value


def _stamp(value, where: str) -> float | None:
    if value is not None and not (type(value) in (int, float) and _is_finite(value)):
        raise UsageError(f"{where}: 'stamp_s' must be a number of seconds, not {described(value)}")
    return None if value is None else float(value)


def _attitude(value, where: str) -> np.ndarray | None:
    if value is None:
        return None
    numbers = isinstance(value, list) and len(value) == 4
    if not (numbers and all(type(part) in (int, float) and _is_finite(part) for part in value)):
        raise UsageError(f"{where}: 'q_world_camera' must be four numbers x, y, z, w, not {described(value)}")
    attitude = np.array(value, dtype=float)
    if abs(np.linalg.norm(attitude) - 1.0) > 0.01:
        raise UsageError(f"{where}: 'q_world_camera' has the length {np.linalg.norm(attitude):.3g} instead of 1")
    return attitude


def check(image: LabelledImage, path: Path) -> None:
    """Raise UsageError, with the names of the file at `path` and of the image, when one of its gates is impossible."""
    for number, gate in enumerate(image.gates, start=1):
        problem = problem_of(gate, image.width, image.height)
        if problem:
            raise UsageError(f"{path}, image {image.file_name}: gate {number} {problem}")


def write(path: Path, images: list[LabelledImage]) -> None:
    """Write labelled images, whole or not at all. Raises UsageError on impossible gates or where it cannot write."""
    for image in images:
        check(image, path)
    tables = {"images": [], "annotations": [], "categories": [CATEGORY]}
    for number, image in enumerate(images, start=1):
        tables["images"].append({"id": number} | _image_row(image))
        for gate in image.gates:
            tables["annotations"].append(_annotation_row(gate, len(tables["annotations"]) + 1, number))
    replace_text(path, json.dumps(tables, indent=1, allow_nan=False) + "\n")


def replace_text(path: Path, text: str) -> None:
    """Replace a file by a text, whole or not at all. Raises UsageError where it cannot be written."""
    partial = path.with_name(path.name + ".partial")
    try:
        with partial.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError as error:
        raise UsageError(f"{path} cannot be written: {error.strerror}") from error


def _image_row(image: LabelledImage) -> dict:
    row: dict = {"file_name": image.file_name, "width": image.width, "height": image.height}
    row["all_gates"] = image.all_gates
    if image.q_world_camera is not None:
        row["q_world_camera"] = [float(value) for value in image.q_world_camera]
    if image.stamp_s is not None:
        row["stamp_s"] = image.stamp_s
    return row | {key: getattr(image, key) for key in ("sequence", "source") if getattr(image, key)}


def _annotation_row(gate: LabelledGate, number: int, image_id: int) -> dict:
    labelled = gate.visibility != NOT_LABELLED
    low, high = gate.corners_px[labelled].min(axis=0), gate.corners_px[labelled].max(axis=0)
    values = []
    for (u, v), visibility in zip(gate.corners_px, gate.visibility, strict=True):
        known = visibility != NOT_LABELLED
        values += [round(float(u), DIGITS), round(float(v), DIGITS), int(visibility)] if known else [0, 0, 0]
    box = [round(float(value), DIGITS) for value in (*low, *(high - low))]
    return {
        "id": number,
        "image_id": image_id,
        "category_id": CATEGORY["id"],
        "keypoints": values,
        "num_keypoints": int(labelled.sum()),
        "bbox": box,
        "area": round(box[2] * box[3], DIGITS),
        "iscrowd": 0,
    }
