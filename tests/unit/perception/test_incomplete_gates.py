"""Gates of which two or three corners are seen, from the maps of an ideal network."""

from dataclasses import replace

import numpy as np
import pytest
from ideal_maps import LEVEL, SETTINGS, gates_at, maps_of

from swift_ros import configuration
from swift_ros.camera import model as lens
from swift_ros.perception.corner_grouping import Peaks, edge_scores, find_peaks, quadrilaterals, without_outset
from swift_ros.perception.incomplete_gates import incomplete_gates, seen_corners
from swift_ros.perception.upright import Panorama, UprightView

PLACES = [((4.0, 0.0, 0.0), 0.0), ((6.0, -4.0, 0.5), -30.0)]  # of two gates: position, yaw in degrees
NOT_SEEN = [[0], [1], [2], [3], [0, 1], [1, 2], [2, 3], [0, 3]]
AHEAD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # attitude of a camera along x
SQUARE = 50.0 + 20.0 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


@pytest.fixture(scope="module")
def view(repository):
    return UprightView(configuration.load(lens.Camera, repository / "config/camera.yaml"), Panorama(384, 135.0))


def found(view, maps, usable=None):
    """Return the corners (4, 2) px of the incomplete gates in the panorama; without `usable`, of all unused peaks."""
    peaks = find_peaks(maps[:4], SETTINGS)
    scores = edge_scores(peaks, maps[4:], view.panorama, SETTINGS)
    masks = [np.ones(len(one.points), bool) if usable is None else usable(one.points) for one in peaks]
    for gate in quadrilaterals(peaks, scores, view.panorama, SETTINGS):
        for k, i in enumerate(gate):
            masks[k][i] = False
    return list(zip(*seen_corners(incomplete_gates(scores, masks, SETTINGS), peaks, SETTINGS), strict=True))


@pytest.mark.parametrize("not_seen", NOT_SEEN, ids=str)
def test_the_seen_corners_of_a_gate_beside_a_whole_one_are_found(repository, view, not_seen):
    maps, points, _ = maps_of(view, gates_at(repository, PLACES), LEVEL, hide=[(0, k) for k in not_seen])
    [(corners, confidence)] = found(view, maps)
    seen = [k for k in range(4) if k not in not_seen]
    assert np.abs(corners[seen] - points[0, seen]).max() < 0.1 and (confidence[seen] > 0.3).all()
    assert np.isnan(corners[not_seen]).all() and not confidence[not_seen].any()


@pytest.mark.parametrize("not_seen", [[0, 2], [1, 3], [0, 1, 2]], ids=str)
def test_corners_without_an_edge_between_them_are_no_gate(repository, view, not_seen):
    maps, _, _ = maps_of(view, gates_at(repository, PLACES), LEVEL, hide=[(0, k) for k in not_seen])
    assert found(view, maps) == []


def test_whole_gates_are_not_found_again(repository, view):
    maps, _, _ = maps_of(view, gates_at(repository, PLACES), LEVEL)
    assert found(view, maps) == []


def test_two_incomplete_gates_above_each_other_stay_apart(repository, view):
    plates = gates_at(repository, [((8.0, 0.0, 2.0), 0.0), ((8.0, 0.0, -0.4), 0.0)])
    maps, points, _ = maps_of(view, plates, LEVEL, hide=[(0, 1), (1, 3)])
    gates = sorted((corners for corners, _ in found(view, maps)), key=lambda corners: np.nanmean(corners[:, 1]))
    assert len(gates) == 2
    for gate, true, not_seen in zip(gates, points, (1, 3), strict=True):
        assert np.flatnonzero(np.isnan(gate[:, 0])).tolist() == [not_seen]
        assert np.nanmax(np.abs(gate - true)) < 0.1


def test_corners_at_the_border_are_left_out(repository, view):
    """Of three corners the one that may not be used is left out, and the others remain."""
    maps, points, _ = maps_of(view, gates_at(repository, PLACES[:1]), LEVEL, hide=[(0, 0)])
    [(corners, _)] = found(view, maps, lambda peaks: peaks[:, 0] < points[0, :, 0].mean() + 1e3 * (peaks[:, 1] > 200.0))
    assert np.flatnonzero(np.isfinite(corners[:, 0])).tolist() == [2, 3]


def test_the_distance_from_the_border_is_that_of_image_and_lens(repository):
    """The shipped lens images a circle whose edge is 81.5 degrees from its axis; the other one fills its image."""
    for name, inside, outside in (
        ("camera.yaml", [[81.0, 0.0], [0.0, 81.0], [57.0, 57.0]], [[82.0, 0.0], [60.0, 60.0]]),
        ("cameras/pinhole_100.yaml", [[49.5, 0.0], [0.0, 41.0]], [[50.5, 0.0], [0.0, 42.5]]),
    ):
        camera = configuration.load(lens.Camera, repository / "config" / name)
        view = UprightView(camera, Panorama(384, 135.0))
        for places, sign in ((inside, 1.0), (outside, -1.0)):
            right, down = np.radians(np.array(places)).T
            angle = np.hypot(right, down)
            rays = np.stack([np.sin(angle) * right / angle, np.sin(angle) * down / angle, np.cos(angle)], axis=-1)
            distance = view.border_px(view.from_rays(rays, AHEAD), AHEAD)
            assert (sign * distance > 0.0).all() and (np.abs(distance) < 12.0).all(), name


@pytest.mark.parametrize("not_seen", NOT_SEEN, ids=str)
def test_the_outset_of_the_network_is_removed_as_from_a_whole_gate(not_seen):
    settings = replace(SETTINGS, corner_outset_px=0.4)
    peaks = [Peaks(SQUARE[k : k + 1], np.ones(1)) for k in range(4)]
    seen = [k for k in range(4) if k not in not_seen]
    [corners], _ = seen_corners([dict.fromkeys(seen, 0)], peaks, settings)
    assert np.allclose(corners[seen], without_outset(SQUARE, settings)[seen])
