"""Gates of labelled photographs: rectified, they are the picture that was photographed."""

import cv2
import numpy as np
import pytest
from composite_examples import CAMERAS

from swift_ros.errors import UsageError
from swift_sim_bridge.gate_detector.images.composites.panels import Panel, View, with_opacity
from swift_sim_bridge.gate_detector.images.own_gates import files, photographs
from swift_sim_bridge.labels import folder
from swift_sim_bridge.labels.labelled_images import OCCLUDED, R_WORLD_LEVEL_CAMERA, VISIBLE, LabelledGate, LabelledImage

BAR, SIDE_PX = 0.2, 100  # of the planted gate: width in sides of the opening, side in its picture
MARGIN = int(BAR * SIDE_PX)
WHOLE = SIDE_PX + 2 * MARGIN


def planted() -> np.ndarray:
    """Return the brightness (h, w) of a frame with smooth, different sides around an opening."""
    x, y = np.meshgrid(np.linspace(0, 1, WHOLE), np.linspace(0, 1, WHOLE))
    tone = 0.2 + 0.3 * x + 0.4 * y * (1 - x)
    tone[:MARGIN, : WHOLE // 2] = 0.9
    return tone.astype(np.float32)


def photographed(path, name: str, turn_deg: float = 35.0, away: float = 2.0, visibility=(VISIBLE,) * 4):
    """Write a labelled folder with the image of the planted gate, 1 m high inside; return its corners (4, 2) px."""
    opacity = np.ones((WHOLE, WHOLE), np.float32)
    opacity[MARGIN:-MARGIN, MARGIN:-MARGIN] = 0
    turn, size = np.radians(turn_deg), WHOLE / SIDE_PX
    right = np.array([np.sin(turn), -np.cos(turn), 0.0])
    panel = Panel(
        np.array([away, 0.1, 0.05]), right, np.array([0, 0, -1.0]), (size, size), with_opacity(planted(), opacity)
    )
    camera = CAMERAS[name]
    view = View(camera, R_WORLD_LEVEL_CAMERA)
    image = np.full(view.rays.shape[:2], 0.05, np.float32)
    view.draw(image, panel)
    path.mkdir(exist_ok=True)
    cv2.imwrite(str(path / "a.png"), np.rint(255 * image).astype(np.uint8))
    corners, _ = view.project(panel.at([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]))
    gate = LabelledGate(corners, np.array(visibility))
    folder.write(path, [LabelledImage("a.png", camera.width, camera.height, (gate,))], camera)
    return corners


@pytest.mark.parametrize("name", CAMERAS)
def test_a_photographed_gate_gives_back_its_picture_through_each_lens(tmp_path, name):
    photographed(tmp_path / "photographs", name, away=CAMERAS[name].fx / 150)
    (gate,) = files.read(tmp_path, BAR)
    x0, y0, x1, y1 = gate.opening
    assert x1 - x0 == y1 - y0 and x0 == y0 == round(BAR * (x1 - x0))
    assert (gate.picture[y0:y1, x0:x1, 3] == 0).all()
    assert np.count_nonzero(gate.picture[..., 3]) == gate.picture[..., 3].size - (x1 - x0) * (y1 - y0)
    expected = 255 * cv2.resize(planted(), gate.picture.shape[1::-1], interpolation=cv2.INTER_AREA)
    on_frame = cv2.erode(gate.picture[..., 3], np.ones((5, 5))) > 0  # not its edges, which are blurred
    on_frame[[0, 1, 2, -1, -2, -3]] = on_frame[:, [0, 1, 2, -1, -2, -3]] = False
    errors = np.abs(gate.picture[..., 1] - expected)[on_frame]
    assert np.median(errors) < 2.0 and np.quantile(errors, 0.95) < 8.0  # levels


def test_a_frame_without_camera_yaml_takes_the_field_of_view(tmp_path):
    photographed(tmp_path, "pinhole")
    (tmp_path / folder.CAMERA).unlink()
    with pytest.raises(UsageError, match="holds no camera.yaml; .*--fov-deg"):
        files.read(tmp_path, BAR)
    assert len(files.read(tmp_path, BAR, fov_deg=77.3)) == 1


@pytest.mark.parametrize(
    "changes",
    [
        {"away": 8.0},
        {"turn_deg": 80.0},
        {"visibility": (VISIBLE, OCCLUDED, VISIBLE, VISIBLE)},
        {"away": 1.1, "turn_deg": 0.0},
    ],
    ids=["far", "oblique", "occluded", "frame outside of the image"],
)
def test_a_folder_without_a_gate_that_is_whole_and_large_meets_a_sentence(tmp_path, changes):
    photographed(tmp_path, "pinhole", **changes)
    with pytest.raises(UsageError, match=r"labels.json has no gate with four visible corners, sides of at least 60 px"):
        files.read(tmp_path, BAR)


def test_a_damaged_photograph_meets_a_sentence(tmp_path):
    photographed(tmp_path, "pinhole")
    (tmp_path / "a.png").write_bytes(b"cut off")
    with pytest.raises(UsageError, match="a.png is not a readable image; restore it"):
        files.read(tmp_path, BAR)


def test_the_frame_is_as_wide_as_that_of_the_track(tmp_path):
    corners = photographed(tmp_path, "pinhole", turn_deg=0.0)
    image = cv2.imread(str(tmp_path / "a.png"))
    for bar in (0.1, 0.2):
        gate = photographs.frontal(image, CAMERAS["pinhole"], corners, bar)
        side = gate.opening[2] - gate.opening[0]
        assert gate.picture.shape[0] == side + 2 * round(bar * side)
