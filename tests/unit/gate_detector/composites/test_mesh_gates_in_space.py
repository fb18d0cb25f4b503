"""Gates of triangles in composites: what the lens shows of them is where geometry puts it, and so are their labels."""

import cv2
import numpy as np
import pytest
import trimesh
from composite_examples import CAMERAS, CLEAN, black, looks
from gate_meshes import DEPTH, INNER, box, frame
from PIL import Image

from swift_ros.camera import model as lens
from swift_sim_bridge.gate_detector.corner_states import HIDDEN, VISIBLE
from swift_sim_bridge.gate_detector.images.composites import exposure, own, paint, pictures, scenes
from swift_sim_bridge.gate_detector.images.composites.composer import Composer
from swift_sim_bridge.gate_detector.images.composites.panels import View
from swift_sim_bridge.gate_detector.images.own_gates import opening
from swift_sim_bridge.labels.labelled_images import R_WORLD_LEVEL_CAMERA

WHITE, BLACK = (255, 255, 255, 255), (0, 0, 0, 255)
AHEAD = (4.0, 0.3, 0.2)  # m, centre of the opening in the world of a camera that looks along x


@pytest.fixture
def unshaded(monkeypatch):
    monkeypatch.setattr(scenes, "with_shadow", lambda picture, rng: picture)
    monkeypatch.setattr(own, "SHADE", (1.0, 1.0))


def painted(mesh: trimesh.Trimesh, white) -> trimesh.Trimesh:
    """Return a mesh whose faces are white where `white` (n,) is set, and black elsewhere."""
    mesh.visual.face_colors = np.where(np.asarray(white)[:, None], WHITE, BLACK).astype(np.uint8)
    return mesh


def read(folder, mesh: trimesh.Trimesh) -> opening.MeshGate:
    mesh.export(str(folder / "gate.ply"))
    return opening.read(folder / "gate.ply")


def axes(turn_deg: float) -> np.ndarray:
    """Return right, down and away (3, 3) of a gate whose passage is turned to the left from the x axis of the world."""
    turn = np.radians(turn_deg)
    right = np.array([np.sin(turn), -np.cos(turn), 0.0])
    return np.stack([right, (0.0, 0.0, -1.0), np.cross(right, (0.0, 0.0, -1.0))])


def standing(gate: opening.MeshGate, turn_deg: float, centre=AHEAD):
    """Return a gate with its opening at a place, turned by an angle."""
    place = own.Place(np.array(centre), INNER, 300.0 * INNER / float(np.linalg.norm(centre)))
    rng = np.random.default_rng(0)
    return own.of_mesh(gate, place, axes(turn_deg)[:2], paint.Paints(rng), rng)


def image_of(body, name: str) -> np.ndarray:
    """Return the image (H, W) of a body on black through a lens, of which the brightest pixel is 1."""
    view = View(CAMERAS[name], R_WORLD_LEVEL_CAMERA)
    image = np.zeros(view.rays.shape[:2], np.float32)
    for panel in body.panels:
        view.draw(image, panel)
    return image / max(float(image.max()), 1e-3)


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("turn_deg", [-60.0, -20.0, 45.0])
@pytest.mark.parametrize("before", [-0.6, 0.8], ids=["behind the frame", "before the frame"])
def test_a_ball_above_a_gate_is_seen_where_its_centre_projects(tmp_path, unshaded, name, turn_deg, before):
    ball = trimesh.creation.icosphere(3, radius=0.06)
    away = DEPTH / 2 - before  # from the middle of the frame
    ball.apply_translation((0.3, away - DEPTH / 2, 1.6))
    gate = frame()
    mesh = painted(
        trimesh.util.concatenate([gate, ball]), np.arange(len(gate.faces) + len(ball.faces)) >= len(gate.faces)
    )
    image = image_of(standing(read(tmp_path, mesh), turn_deg), name)
    offset = np.array([0.3, -1.6, away])  # right, down, away from the centre in the plane of the rim
    centre = np.array(AHEAD) + offset @ axes(turn_deg)
    rows, columns = np.nonzero(image > 0.2)
    weights = image[rows, columns]
    found = np.array([weights @ columns, weights @ rows]) / weights.sum()
    expected, _ = View(CAMERAS[name], R_WORLD_LEVEL_CAMERA).project(centre)
    assert np.linalg.norm(found - expected) < 0.35


def test_the_labels_of_a_composed_image_are_the_corners_of_its_front(tmp_path, unshaded, monkeypatch):
    gate = frame()
    front = np.abs(gate.face_normals[:, 1]) > 0.5  # sides black as the background: the edges of the front stand out
    given = pictures.Pictures(own_gates=(read(tmp_path, painted(gate, front)),))
    monkeypatch.setitem(scenes.DRAW, "plain", black)
    monkeypatch.setattr(exposure, "toned", lambda image, looks, rng: 0.8 * np.minimum(image, 1.0))
    chosen = CLEAN | {"gates": (1, 1), "own_gate_share": 1.0, "side_share": (0.25, 0.4), "most_oblique_deg": 60.0}
    composer, errors = Composer(looks(**chosen), given), []
    for k in range(40):
        one = composer.compose(CAMERAS["kannala_brandt"], np.random.default_rng(k))
        assert one.families == ("own",)
        for corner in lens.project(CAMERAS["kannala_brandt"], one.rays_camera)[0][one.state == VISIBLE]:
            start = np.float32(corner).reshape(1, 1, 2)
            found = cv2.cornerSubPix(one.image, start, (4, 4), (-1, -1), (3, 100, 1e-4))
            errors.append(np.linalg.norm(found.ravel() - corner))
    assert len(errors) > 60
    assert np.quantile(errors, 0.9) < 0.5
    assert max(errors) < 1.2  # where a post or a marker touches the corner


def test_the_near_post_hides_the_faces_behind_it(tmp_path, unshaded):
    gate = frame()
    gate = read(tmp_path, painted(gate, np.abs(gate.face_normals[:, 1]) < 0.5))  # sides white, front and back black
    seen = [image_of(standing(gate, turn, (4.0, 0.0, 0.0)), "pinhole") > 0.5 for turn in (50.0, -50.0)]
    for turned, side in zip(seen, (-1.0, 1.0), strict=True):
        row = turned[180]  # the horizon, through the middle of both posts
        starts = np.flatnonzero(np.diff(row.astype(int)) == 1)
        assert len(starts) == 2  # the outer side of the near post, and the inner side of the far one
        near = starts[0] if side < 0 else starts[1]
        assert (near < 240) == (side < 0)


def test_a_part_of_the_gate_that_stands_before_a_corner_hides_it(tmp_path):
    visor = box((-1.05, -0.9, 0.3), (-0.8, -0.8, 1.05))  # 0.7 m before the upper left corner, and beside the opening
    gate = read(tmp_path, trimesh.util.concatenate([frame(), visor]))
    states = {turn: standing(gate, turn, (4.0, 0.0, 0.0)).states[0].tolist() for turn in (-40, -25, 0, 25, 40)}
    free = [VISIBLE] * 4  # the depth of the frame itself hides no corner of its front
    hidden = [HIDDEN, VISIBLE, VISIBLE, VISIBLE]
    assert sorted(states.values()) == sorted([hidden, *[free] * 4])
    assert hidden in (states[-25], states[25])
    assert (standing(gate.turned(), 25.0).states == VISIBLE).all()


def test_the_size_of_the_file_s_unit_changes_no_pixel_by_much(tmp_path, unshaded):
    first = image_of(standing(read(tmp_path, frame()), 40.0), "kannala_brandt")
    second = image_of(standing(read(tmp_path, frame().apply_scale(1000.0)), 40.0), "kannala_brandt")
    assert first.max() > 0.0
    np.testing.assert_allclose(first, second, atol=0.02)


@pytest.mark.parametrize("away, turn_deg", [(0.5, 85.0), (0.4, 0.0), (0.4, 70.0), (60.0, 30.0)])
def test_gates_at_the_camera_and_far_away_are_drawn(tmp_path, away, turn_deg):
    body = standing(read(tmp_path, frame()), turn_deg, (away, 0.0, 0.1))
    assert np.isfinite(image_of(body, "kannala_brandt")).all()
    assert all(max(panel.picture.shape) < 1000 for panel in body.panels)
    assert np.isfinite(body.openings).all() and body.openings.shape == (1, 4, 3)


def test_a_texture_is_seen_where_its_coordinates_put_it(tmp_path, unshaded):
    gate = frame()
    quadrants = Image.fromarray(np.array([[[0] * 3, [255] * 3], [[255] * 3, [0] * 3]], np.uint8))
    gate.visual = trimesh.visual.TextureVisuals(uv=gate.vertices[:, [0, 2]] / 2.1 + 0.5, image=quadrants)
    gate.export(str(tmp_path / "gate.obj"))
    body = standing(opening.read(tmp_path / "gate.obj"), 30.0)
    view, image = View(CAMERAS["pinhole"], R_WORLD_LEVEL_CAMERA), image_of(body, "pinhole")
    for right, down, level in ((-0.9, -0.9, 0.0), (0.9, -0.9, 1.0), (0.9, 0.9, 0.0), (-0.9, 0.9, 1.0)):
        x, y = np.rint(view.project(np.array(AHEAD) + np.array([right, down, 0.0]) @ axes(30.0))[0]).astype(int)
        assert (image[y, x] > 0.3) == level
