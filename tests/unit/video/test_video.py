"""A flight with known places, image and end is written into a bag; its video is decoded and they are found in it."""

import shutil

import cv2
import numpy as np
import pytest
from one_gate_flight import CORNERS, DRIFT_M, GREY_LEVEL, INCOMPLETE, INCOMPLETE_EDGES, SECONDS, write

from swift_ros import cli
from swift_ros.race.result import CUT_SHORT
from swift_sim_bridge.video import chase, film, painter
from swift_sim_bridge.video.flight import Path3, read
from swift_sim_bridge.video.shapes import AMBER, BLUE, GREEN, RED

HEIGHT, FPS = 360, 10


def render(folder, *options):
    """Render the flight of a folder; return the decoded frames (n, H, W, 3) and frames a second."""
    out = folder / "video.mp4"
    arguments = ["--out", str(out), "--fps", str(FPS), "--height", str(HEIGHT)]
    assert cli.main(["video", str(folder), *arguments, *options]) == 0
    video = cv2.VideoCapture(str(out))
    frames = []
    while (read_one := video.read())[0]:
        frames.append(read_one[1])
    return np.array(frames), video.get(cv2.CAP_PROP_FPS)


@pytest.fixture(scope="module")
def flown(tmp_path_factory, repository):
    return write(tmp_path_factory.mktemp("flown"), repository / "config")


@pytest.fixture(scope="module")
def frames(flown):
    return render(flown)


def near(pixels, color, tolerance=60):
    """Return which pixels (..., 3) have about a color."""
    return np.abs(pixels.astype(int) - color).max(axis=-1) < tolerance


def inset(frame):
    left, top, side = (round(HEIGHT / 720 * length) for length in film.INSET)
    return frame[top : top + side, left : left + side]


def test_the_video_lasts_as_long_as_the_flight_at_the_chosen_rate(frames, flown):
    flight = read(flown / "bag")
    decoded, fps = frames
    assert fps == FPS
    assert decoded.shape[1:] == (HEIGHT, HEIGHT * 16 // 9, 3)
    assert len(decoded) == len(film.frame_times(flight, film.Cut(HEIGHT, FPS))) == int(SECONDS * FPS - 0.1)
    slow = film.frame_times(flight, film.Cut(HEIGHT, FPS, slow=4.0, first_s=1.0, last_s=2.0))
    assert len(slow) == 4 * FPS and slow[0] == 1.0 and slow[-1] == pytest.approx(2.0 - 0.25 / FPS)


def test_the_next_gate_is_where_the_camera_projects_it(frames, flown):
    flight, at = read(flown / "bag"), 6
    cut = film.Cut(HEIGHT, FPS)
    view = film.Film(flight, 0, cut).views(film.frame_times(flight, cut))[at]
    # the middles of the four bars, half-way between the rolled gate's inner and outer edge
    y, z = 1.1 * np.array([[1, 0], [0, 1], [-1, 0], [0, -1]], float).T
    roll = np.radians(20.0)
    bars = np.stack([4.0 + 0 * y, y * np.cos(roll) - z * np.sin(roll), 2.0 + y * np.sin(roll) + z * np.cos(roll)], -1)
    intrinsics = [[view.focal_px, 0, view.width / 2 - 0.5], [0, view.focal_px, view.height / 2 - 0.5], [0, 0, 1]]
    turn = view.rotation.T
    pixels, _ = cv2.projectPoints(bars, cv2.Rodrigues(turn)[0], -turn @ view.p_world, np.array(intrinsics), None)
    for u, v in pixels[:, 0]:
        patch = frames[0][at][round(v) - 1 : round(v) + 2, round(u) - 1 : round(u) + 2]
        tone = patch.mean(axis=(0, 1)) / AMBER
        assert np.ptp(tone) < 0.25 and tone.mean() > 0.6, f"no amber at {u:.0f}, {v:.0f}: {patch.mean(axis=(0, 1))}"


def test_the_inset_shows_the_recorded_image_with_the_detected_gate(frames):
    picture = inset(frames[0][6])
    side = len(picture)
    below = picture[int(0.75 * side) : int(0.85 * side), int(0.45 * side) : int(0.55 * side)]
    assert abs(below.mean() - GREY_LEVEL) < 12
    assert near(picture, GREEN).sum() > 40
    assert near(around(picture, CORNERS[0]), GREEN).any()


def around(picture, point_px):
    """Return the pixels around a point of the recorded image in the inset."""
    x, y = np.round(np.asarray(point_px) * len(picture) / 384).astype(int)
    return picture[y - 3 : y + 4, x - 3 : x + 4]


def test_the_inset_shows_the_seen_corners_of_incomplete_gates_joined_where_they_are_neighbours(frames):
    picture = inset(frames[0][6])
    for corner in INCOMPLETE[np.isfinite(INCOMPLETE)].reshape(-1, 2):
        assert near(around(picture, corner), BLUE, 80).any(), corner

    def blueness(point_px):
        blue, _, red = np.moveaxis(around(picture, point_px).astype(int), -1, 0)
        return (blue - red).max()

    for edge in INCOMPLETE_EDGES:
        assert blueness(edge.mean(axis=0)) > 60, edge
    for point in ([60.0, 200.0], [90.0, 230.0], [90.0, 200.0], [320.0, 170.0], [320.0, 230.0]):  # of unseen edges
        assert blueness(point) < 20, point


def test_the_strip_shows_values_and_the_end_is_announced(frames):
    decoded = frames[0]
    for left in (18, 386, 469, 552):  # speed, thrust, battery, error
        assert near(decoded[6][310:350, left : left + 60], (245, 245, 245)).sum() > 30
    banner = slice(235, 285), slice(150, 490)
    assert near(decoded[-1][banner], RED).sum() > 150
    assert near(decoded[6][banner], RED).sum() < 20


def test_a_crash_is_named(flown, capsys):
    render(flown, "--from", "2.2")
    assert "crashed after 2.4" in capsys.readouterr().out


def test_a_torn_bag_gives_a_shorter_video_and_says_so(flown, tmp_path, capsys):
    shutil.copytree(flown / "bag", tmp_path / "bag")
    file = tmp_path / "bag" / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    decoded, _ = render(tmp_path)
    assert 3 < len(decoded) < int(SECONDS * FPS) - 3
    output = capsys.readouterr()
    assert CUT_SHORT in output.out and "warning" in output.err
    assert near(decoded[-1][235:285], AMBER).sum() > 100


def test_without_images_and_truth_the_estimate_is_shown_and_both_are_named(tmp_path, repository, capsys):
    write(tmp_path, repository / "config", without=("camera/image_raw", "gates/detections", "ground_truth/odometry"))
    decoded, _ = render(tmp_path)
    said = capsys.readouterr().out
    assert "no images: the video has no onboard view" in said and "where state/odometry places it" in said
    assert not near(inset(decoded[6])[60:90, 60:90], (GREY_LEVEL,) * 3, 12).any()
    assert not near(decoded[6][310:350, 552:612], (245, 245, 245)).any()  # no error without truth
    assert read(tmp_path / "bag").path.p_world[0, 1] == DRIFT_M


def test_what_is_no_flight_is_refused_in_a_sentence(tmp_path, repository, capsys):
    write(tmp_path, repository / "config", without=("ground_truth/odometry", "state/odometry"))
    (tmp_path / "file").write_text("")
    for arguments, sentence in (
        ([str(tmp_path)], "there is no flight to show"),
        ([str(tmp_path / "none")], "does not exist"),
        ([str(tmp_path), "--fps", "0"], "--fps 0 is not between"),
        ([str(tmp_path), "--slow", "nan"], "--slow nan is not between"),
        ([str(tmp_path), "--out", "video.gif"], "does not end with .mp4"),
    ):
        assert cli.main(["video", *arguments]) == 2
        error = capsys.readouterr().err
        assert sentence in error and len(error.strip().splitlines()) == 1


def test_times_outside_and_a_file_that_cannot_be_written_are_refused(flown, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    for options, sentence in (
        (["--from", "50"], "has poses from 0.00 to 2.99 s"),
        (["--out", str(tmp_path / "file" / "video.mp4")], "cannot be written"),
    ):
        assert cli.main(["video", str(flown), "--height", "90", *options]) == 2
        assert sentence in capsys.readouterr().err


def test_the_camera_stays_behind_and_turns_smoothly():
    t = np.arange(0, 6, 0.01)
    turn = np.where(t < 3, 0.0, np.pi)  # the vehicle turns round from one pose to the next
    v = 8.0 * np.stack([np.cos(turn), np.sin(turn), 0 * t], axis=-1)
    q = np.stack([0 * t, 0 * t, np.sin(turn / 2), np.cos(turn / 2)], axis=-1)
    path = Path3(t, np.cumsum(v, axis=0) * 0.01, q, v)
    cameras = chase.follow(path, t, [-100, -100, -100], [100, 100, 100])
    away = path.p_world - cameras.p_world
    assert np.all(np.sum(away[100:200] * v[100:200], axis=1) > 0) and np.all(np.sum(away[450:] * v[450:], axis=1) > 0)
    forward = cameras.rotations[:, :, 2]
    steps = np.degrees(np.arccos(np.clip(np.sum(forward[1:] * forward[:-1], axis=1), -1, 1)))
    assert steps.max() < 6.0  # a hundredth of a second
    assert np.abs(cameras.rotations[:, 2, 0]).max() < 1e-9  # the horizon is level


def test_nearer_faces_cover_farther_ones_and_those_behind_are_not_drawn():
    view = painter.View(64, 48, 40.0, np.zeros(3), np.eye(3))
    square = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    corners = np.stack([square + [0, 0, z] for z in (2.0, 4.0, -3.0)])
    colors = np.array([[255.0, 0, 0], [0, 255, 0], [0, 0, 255]])
    image = np.zeros((48, 64, 3), np.uint8)
    painter.paint(image, view, [painter.Faces(corners, colors, np.ones(3))])
    assert image[24, 32].tolist() == [255, 0, 0] and not image[..., 2].any() and not image[..., 1].any()
    image[:] = 0
    floor = np.array([[[-1.0, 1.0, -5.0], [1.0, 1.0, -5.0], [1.0, 1.0, 50.0], [-1.0, 1.0, 50.0]]])
    painter.paint(image, view, [painter.Faces(floor, colors[1:2], np.ones(1))])
    assert image[46, 32].tolist() == [0, 255, 0] and image[4, 32].tolist() == [0, 0, 0]
