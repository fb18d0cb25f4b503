"""Grouping recovers the gates from ideal maps: exact corners, several gates, no incomplete gates."""

from dataclasses import replace

import numpy as np
import pytest
from ideal_maps import LEVEL, SETTINGS, gates_at, maps_of

from swift_ros import configuration, geometry
from swift_ros.camera import model as lens
from swift_ros.perception.corner_grouping import (
    connected_corners,
    edge_scores,
    find_peaks,
    quadrilaterals,
    without_outset,
)
from swift_ros.perception.upright import Panorama, UprightView
from swift_sim_bridge.gate_detector.corner_states import VISIBLE
from swift_sim_bridge.labels import folder


@pytest.fixture(scope="module")
def view(repository):
    return UprightView(configuration.load(lens.Camera, repository / "config/camera.yaml"), Panorama(384, 135.0))


def group(view, maps, panorama=None):
    panorama = panorama or view.panorama
    peaks = find_peaks(maps[:4], SETTINGS)
    scores = edge_scores(peaks, maps[4:], panorama, SETTINGS)
    found = quadrilaterals(peaks, scores, panorama, SETTINGS)
    return [np.stack([peaks[k].points[i] for k, i in enumerate(gate)]) for gate in found], connected_corners(
        scores, SETTINGS
    )


def assert_found(gates, points, wanted):
    assert len(gates) == len(wanted)
    for k in wanted:
        assert min(np.abs(gate - points[k]).max() for gate in gates) < 0.1


TILTED = geometry.quaternion_from_rotation_vector(np.array([0.9, 0.5, 0.3]))


@pytest.mark.parametrize("q_world_body", [LEVEL, TILTED])
@pytest.mark.parametrize("distance", [1.6, 3.0, 7.0, 14.0])
def test_one_gate_is_found_with_errors_below_a_tenth_of_a_pixel(repository, view, q_world_body, distance):
    plates = gates_at(repository, [((distance, 0.2, 0.3), 10.0)])
    maps, points, state = maps_of(view, plates, q_world_body)
    assert (state == VISIBLE).all()
    gates, _ = group(view, maps)
    assert_found(gates, points, [0])


@pytest.mark.parametrize("pitch_deg", [-40.0, 0.0, 35.0])
@pytest.mark.parametrize("roll_deg", [0.0, 50.0])
def test_a_narrow_lens_that_looks_up_or_down_finds_its_gate(repository, pitch_deg, roll_deg):
    camera = replace(folder.pinhole(640, 480, 60.0), pitch_deg=pitch_deg, roll_deg=roll_deg)
    view = UprightView(camera, Panorama(384, 135.0))
    pitch = np.radians(pitch_deg)
    place = (float(7.0 * np.cos(pitch)), 0.3, float(7.0 * np.sin(pitch)))
    maps, points, state = maps_of(view, gates_at(repository, [(place, 15.0)]), LEVEL)
    assert (state == VISIBLE).all()
    panorama = view.panorama_at(geometry.rotation_matrix(camera.q_body_camera))
    assert_found(group(view, maps, panorama)[0], points, [0])


def test_a_gate_looks_the_same_from_behind(repository, view):
    front, back = (maps_of(view, gates_at(repository, [((5.0, 0.0, 0.5), yaw)]), LEVEL) for yaw in (0.0, 180.0))
    assert np.allclose(front[1], back[1])
    assert_found(group(view, back[0])[0], front[1], [0])


def test_a_gate_behind_another_and_one_on_top_are_three_gates(repository, view):
    places = [((3.0, 0.0, 0.0), 0.0), ((9.0, 0.5, 0.2), 20.0), ((3.2, 0.0, 2.7), 0.0)]
    maps, points, state = maps_of(view, gates_at(repository, places), LEVEL)
    assert (state == VISIBLE).all()
    assert_found(group(view, maps)[0], points, [0, 1, 2])


@pytest.mark.parametrize("corner", range(4))
def test_a_gate_with_a_hidden_corner_is_not_reported_and_its_other_corners_are(repository, view, corner):
    plates = gates_at(repository, [((4.0, 0.0, 0.0), 0.0), ((6.0, -4.0, 0.5), -30.0)])
    maps, points, _ = maps_of(view, plates, LEVEL, hide=[(0, corner)])
    gates, kept = group(view, maps)
    assert_found(gates, points, [1])
    assert sum(keep.sum() for keep in kept) == 7


def test_two_gates_above_each_other_are_not_one_tall_gate(repository, view):
    # the inner corners of both are hidden, and the fields connect both gates
    plates = gates_at(repository, [((8.0, 0.0, 2.0), 0.0), ((8.0, 0.0, -0.4), 0.0)])
    hidden = [(0, 2), (0, 3), (1, 0), (1, 1)]
    maps, points, _ = maps_of(view, plates, LEVEL, hide=hidden)
    complete, _, _ = maps_of(view, plates, LEVEL)
    maps[4:] = complete[4:]
    column = [int(points[0, k, 0] / 2) for k in range(2)]
    rows = slice(int(points[0, 3, 1] / 2), int(points[1, 0, 1] / 2))
    maps[7, rows, column[1] - 2 : column[1] + 3] = 1.0
    maps[11, rows, column[0] - 2 : column[0] + 3] = -1.0
    gates, kept = group(view, maps)
    assert gates == [] and all(keep.any() for keep in kept)


def test_the_peaks_are_the_largest_values_of_their_neighbourhoods_inside_of_the_border():
    layer = np.round(np.random.default_rng(4).random((30, 40)), 2).astype(np.float32)  # with equal neighbours
    layer[10:14, 20:24] = 0.995  # a plateau, all of whose inner pixels are peaks
    expected = [
        (layer[row, column], row, column)
        for row in range(1, 29)
        for column in range(1, 39)
        if layer[row, column] > 0.3 and layer[row, column] == layer[row - 1 : row + 2, column - 1 : column + 2].max()
    ]
    settings = replace(SETTINGS, most_peaks=1000)
    found = find_peaks(layer[None], settings)[0]
    best_first = sorted(expected, key=lambda peak: -peak[0])  # equal ones by rows
    assert len(best_first) > 100 and np.array_equal(found.confidence, [peak[0] for peak in best_first])
    pixels = (found.points - 0.5) / 2  # of the map; a vertex is at most half a pixel from its peak
    assert np.abs(pixels - [(column, row) for _, row, column in best_first]).max() <= 0.5 + 1e-9
    few = find_peaks(layer[None], replace(settings, most_peaks=7))[0]
    assert np.array_equal(few.points, found.points[:7])


def test_a_single_peak_is_not_connected(view):
    maps = np.zeros((12, 192, 192), np.float32)
    maps[0, 50, 60] = maps[1, 50, 90] = 0.9
    gates, kept = group(view, maps)
    assert gates == [] and not any(keep.any() for keep in kept)


def test_noise_changes_corners_little_and_adds_no_gates(repository, view):
    rng = np.random.default_rng(4)
    maps, points, _ = maps_of(view, gates_at(repository, [((5.0, 1.0, 0.0), 30.0)]), LEVEL)
    maps[:4] = np.clip(maps[:4] + rng.normal(0, 0.02, maps[:4].shape), 0, 1)
    maps[4:] += rng.normal(0, 0.2, maps[4:].shape)
    gates, _ = group(view, maps.astype(np.float32))
    assert len(gates) == 1 and np.abs(gates[0] - points[0]).max() < 0.5


@pytest.mark.parametrize(("side", "moved"), [(100.0, 0.4), (25.0, 0.4), (12.5, 0.1)])
def test_the_outset_of_a_network_is_taken_from_the_corners_of_large_gates(side, moved):
    true = 50.0 + side / 2 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    corrected = without_outset(true, replace(SETTINGS, corner_outset_px=0.4))
    assert np.allclose(np.linalg.norm(corrected - true, axis=1), moved)
    assert np.allclose(corrected.mean(axis=0), 50.0)
    assert (np.abs(corrected - 50.0) < np.abs(true - 50.0)).all()
    assert np.array_equal(without_outset(true, SETTINGS), true)
