"""Examples of labelled and composed images: planted marks are where the labels say, under every lens and change."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from swift_ros import geometry
from swift_ros.camera.model import project, unproject
from swift_ros.errors import UsageError
from swift_ros.perception.upright import UprightView
from swift_sim_bridge.gate_detector.corner_states import HIDDEN, IGNORED, VISIBLE
from swift_sim_bridge.gate_detector.images.composed import ComposedExamples, random_camera
from swift_sim_bridge.gate_detector.images.labelled import LabelledExamples, completed, mirrored
from swift_sim_bridge.gate_detector.images.sources import Mixture
from swift_sim_bridge.gate_detector.images.targets import HEAT_SIGMA_PX, MOST_HEAT_SIGMA_PX, GateLabels, example_of
from swift_sim_bridge.gate_detector.training.settings import load_settings
from swift_sim_bridge.labels import folder
from swift_sim_bridge.labels.labelled_images import R_WORLD_LEVEL_CAMERA, LabelledGate, LabelledImage

SQUARE = np.array([[250.0, 150.0], [390.0, 155.0], [385.0, 300.0], [255.0, 295.0]])
WARPED = replace(
    folder.pinhole(640, 480, 75.0), cx=330.0, cy=232.0, distortion=(-0.1, 0.02, 0.004, -0.006), pitch_deg=10.0
)
NAN = np.full(2, np.nan)


@pytest.fixture(scope="module")
def settings(repository):
    return load_settings(repository / "config", {})


def gate(visibility=(2, 2, 2, 2), corners=SQUARE) -> LabelledGate:
    visibility = np.array(visibility)
    return LabelledGate(np.where((visibility == 0)[:, None], np.nan, corners), visibility)


def labelled(settings, path, gates, camera=WARPED, **values) -> LabelledExamples:
    """Return the source of one image, dark with a bright mark at each corner of SQUARE."""
    image = np.full((camera.height, camera.width), 40, np.uint8)
    for point in SQUARE:
        cv2.circle(image, tuple(int(16 * value) for value in point), 16 * 3, 255, -1, cv2.LINE_AA, 4)
    cv2.imwrite(str(path / "a.png"), image)
    folder.write(path, [LabelledImage("a.png", camera.width, camera.height, tuple(gates), **values)], camera)
    return LabelledExamples(settings, (folder.read(path),))


def mark_near(panorama, point) -> np.ndarray:
    """Return the centre of the bright mark around a point of a panorama."""
    x, y = (int(round(value)) for value in point)
    patch = panorama[y - 12 : y + 13, x - 12 : x + 13].astype(float)
    patch = np.clip(patch - np.median(patch) - 0.3 * np.ptp(patch), 0, None)
    rows, columns = np.mgrid[y - 12 : y + 13, x - 12 : x + 13]
    return np.array([(patch * columns).sum(), (patch * rows).sum()]) / patch.sum()


def test_labels_stay_at_the_corners_however_an_image_is_turned_scaled_and_mirrored(settings, tmp_path):
    source, rng = labelled(settings, tmp_path, [gate()]), np.random.default_rng(0)
    sides, leans, errors = [], [], []
    for _ in range(40):
        example = source.draw(rng)
        assert (example.state == VISIBLE).all()
        tl, tr, br, bl = example.points[0]
        assert tl[0] < tr[0] and bl[0] < br[0] and tl[1] < bl[1] and tr[1] < br[1]
        errors += [np.linalg.norm(mark_near(example.panorama, point) - point) for point in example.points[0]]
        sides.append(np.linalg.norm(tr - tl))
        leans.append(np.degrees(np.arctan2(*(bl - tl))))
        for k, point in enumerate(example.points[0]):
            x, y = np.rint((point - 0.5) / 2).astype(int)
            assert example.target[y, x, k] > 0.8 and example.mask[y, x, 0] == 1.0
    assert np.median(errors) < 0.3 and max(errors) < 1.2  # a mark is a few pixels wide, with noise
    assert max(sides) > 1.6 * min(sides) and np.ptp(leans) > 4.0


def test_a_mirrored_image_of_a_lens_with_tangential_distortion_is_mirrored_exactly():
    attitude = geometry.rotation_matrix(geometry.quaternion_from_rotation_vector(np.array([0.2, 0.1, -0.3])))
    r_world_camera = attitude @ R_WORLD_LEVEL_CAMERA
    camera, image, turned = mirrored(WARPED, np.arange(480 * 640).reshape(480, 640) % 251, r_world_camera)
    assert np.linalg.det(turned) == pytest.approx(1.0)
    assert np.allclose(turned[2] * [-1, 1, 1], r_world_camera[2])  # gravity is mirrored with the image
    rays = unproject(WARPED, SQUARE)
    assert np.allclose(project(camera, rays * [-1, 1, 1])[0], [639, 0] + SQUARE * [-1, 1], atol=1e-6)
    assert np.array_equal(image[:, ::-1], np.arange(480 * 640).reshape(480, 640) % 251)


def at(maps, point):
    """Return the values of maps (s, s, ...) at a point of the panorama."""
    x, y = np.rint((np.asarray(point) - 0.5) / 2).astype(int)
    return maps[y, x]


def test_occluded_and_unlabelled_corners_are_neither_peak_nor_background(settings, tmp_path):
    source, rng = labelled(settings, tmp_path, [gate((2, 1, 2, 0))]), np.random.default_rng(1)
    for _ in range(10):
        example = source.draw(rng)
        states = sorted(example.state[0])
        assert states == [HIDDEN, VISIBLE, VISIBLE, IGNORED]
        for k, state in enumerate(example.state[0]):
            point = example.points[0, k]
            assert at(example.target, point)[:4].max() == (pytest.approx(1.0, abs=0.2) if state == VISIBLE else 0.0)
            assert at(example.mask, point)[0] == (1.0 if state == VISIBLE else 0.0)
        assert example.target[..., 4:].any() == 0.0  # no edge has two visible ends
        assert example.mask[..., 0].mean() > 0.8  # the rest of the image is background


def test_an_image_with_more_gates_than_labels_counts_near_the_labels_only(settings, tmp_path):
    source, rng = labelled(settings, tmp_path, [gate()], all_gates=False), np.random.default_rng(2)
    for _ in range(10):
        example = source.draw(rng)
        points = example.points[0]
        assert not example.labels.complete
        assert all(at(example.mask, point).all() for point in points)
        assert all(at(example.mask, 0.5 * (points[k] + points[k - 1])).all() for k in range(4))
        assert not at(example.mask, points.mean(axis=0)).any()  # another gate may be behind the opening
        assert not at(example.mask, points[0] - 0.6 * (points[2] - points[0])).any()
        assert example.mask.mean() < 0.3


@pytest.mark.parametrize("seen", ["1100", "0110", "1001", "1010", "0101", "1011"])
def test_missing_corners_of_a_square_are_completed(seen):
    square = np.array([[10.0, 20.0], [50.0, 20.0], [50.0, 60.0], [10.0, 60.0]])
    assert np.allclose(completed(gate([2 * int(one) for one in seen], square).corners_px), square)


def test_the_peak_of_a_large_gate_is_as_wide_as_its_label_is_uncertain(settings):
    view = UprightView(WARPED, settings.panorama)
    widths = []
    for share, scale in ((0.0, 1.0), (0.03, 0.15), (0.03, 1.0), (0.03, 3.0)):
        rays = unproject(WARPED, (SQUARE - SQUARE.mean(axis=0)) * scale + [320.0, 240.0])[None]
        one = np.ones(1)
        labels = GateLabels(rays, np.full((1, 4), VISIBLE), one > 0, 50 * one, 0 * one, one, share)
        example = example_of(view, np.full((480, 640), 9, np.uint8), labels, R_WORLD_LEVEL_CAMERA)
        heat = example.target[..., 0]
        widths.append(np.sqrt(heat.sum() / (2 * np.pi)) if scale < 3.0 else MOST_HEAT_SIGMA_PX)
        assert heat.max() <= 1.0
    assert widths[0] == pytest.approx(HEAT_SIGMA_PX, rel=0.01) and widths[1] == pytest.approx(HEAT_SIGMA_PX, rel=0.01)
    assert HEAT_SIGMA_PX < widths[2] <= MOST_HEAT_SIGMA_PX


def test_gates_that_are_small_in_the_panorama_do_not_count(settings, tmp_path):
    large = folder.pinhole(4000, 3000, 60.0)
    small = [gate(corners=1000.0 + 0.1 * SQUARE)]  # 13 px of the photograph, 2 px of the panorama
    example = labelled(settings, tmp_path, small, large).draw(np.random.default_rng(0))
    assert not example.labels.counts.any() and not (example.state == VISIBLE).any()


def test_a_folder_from_which_nothing_can_be_learned_is_an_error(settings, tmp_path):
    with pytest.raises(UsageError, match="no gate in .* has two labelled corners; label more"):
        labelled(settings, tmp_path, [gate((2, 0, 0, 0))])
    example = labelled(settings, tmp_path, []).draw(np.random.default_rng(0))  # no gate: all of it is background
    assert example.mask.all() and not example.target.any()


def test_random_cameras_image_all_rays_that_their_lens_promises():
    for seed in range(300):
        rng = np.random.default_rng(seed)
        camera = random_camera(rng)
        assert not camera.findings()
        pixels = rng.uniform([0, 0], [camera.width - 1, camera.height - 1], (50, 2))
        rays = unproject(camera, pixels)
        inside = rays[:, 2] > np.cos(camera.half_angle)
        assert inside.sum() > 10 and np.abs(project(camera, rays)[0] - pixels)[inside].max() < 1e-3


class Marks:
    """A composer of one gate, whose corners are bright marks."""

    def compose(self, camera, rng):
        turn = geometry.quaternion_from_rotation_vector(np.array([0.3, 0.2, 0.1]))
        side = 0.2 * camera.half_angle
        corners = np.array([[-side, -side, 1.0], [side, -side, 1.0], [side, side, 1.0], [-side, side, 1.0]])
        image = np.full((camera.height, camera.width), 40, np.uint8)
        pixels = project(camera, corners)[0]
        for point in pixels:
            cv2.circle(image, tuple(int(round(16 * value)) for value in point), 16 * 3, 255, -1, cv2.LINE_AA, 4)
        return SimpleNamespace(
            image=image,
            r_world_camera=geometry.rotation_matrix(turn) @ R_WORLD_LEVEL_CAMERA,
            rays_camera=corners[None],
            state=np.array([[VISIBLE, VISIBLE, HIDDEN, VISIBLE]]),
            side_px=np.array([60.0]),
            oblique_deg=np.array([5.0]),
            distance=np.array([3.0]),
        )


def test_composed_corners_are_at_their_marks_through_any_lens(settings):
    source, rng = ComposedExamples(settings, Marks()), np.random.default_rng(3)
    densities, errors = set(), []
    for _ in range(30):
        example = source.draw(rng)
        assert list(example.state[0]) == [VISIBLE, VISIBLE, HIDDEN, VISIBLE]
        errors += [np.linalg.norm(mark_near(example.panorama, point) - point) for point in example.points[0]]
        assert at(example.mask, example.points[0, 2])[0] == 0.0
        densities.add(example.view.panorama.pixels_per_radian)
    assert np.median(errors) < 0.3 and np.max(errors) < 1.2
    assert len(densities) > 10 and min(densities) == settings.panorama.pixels_per_radian


def test_a_mixture_draws_by_shares_and_one_source_as_if_alone():
    first, second = (SimpleNamespace(draw=lambda rng, name=name: (name, rng.random())) for name in ("a", "b"))
    alone = Mixture([(first, 0.3)])
    assert alone.draw(np.random.default_rng(1))[1] == np.random.default_rng(1).random()
    rng = np.random.default_rng(0)
    names = [Mixture([(first, 0.3), (second, 0.9)]).draw(rng)[0] for _ in range(4000)]
    assert names.count("a") / 4000 == pytest.approx(0.25, abs=0.03)
