"""Pictures of the user in composites: photographs as backgrounds, own gates, and files that cannot be used."""

import cv2
import numpy as np
import pytest
from composite_examples import CAMERAS, ONE_GATE, black, looks

from swift_ros.camera import model as lens
from swift_ros.errors import UsageError
from swift_sim_bridge.gate_detector.corner_states import VISIBLE
from swift_sim_bridge.gate_detector.images.composites import exposure, pictures, scenes
from swift_sim_bridge.gate_detector.images.composites.composer import Composer
from swift_sim_bridge.gate_detector.images.own_gates import files


def own_gate(opening=(40, 30, 160, 130)) -> np.ndarray:
    """Return the picture (h, w, 4) of a white gate with a transparent opening."""
    picture = np.full((180, 200, 4), 255, np.uint8)
    x0, y0, x1, y1 = opening
    picture[y0:y1, x0:x1, 3] = 0
    return picture


def save(path, picture):
    assert cv2.imwrite(str(path), picture)
    return path


def test_the_corners_of_an_own_gate_are_those_of_its_opening(tmp_path, monkeypatch):
    save(tmp_path / "mine.png", own_gate())
    given = pictures.Pictures(own_gates=files.read(tmp_path, bar=0.2))
    assert given.own_gates[0].opening == (40, 30, 160, 130)
    monkeypatch.setitem(scenes.DRAW, "plain", black)
    monkeypatch.setattr(scenes, "with_shadow", lambda picture, rng: picture)
    monkeypatch.setattr(exposure, "toned", lambda image, looks, rng: 0.8 * np.minimum(image, 1.0))
    camera = CAMERAS["kannala_brandt"]
    chosen = looks(**ONE_GATE | {"own_gate_share": 1.0, "side_share": (0.25, 0.4), "most_oblique_deg": 40.0})
    composer, errors = Composer(chosen, given), []
    for k in range(30):
        one = composer.compose(camera, np.random.default_rng(k))
        assert one.families == ("own",)
        for corner in lens.project(camera, one.rays_camera)[0][one.state == VISIBLE]:
            start = np.float32(corner).reshape(1, 1, 2)
            found = cv2.cornerSubPix(one.image, start, (4, 4), (-1, -1), (3, 100, 1e-4))
            errors.append(np.linalg.norm(found.ravel() - corner))
    assert len(errors) > 30
    assert np.quantile(errors, 0.95) < 0.5
    assert max(errors) < 1.0  # where an object touches the corner


def test_photographs_are_backgrounds(tmp_path):
    (tmp_path / "below").mkdir()
    stripes = np.zeros((300, 400, 3), np.uint8)
    stripes[:, ::2] = 255
    save(tmp_path / "below" / "a.jpg", stripes)
    given = pictures.read(photographs=tmp_path)
    composer = Composer(looks(photograph_share=1.0, negative_share=1.0, clutter=(0, 0)), given)
    one = composer.compose(CAMERAS["pinhole"], np.random.default_rng(0))
    assert one.scene == "photograph"
    assert one.state.shape == (0, 4) and one.rays_camera.shape == (0, 4, 3)


@pytest.mark.parametrize(
    "name, content, sentence",
    [
        ("a.png", b"no picture", "a.png is not a readable picture; restore it"),
        ("a.png", np.zeros((50, 50, 3), np.uint8), "a.png has no transparency; erase the opening"),
        ("a.png", np.full((50, 50, 4), 255, np.uint8), "a.png has no transparent opening inside the frame"),
        ("a.png", own_gate((0, 0, 100, 100)), "a.png has no transparent opening inside the frame"),
    ],
)
def test_a_picture_that_shows_no_gate_meets_a_sentence(tmp_path, name, content, sentence):
    if isinstance(content, bytes):
        (tmp_path / name).write_bytes(content)
    else:
        save(tmp_path / name, content)
    with pytest.raises(UsageError, match=sentence):
        files.read(tmp_path, bar=0.2)


def test_damaged_photographs_and_empty_folders_meet_a_sentence(tmp_path):
    with pytest.raises(UsageError, match="holds no image"):
        pictures.read(photographs=tmp_path)
    with pytest.raises(UsageError, match="is not a folder"):
        pictures.read(photographs=tmp_path / "absent")
    (tmp_path / "b.jpg").write_bytes(b"\xff\xd8 cut off")
    with pytest.raises(UsageError, match="b.jpg is not a readable picture"):
        pictures.read(photographs=tmp_path)
