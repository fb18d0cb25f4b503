"""Labels of other tools: files as CVAT and COCO tools write them come in, and go out so that they come back."""

import json

import numpy as np
import pytest

from swift_ros import geometry
from swift_ros.errors import UsageError
from swift_sim_bridge.labels import coco, cvat, exchange
from swift_sim_bridge.labels.labelled_images import IMPORTED, LabelledGate, LabelledImage

SQUARE = np.array([[100.0, 50.0], [180.0, 52.0], [182.0, 131.5], [99.25, 130.0]])
# As CVAT 2 exports it: a box without points, a skeleton, a polygon that starts at the lower right corner.
CVAT = """<?xml version="1.0" encoding="utf-8"?>
<annotations>
  <version>1.1</version>
  <meta><task><id>7</id><name>hall</name><labels><label><name>gate</name><type>skeleton</type></label></labels></task></meta>
  <image id="0" name="flight/a.png" subset="default" task_id="7" width="320" height="240">
    <box label="person" source="manual" occluded="0" xtl="1" ytl="2" xbr="3" ybr="4" z_order="0"></box>
    <skeleton label="gate" source="manual" z_order="0">
      <points label="top-right" source="manual" outside="0" occluded="1" points="180.50,52.50"></points>
      <points label="top-left" source="manual" outside="0" occluded="0" points="100.50,50.50"></points>
      <points label="bottom-left" source="manual" outside="1" occluded="0" points="99.75,130.50"></points>
      <points label="bottom-right" source="manual" outside="0" occluded="0" points="182.50,132.00"></points>
    </skeleton>
    <polygon label="gate" source="manual" occluded="0" points="182.5,132;99.75,130.5;100.5,50.5;180.5,52.5" z_order="0">
      <attribute name="colour">orange</attribute>
    </polygon>
    <points label="gate" source="manual" occluded="0" points="182.5,132;99.75,130.5;100.5,50.5" z_order="0"></points>
  </image>
  <image id="1" name="b.png" width="320" height="240">
  </image>
  <image id="2" name="gone.png" width="320" height="240">
  </image>
</annotations>
"""


def bare(name="a.png", **values) -> LabelledImage:
    return LabelledImage(name, 320, 240, **values)


def gate(corners=SQUARE, visibility=(2, 2, 2, 2)) -> LabelledGate:
    return LabelledGate(np.array(corners), np.array(visibility))


def test_a_file_of_cvat_is_read_with_skeletons_polygons_and_what_it_leaves_out(tmp_path):
    (tmp_path / "annotations.xml").write_text(CVAT)
    found, counts = exchange.taken(cvat.read(tmp_path / "annotations.xml"), [bare("a.png"), bare("b.png")], False)
    (image,) = found
    assert image.source == IMPORTED
    skeleton, polygon = image.gates
    assert skeleton.visibility.tolist() == [2, 1, 2, 0]
    assert np.allclose(skeleton.corners_px[:3], SQUARE[:3])
    assert np.allclose(polygon.corners_px, SQUARE)
    assert (counts.gates, counts.by_position, counts.empty_images, counts.missing_images) == (2, 1, 1, 1)
    assert counts.left_out == {"have 3 points instead of 4": 1}
    text = "\n".join(counts.sentences())
    assert "warning: 1 gates have no names of corners" in text and "--empty" in text


def test_images_without_a_gate_are_taken_on_request(tmp_path):
    (tmp_path / "annotations.xml").write_text(CVAT)
    found, counts = exchange.taken(cvat.read(tmp_path / "annotations.xml"), [bare("b.png")], True)
    assert [(image.file_name, image.gates) for image in found] == [("b.png", ())]
    assert counts.empty_images == 0


@pytest.mark.parametrize("suffix", ["json", "xml"])
def test_what_is_exported_comes_back(tmp_path, suffix):
    cut = gate(np.where([[True], [False], [True], [True]], SQUARE, np.nan), (2, 0, 1, 2))
    images = [bare("a.png", gates=(gate(), cut)), bare("below/b.png", gates=(gate(SQUARE + 20.0),))]
    path = tmp_path / f"labels.{suffix}"
    (coco if suffix == "json" else cvat).write(path, images)
    foreign = exchange.read_coco(path) if suffix == "json" else cvat.read(path)
    found, counts = exchange.taken(foreign, [bare("a.png"), bare("below/b.png")], False)
    assert counts.by_position == 0 and not counts.left_out
    for before, after in zip(images, found, strict=True):
        assert before.file_name == after.file_name
        for one, other in zip(before.gates, after.gates, strict=True):
            assert np.allclose(one.corners_px, other.corners_px, atol=0.006, equal_nan=True)
            assert one.visibility.tolist() == other.visibility.tolist()


@pytest.mark.parametrize(
    ("names", "order"),
    [
        (["BL", "BR", "TR", "TL"], [3, 2, 1, 0]),
        (["upperLeft", "lower right", "inner_upper_right", "lower-left"], [0, 2, 1, 3]),
        (["1", "2", "3", "4"], [2, 3, 0, 1]),  # no corner's names: by position
        ([], [1, 0, 3, 2]),
    ],
)
def test_keypoints_of_other_names_and_orders_become_corners(tmp_path, names, order):
    row = {"id": 1, "image_id": 5, "category_id": 9}
    row["keypoints"] = np.column_stack([SQUARE[order], [2] * 4]).ravel().tolist()
    content = {
        "images": [{"id": 5, "file_name": "C:\\data\\a.png", "width": 320, "height": 240}],
        "annotations": [row, {"id": 2, "image_id": 5, "category_id": 9, "bbox": [0, 0, 5, 5]}],
        "categories": [{"id": 9, "name": "window", "keypoints": names}, {"id": 10, "name": "person"}],
    }
    (tmp_path / "coco.json").write_text(json.dumps(content))
    found, counts = exchange.taken(exchange.read_coco(tmp_path / "coco.json"), [bare("a.png")], False)
    assert np.allclose(found[0].gates[0].corners_px, SQUARE)
    assert counts.by_position == (names in ([], ["1", "2", "3", "4"]))


def test_corners_are_named_by_position_in_the_upright_image():
    # the camera is rolled by a quarter turn: the world's up is to the right of the image
    level = exchange.r_world_camera(bare())
    rolled = geometry.rotation_matrix(geometry.quaternion_from_rotation_vector(np.array([0.0, 0.0, np.pi / 2])))
    image = bare(q_world_camera=geometry.quaternion_from_matrix(level @ rolled.T))
    assert exchange.clockwise_from_top_left(SQUARE, bare()).tolist() == [0, 1, 2, 3]
    assert exchange.clockwise_from_top_left(SQUARE, image).tolist() == [1, 2, 3, 0]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("<annotations><image", "not valid XML"),
        ("<annotations><track id='0'/></annotations>", "CVAT for images 1.1"),
        ("<html/>", "CVAT for images 1.1"),
        ("<annotations><image name='a.png' width='x' height='240'/></annotations>", "'a.png' has the size"),
        (CVAT.replace("182.5,132;99.75", "182.5,nan;99.75"), "'flight/a.png' has a shape with the points"),
        (CVAT.replace("182.5,132;99.75,130.5", "182.5;99.75"), "not pairs of numbers"),
    ],
)
def test_a_broken_file_of_cvat_meets_a_sentence(tmp_path, text, sentence):
    (tmp_path / "annotations.xml").write_text(text)
    with pytest.raises(UsageError, match=f"annotations.xml.*{sentence}"):
        cvat.read(tmp_path / "annotations.xml")


def test_images_of_another_size_than_in_the_file_are_refused(tmp_path):
    (tmp_path / "annotations.xml").write_text(CVAT)
    other = LabelledImage("a.png", 640, 480)
    with pytest.raises(UsageError, match="640 x 480 px and 320 x 240 px in the file"):
        exchange.taken(cvat.read(tmp_path / "annotations.xml"), [other], False)
