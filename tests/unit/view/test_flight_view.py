"""A flight with known places, rates and corners is saved for the Rerun viewer; they are read back from the file."""

import shutil

import cv2
import numpy as np
import pytest
from one_gate_flight import (
    CORNERS,
    DEVIATION_M,
    DRIFT_M,
    FORCE,
    GREY_LEVEL,
    INCOMPLETE,
    INCOMPLETE_EDGES,
    LATENCY_NS,
    LEVEL,
    RATE,
    SECONDS,
    SPEED,
    THRUST,
    write,
)
from rerun_file import RerunFile

from swift_ros import cli, geometry
from swift_ros.camera.model import Camera
from swift_ros.recording import bags
from swift_ros.track import Track

pytest.importorskip("rerun", reason="needs Rerun: make view")

TICKS, IMAGES = round(100 * SECONDS), round(10 * SECONDS)


def saved(path, out, *options) -> RerunFile:
    """Return what `swiftros view --save` writes of a path."""
    assert cli.main(["view", str(path), "--save", str(out), *options]) == 0
    return RerunFile(out)


@pytest.fixture(scope="module")
def flown(tmp_path_factory, repository):
    return write(tmp_path_factory.mktemp("flown"), repository / "config")


@pytest.fixture(scope="module")
def shown(flown):
    return saved(flown, flown / "view.rrd")


def test_commands_and_measurements_are_curves_over_the_time_since_the_start(shown):
    for entity, value in (
        ("thrust/command", THRUST),
        ("thrust/measured", FORCE),
        ("body_rates/x/gyro", RATE[0]),
        ("body_rates/y/gyro", RATE[1]),
        ("body_rates/z/command", 0.0),
        ("speed/truth", SPEED),
        ("error/position", DRIFT_M),
        ("error/deviation", np.sqrt(3) * DEVIATION_M),
    ):
        t, values = shown.curve(entity)
        assert t == pytest.approx(0.01 * np.arange(TICKS), abs=1e-9), entity
        assert values == pytest.approx(np.full((TICKS, 1), value)), entity


def test_the_vehicle_and_its_estimate_are_where_they_were(shown):
    for entity, drift in (("map/vehicle", 0.0), ("map/estimate", DRIFT_M)):
        t, places = shown.column(entity, "Transform3D:translation")
        assert len(t) == TICKS
        at = int(np.argmin(np.abs(t - 1.5)))
        assert places[at][0] == pytest.approx([-3.0 + 1.5 * SPEED, drift, 2.0], abs=1e-5)
    _, sizes = shown.column("map/uncertainty", "Ellipsoids3D:half_sizes")
    assert sizes[0][0] == pytest.approx(3 * [3 * DEVIATION_M], rel=1e-5)


def test_the_pieces_of_a_path_join_and_reach_its_end(shown):
    _, pieces = shown.column("map/path/truth", "LineStrips3D:strips")
    pieces = [np.array(piece[0]) for piece in pieces]
    assert all(first[-1] == pytest.approx(second[0]) for first, second in zip(pieces[:-1], pieces[1:], strict=True))
    assert pieces[0][0] == pytest.approx([-3.0, 0.0, 2.0]) and pieces[-1][-1][0] > -3.0 + SPEED * (SECONDS - 0.15)


def test_the_image_is_the_recorded_one_and_much_smaller(shown):
    t, images = shown.column("camera/image", "EncodedImage:blob")
    assert len(t) == IMAGES
    data = np.array(images[3][0], np.uint8)
    decoded = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
    assert np.abs(decoded.astype(int) - GREY_LEVEL).max() <= 2
    assert len(data) < 0.2 * decoded.size


def test_detected_corners_and_the_matched_gate_are_where_an_independent_projection_places_them(shown, flown):
    _, corners = shown.column("camera/image/corners", "Points2D:positions")
    assert np.array(corners[0]) == pytest.approx(CORNERS + 0.5)
    camera, track = (
        bags.stored_record(flown / "bag", kind, name) for kind, name in ((Camera, "camera.yaml"), (Track, "track.yaml"))
    )
    p_camera = np.array([-3.0, DRIFT_M, 2.0]) + geometry.rotate(LEVEL, camera.p_body_camera)
    turn = geometry.rotation_matrix(camera.q_body_camera).T
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    places = (track.corners[0] - p_camera) @ turn.T
    pixels, _ = cv2.fisheye.projectPoints(places[None], np.zeros(3), np.zeros(3), matrix, np.array(camera.distortion))
    for entity in ("camera/image/matched_gates", "camera/image/map_gates"):
        _, lines = shown.column(entity, "LineStrips2D:strips")
        starts = np.array([line[0] for line in lines[0]])
        assert starts == pytest.approx(pixels[0] + 0.5, abs=0.05), entity


def test_the_seen_corners_of_incomplete_gates_are_shown_and_joined_where_they_are_neighbours(shown):
    t, corners = shown.column("camera/image/incomplete_gates", "Points2D:positions")
    assert len(t) == IMAGES
    assert np.array(corners[0]) == pytest.approx(INCOMPLETE[np.isfinite(INCOMPLETE)].reshape(-1, 2) + 0.5)
    _, edges = shown.column("camera/image/incomplete_gates/edges", "LineStrips2D:strips")
    assert np.array(edges[0]) == pytest.approx(np.array(INCOMPLETE_EDGES) + 0.5)
    _, edges = shown.column("camera/image/corners/edges", "LineStrips2D:strips")
    assert np.array(edges[0])[:, 0] == pytest.approx(CORNERS + 0.5) and len(edges[0]) == 4
    (blue,), (green,) = (
        shown.column(f"camera/image/{gates}", "Points2D:colors")[1][0] for gates in ("incomplete_gates", "corners")
    )
    assert blue != green


def test_gates_podium_texts_and_states_are_there(shown):
    _, bars = shown.column("map/track/gates", "Boxes3D:half_sizes")
    assert len(bars[0]) == 4
    _, places = shown.column("map/track/gates", "Boxes3D:centers")
    assert np.mean(places[0], axis=0) == pytest.approx([4.0, 0.0, 2.0], abs=1e-6)
    assert {"map/track/podium", "map/track/numbers", "map/vehicle/body"} <= shown.entities
    assert "racing" in shown.texts("log/race")
    assert shown.texts("log/estimate") == IMAGES * ["a gate refused: too far"]
    assert "one gate" in shown.texts("about")[0]
    assert shown.curve("updates/accepted")[1].tolist() == IMAGES * [[1.0]]
    assert shown.has_blueprint


def test_the_age_of_messages_is_shown(shown):
    _, ages = shown.curve("latency/state.updates")
    assert ages == pytest.approx(np.full((IMAGES - 1, 1), 1e-6 * LATENCY_NS))  # a stamp of 0, of the first, is none


def test_a_bag_without_truth_images_and_configuration_shows_the_estimate(tmp_path, repository):
    write(tmp_path, repository / "config", without=("ground_truth/odometry", "camera/image_raw", "gates/detections"))
    shown = saved(tmp_path, tmp_path / "view.rrd")
    _, places = shown.column("map/vehicle", "Transform3D:translation")
    assert places[0][0] == pytest.approx([-3.0, DRIFT_M, 2.0], abs=1e-5)
    assert not {"camera/image", "map/path/truth"} & shown.entities
    assert not len(shown.curve("error/position")[0])


def test_a_torn_bag_is_shown_as_far_as_it_goes_and_the_damage_is_named(flown, tmp_path, capsys):
    shutil.copytree(flown / "bag", tmp_path / "bag")
    file = tmp_path / "bag" / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    t, _ = saved(tmp_path, tmp_path / "view.rrd").curve("thrust/command")
    assert 0.1 * TICKS < len(t) < TICKS
    assert "warning" in capsys.readouterr().err
