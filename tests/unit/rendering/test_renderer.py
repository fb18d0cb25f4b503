"""The renderer paints gates where the lens projects them, brighter with more light, the same for the same seed."""

from dataclasses import replace

import numpy as np
import pytest

from swift_ros import configuration, geometry
from swift_ros import track as tracks
from swift_ros.camera import model as lens
from swift_sim_bridge.gate_detector.corner_states import HIDDEN, VISIBLE
from swift_sim_bridge.gate_detector.images.rendered import label_gates
from swift_sim_bridge.gate_detector.images.targets import GateLimits
from swift_sim_bridge.rendering import scene as scenes
from swift_sim_bridge.rendering import textures
from swift_sim_bridge.rendering.motion import BodyMotion
from swift_sim_bridge.rendering.renderer import CircleRenderer, Renderer, pixel_rays

STILL = np.zeros(3)


@pytest.fixture(scope="module")
def camera(repository):
    return configuration.load(lens.Camera, repository / "config/camera.yaml")


@pytest.fixture(scope="module")
def track(repository):
    return configuration.load(tracks.Track, repository / "config/track.yaml")


@pytest.fixture(scope="module")
def circle(camera):
    return CircleRenderer(camera, np.full((1, textures.SIDE, textures.SIDE), 128, np.uint8))


def black_and_white(track, gain=1.0):
    """Return white gates in a black room, without noise, glare or vignetting."""
    rng = np.random.default_rng(0)
    zero, unity = (0.0, 0.0), (1.0, 1.0)
    looks = scenes.Looks(
        ("plain",), 1, zero, unity, unity, (0.02, 0.02), zero, (gain, gain), unity, 0, zero, zero, zero, 1
    )
    return scenes.race_scene(track, looks, rng)


def level(image, pixels):
    """Return grey levels between pixels, bilinear."""
    x, y = np.moveaxis(np.asarray(pixels), -1, 0)
    i, j = np.floor(y).astype(int), np.floor(x).astype(int)
    a, b = y - i, x - j
    image = image.astype(float)
    upper = (1 - b) * image[i, j] + b * image[i, j + 1]
    return (1 - a) * upper + a * ((1 - b) * image[i + 1, j] + b * image[i + 1, j + 1])


# Position of the camera relative to gate 1, and attitude of the vehicle: upright, rolled, turned, and with the gate at
# 79 degrees from the axis, one degree inside the edge of the image circle.
@pytest.mark.parametrize(
    ("away", "turn"),
    [
        ((-4.0, 0.5, 0.2), (0, 0, 0)),
        ((-6.0, -1.0, 0.5), (1.2, 0, 0)),
        ((-3.0, 2.0, 0.0), (0.3, -0.6, 0.4)),
        ((-9.0, 0.0, 0.0), (0, 0, 1.33)),
        ((4.0, 0.5, 0.3), (0, 0, np.pi)),
    ],
)
def test_painted_corners_lie_where_the_lens_projects_them(camera, track, circle, away, turn):
    p_world = track.positions[0] + away
    q = geometry.quaternion_from_rotation_vector(np.array(turn, dtype=float))
    image = circle.render(black_and_white(track), BodyMotion(p_world, q, STILL, STILL), 1, np.random.default_rng(0))
    centre, checked = track.positions[0], 0
    # from the middle of a side of the opening outwards, and back along the frame: both edges of the corner
    for corner, neighbour in zip(track.corners[0], np.roll(track.corners[0], 1, axis=0), strict=True):
        middle = 0.5 * (corner + neighbour)
        steps = np.linspace(-0.2, 0.2, 401)[:, None]
        line = middle + 0.35 * (corner - neighbour) + steps * (middle - centre) / np.linalg.norm(middle - centre)
        pixels, theta = lens.project(camera, lens.world_to_camera(camera, p_world, q, line))
        if theta.max() > camera.half_angle - 0.01:
            continue
        checked += 1
        levels = level(image, pixels)
        crossing = np.argmax(levels > 0.5 * (levels[0] + levels[-1]))
        assert levels[-1] - levels[0] > 100
        assert np.linalg.norm(pixels[crossing] - pixels[200]) < 0.6
    assert checked >= 2


def frames_hit(camera, track, p_world, q, edge_px):
    """Return the pixels inside the image circle, and which of their rays hit a gate's frame above the floor.

    The frame's edges are moved outwards by `edge_px`.

    A ray nearly along a frame's plane hits it only for `edge_px` above zero.
    """
    inside, directions, _ = pixel_rays(camera)
    q_world_camera = geometry.quaternion_multiply(q, camera.q_body_camera)
    rays = directions.T @ geometry.rotation_matrix(q_world_camera).T
    origin, hit = p_world + geometry.rotate(q, camera.p_body_camera), np.zeros(len(rays), bool)
    nearest = 0.1 if edge_px < 0 else 0.0  # m; a frame nearer than 0.05 m is not drawn
    sides = zip(track.positions, track.rotations, track.inner_sides, track.outer_sides, strict=True)
    for centre, rotation, inner, outer in sides:
        slope = rays @ rotation[:, 0]
        reach = ((centre - origin) @ rotation[:, 0]) / slope
        point = origin + reach[:, None] * rays
        across = np.abs((point - centre) @ rotation[:, 1:]).max(axis=1)
        edge = edge_px * np.abs(reach) / camera.fx / np.abs(slope)
        on_frame = (across > inner / 2 - edge) & (across < outer / 2 + edge) & (reach > nearest) & (point[:, 2] > -edge)
        along = np.abs(slope) < 0.05
        hit |= np.where(along, edge_px > 0, on_frame)
    return inside, hit


def test_every_ray_that_hits_a_frame_shows_it_and_no_other_does(camera, track, circle):
    """Also from amid a gate, close behind one, and looking away: the choice of rays near gates must not show."""
    rng, scene, hits = np.random.default_rng(3), black_and_white(track), 0
    for k in range(40):
        away = rng.normal(0.0, (0.4, 2.0, 8.0, 20.0)[k % 4], 3)
        p_world = track.positions[k % len(track.gates)] + away - [0.0, 0.0, 0.2 * (k % 3)]
        p_world = np.clip(p_world, scene.room.low + 0.3, scene.room.high - 0.3)
        q = geometry.normalize(rng.normal(size=4))
        image = circle.render(scene, BodyMotion(p_world, q, STILL, STILL), 1, np.random.default_rng(0))
        inside, surely = frames_hit(camera, track, p_world, q, -3.0)
        _, perhaps = frames_hit(camera, track, p_world, q, 3.0)
        levels = image[inside].astype(int)
        assert levels[surely].min(initial=255) > 200
        assert levels[~perhaps].max(initial=0) < 60
        hits += np.count_nonzero(surely)
    assert hits > 40_000


def test_corners_behind_another_gate_or_outside_the_image_circle_are_hidden(camera, track):
    plates = black_and_white(track).plates
    limits = GateLimits(9.0, 78.0, 16.0)
    upright = geometry.quaternion_from_yaw(np.array(0.0))
    ahead = label_gates(camera, plates, 7, track.positions[0] - [4.0, 0, 0], upright, limits)
    assert (ahead.state[0] == VISIBLE).all() and ahead.counts[0]
    beside = label_gates(camera, plates, 7, track.positions[0] - [0.5, 3.0, 0], upright, limits)
    assert (beside.state[0] == HIDDEN).any()
    # two gates on one line: through the opening of the nearer one the other is visible, behind its frame it is hidden
    lined_up = scenes.join(plates, plates)
    lined_up.centre[:] = track.positions[0]
    lined_up.rotation[:] = np.eye(3)
    lined_up.centre[0] += [6.0, 0.0, 0.0]
    eye = track.positions[0] + [-1.0, 0.0, 0.0] - geometry.rotate(upright, camera.p_body_camera)
    through = label_gates(camera, lined_up, 1, eye, upright, limits)
    assert (through.state[0] == VISIBLE).all()  # through the opening of the nearer gates
    covered = label_gates(camera, lined_up, 1, eye + [0.0, 0.9, 0.0], upright, limits)
    assert (covered.state[0] == HIDDEN).any()


def test_more_light_gives_a_brighter_image_and_outside_the_circle_it_is_black(camera, track, circle):
    p_world, q = track.positions[0] - [4.0, 0, 0], np.array([0.0, 0, 0, 1])
    dim, bright = (
        circle.render(black_and_white(track, gain), BodyMotion(p_world, q, STILL, STILL), 1, np.random.default_rng(0))
        for gain in (0.4, 0.8)
    )
    assert 1.8 < bright.max() / dim.max() < 2.2
    v, u = np.mgrid[0 : camera.height, 0 : camera.width]
    radius = np.hypot(u - camera.cx, v - camera.cy)
    assert (bright[radius > 186] == 0).all() and (bright[radius < 184] > 0).all()


def test_a_fast_rotation_blurs_edges(camera, track, circle):
    p_world, q = track.positions[0] - [4.0, 0, 0], np.array([0.0, 0, 0, 1])
    motions = [BodyMotion(p_world, q, STILL, omega) for omega in (STILL, np.array([0.0, 0.0, 8.0]))]
    still, turning = (
        circle.render(black_and_white(track), motion, 5, np.random.default_rng(0)).astype(float) for motion in motions
    )
    middle = np.s_[120:260, 120:260]
    assert np.abs(np.diff(turning[middle], axis=1)).max() < 0.7 * np.abs(np.diff(still[middle], axis=1)).max()


def test_the_same_seed_gives_the_same_images(repository, camera, track):
    section = configuration.read_yaml(repository / "config/simulation.yaml")["renderer"]
    looks = configuration.build(scenes.Looks, section | {"textures": 9}, "renderer")
    views = [(track.positions[0] - [4.0, k, 0], np.array([0.0, 0, 0, 1]), np.ones(3), np.ones(3)) for k in range(2)]
    renderers = [Renderer(camera, track, looks, seed) for seed in (7, 7, 8)]
    first, again, other = ([renderer.render(*view) for view in views] for renderer in renderers)
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.slow
def test_an_image_does_not_depend_on_the_number_of_its_rays(camera, track):
    narrower = [replace(camera, cx=190.8, cy=191.1, image_circle_deg=163.0 - cut) for cut in (0.0, 0.4, 0.8, 1.2)]
    stack = np.full((1, textures.SIDE, textures.SIDE), 128, np.uint8)
    motion = BodyMotion(track.positions[0] + [-4.0, 0.5, 0.2], np.array([0.0, 0.0, 0.0, 1.0]), np.ones(3), np.ones(3))
    images, counts = [], set()
    for one in narrower:
        counts.add(np.count_nonzero(pixel_rays(one)[0]) % 4)
        images.append(CircleRenderer(one, stack).render(black_and_white(track), motion, 1, np.random.default_rng(0)))
    assert len(counts) > 1  # some are no multiple of a vector's length
    for image in images[1:]:
        seen = image > 0
        assert np.abs(image[seen].astype(int) - images[0][seen]).max() <= 1
        assert images[0][seen].std() > 5 and not seen.all()
