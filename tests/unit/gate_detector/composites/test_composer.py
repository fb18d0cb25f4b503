"""Composites: their labels are exact, and their looks are as wide as the settings say."""

from collections import Counter

import cv2
import numpy as np
import pytest
from composite_examples import CAMERAS, CLEAN, ONE_GATE, black, looks, white

from swift_ros import configuration
from swift_ros.camera import model as lens
from swift_ros.errors import UsageError
from swift_sim_bridge.gate_detector.corner_states import HIDDEN, VISIBLE
from swift_sim_bridge.gate_detector.images.composites import exposure, objects, pictures, scenes, surfaces
from swift_sim_bridge.gate_detector.images.composites.composer import Composer
from swift_sim_bridge.gate_detector.images.composites.looks import FAMILIES
from swift_sim_bridge.gate_detector.images.composites.panels import opaque, upright_panel

MAX_ERROR_PX = 0.7
MEDIAN_ERROR_PX = 0.3  # cornerSubPix finds a right angle of an slightly blurred image 0.19 px inside
DRAWS = 200  # images from which shares are counted


@pytest.fixture
def white_on_black(monkeypatch):
    monkeypatch.setitem(scenes.DRAW, "plain", black)
    monkeypatch.setattr(surfaces, "painted", white)
    monkeypatch.setattr(scenes, "with_shadow", lambda picture, rng: picture)
    monkeypatch.setattr(exposure, "toned", lambda image, looks, rng: 0.8 * np.minimum(image, 1.0))


def drawn(camera, count, seed=0, **changed):
    """Return so many compositions of a camera."""
    composer = Composer(looks(**changed), pictures.Pictures())
    return [composer.compose(camera, np.random.default_rng([seed, k])) for k in range(count)]


def corner_errors(camera, composition) -> list[float]:
    """Return the distances px between visible labels and the corners that cornerSubPix finds in the image.

    Left out is what it cannot measure: small, oblique and acute corners, and those at the edge of a wide lens.
    """
    pixels, theta = lens.project(camera, composition.rays_camera)
    usable = (composition.state == VISIBLE) & (composition.side_px > 50)[:, None]
    usable &= (composition.oblique_deg < 40)[:, None] & (right_angled(pixels) < 20)
    usable &= (lens.inside_px(camera, pixels) > 30) & (theta < 0.85 * camera.half_angle)
    errors = []
    for corner in pixels[usable]:
        start = np.float32(corner).reshape(1, 1, 2)
        found = cv2.cornerSubPix(composition.image, start, (4, 4), (-1, -1), (3, 100, 1e-4))
        errors.append(float(np.linalg.norm(found.ravel() - corner)))
    return errors


def right_angled(pixels):
    """Return by how many degrees the angles (n, 4) at the corners (n, 4, 2) differ from a right angle."""
    ahead, back = np.roll(pixels, -1, axis=1) - pixels, np.roll(pixels, 1, axis=1) - pixels
    cosine = np.sum(ahead * back, axis=-1) / np.linalg.norm(ahead, axis=-1) / np.linalg.norm(back, axis=-1)
    return np.abs(90 - np.degrees(np.arccos(cosine)))


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("skew", [0.0, 8.0], ids=["still", "rolling shutter"])
def test_corners_in_the_image_lie_at_their_labels_through_each_lens(name, skew, white_on_black):
    chosen = ONE_GATE | {"side_share": (0.2, 0.4), "bar": (0.25, 0.3), "rolling_px": skew}
    errors = [error for one in drawn(CAMERAS[name], 40, **chosen) for error in corner_errors(CAMERAS[name], one)]
    assert len(errors) > 25
    assert max(errors) < MAX_ERROR_PX
    assert np.median(errors) < MEDIAN_ERROR_PX


def test_corners_have_the_order_as_seen_with_gravity_down():
    for one in drawn(CAMERAS["kannala_brandt"], 40, **CLEAN | {"tilt_deg": 3.0}):
        tl, tr, br, bl = np.moveaxis(one.rays_camera @ one.r_world_camera.T, 1, 0)
        assert (tl[:, 2] > bl[:, 2]).all() and (tr[:, 2] > br[:, 2]).all()
        clockwise = np.cross(tl, tr)[:, 2]  # the right corner is to the right of the left one
        assert (clockwise < 0).all()


def test_a_board_before_a_corner_hides_it_and_one_at_its_edge_makes_it_ignored(monkeypatch, white_on_black):
    chosen = ONE_GATE | {"side_share": (0.25, 0.4), "tilt_deg": 0.0, "most_oblique_deg": 5.0}
    camera, states = CAMERAS["pinhole"], Counter()

    def board_before(count, room, aims, *others):
        """Return a board that covers the half of the gate to the left of its middle."""
        azimuth, away = np.arctan2(aims[0][1], aims[0][0]), 0.8 * np.hypot(*aims[0][:2])
        left = np.array([-np.sin(azimuth), np.cos(azimuth)])
        middle = away * np.array([np.cos(azimuth), np.sin(azimuth)]) + 20.0 * left
        panel = upright_panel((*middle, 0.0), azimuth, (40.0, 40.0), opaque(np.full((8, 8), 0.5)))
        return [objects.Body(away, (panel,), panel)]

    free = drawn(camera, 30, **chosen)
    monkeypatch.setattr(objects, "clutter", board_before)
    for before, behind in zip(free, drawn(camera, 30, **chosen), strict=True):
        right = before.state[:, [1, 2]] == behind.state[:, [1, 2]]
        assert right.all()
        states.update(behind.state[:, [0, 3]][before.state[:, [0, 3]] == VISIBLE].tolist())
    assert states[HIDDEN] > 20
    assert states[VISIBLE] == 0


def test_corners_outside_of_the_image_or_its_circle_are_hidden():
    for name in ("pinhole", "image circle"):
        camera = CAMERAS[name]
        outside = inside = 0
        for one in drawn(camera, 40, **CLEAN | {"side_share": (0.4, 1.2)}):
            pixels, theta = lens.project(camera, one.rays_camera)
            beyond = (lens.inside_px(camera, pixels) < -3) | (theta > camera.half_angle + 3 / camera.fx)
            assert (one.state[beyond] == HIDDEN).all()
            outside, inside = outside + beyond.sum(), inside + (one.state == VISIBLE).sum()
        assert outside > 20 and inside > 20


def test_nothing_is_visible_in_an_overexposed_image(monkeypatch):
    monkeypatch.setattr(exposure, "toned", lambda image, looks, rng: np.ones_like(image))
    for one in drawn(CAMERAS["pinhole"], 10, negative_share=0.0):
        assert not (one.state == VISIBLE).any()


@pytest.fixture(scope="module")
def many():
    return drawn(CAMERAS["kannala_brandt"], DRAWS, seed=5, photograph_share=0.0)


def test_every_family_and_scene_is_drawn(many):
    families = Counter(family for one in many for family in one.families)
    assert set(families) == set(FAMILIES)
    assert min(families.values()) > 0.03 * families.total()
    assert {one.scene for one in many} == set(scenes.DRAW)


def test_frames_are_as_often_darker_as_brighter_than_their_openings(many):
    camera, brighter = CAMERAS["kannala_brandt"], []
    for one in many:
        pixels, _ = lens.project(camera, one.rays_camera)
        for gate, state in zip(pixels, one.state, strict=True):
            if (state != VISIBLE).any():
                continue
            middle = gate.mean(axis=0)
            sides = (gate + np.roll(gate, -1, axis=0)) / 2
            steps = [sides + share * (sides - middle) for share in (0.05, -0.05)]
            frame, opening = (
                one.image[np.rint(p[:, 1]).astype(int).clip(0, 359), np.rint(p[:, 0]).astype(int).clip(0, 479)]
                for p in steps
            )
            brighter.append(frame.mean() > opening.mean())
    assert len(brighter) > 60
    assert 0.25 < np.mean(brighter) < 0.75


def test_some_images_show_no_gate(many):
    without = sum(len(one.state) == 0 for one in many)
    assert 0.02 * DRAWS < without < 0.2 * DRAWS


def test_the_same_generator_draws_the_same_image():
    first, second = (drawn(CAMERAS["double_sphere"], 3, seed=9)[2] for _ in range(2))
    np.testing.assert_array_equal(first.image, second.image)
    np.testing.assert_array_equal(first.rays_camera, second.rays_camera)


def test_settings_that_name_no_family_or_an_absent_one_meet_a_sentence():
    with pytest.raises(UsageError, match="'families' names none; list one or more of bars"):
        looks(families=[])
    with pytest.raises(UsageError, match="'scenes' must be one of hall, .* not 'moon'"):
        looks(scenes=["moon"])
    with pytest.raises(UsageError, match="'bar' must rise"):
        looks(bar=[0.4, 0.1])
    assert configuration.content(looks())["tilt_deg"] == 4.0
