"""Gates of a track: tilted ones, and ones with a size of their own, for what judges, draws and flies them."""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from swift_ros import configuration, geometry
from swift_ros.errors import UsageError
from swift_ros.race import judge as race
from swift_ros.track import Gate, Track, to_gate_frame
from swift_ros.types import Odometry
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.physics.contact import frame_distance, world_from_track
from swift_sim_bridge.physics.state import parameters_from_vehicle
from swift_sim_bridge.rendering.scene import Looks, gate_plates

CONFIG = Path(__file__).parents[2] / "config"
SHIPPED = configuration.load(Track, CONFIG / "track.yaml")
DIVE = Gate((2.0, 1.0, 3.0), yaw_deg=90.0, pitch_deg=60.0, inner_side=2.0, outer_side=2.4)
TILTED = replace(SHIPPED, gates=(SHIPPED.gates[0], DIVE, Gate((-4.0, 2.0, 2.0), 30.0, roll_deg=20.0)))


def test_a_gate_with_pitch_leads_downwards_and_one_with_roll_leans_to_the_right():
    passage, left, up = TILTED.rotations[1].T
    assert passage == pytest.approx([0.0, 0.5, -np.sqrt(0.75)])
    assert left == pytest.approx([-1.0, 0.0, 0.0]) and up == pytest.approx([0.0, np.sqrt(0.75), 0.5])
    passage, left, up = TILTED.rotations[2].T
    assert passage == pytest.approx([np.cos(np.pi / 6), 0.5, 0.0]) and left[2] == pytest.approx(np.sin(np.radians(20)))
    np.testing.assert_allclose(geometry.rotation_matrix(TILTED.attitudes), TILTED.rotations)


def test_corners_lie_at_the_own_size_of_a_gate_in_its_plane():
    for gate, half in ((0, 0.75), (1, 1.0), (2, 0.75)):
        local = to_gate_frame(TILTED.positions[gate], TILTED.rotations[gate], TILTED.corners[gate])
        expected = half * np.array([[0, 1, 1], [0, -1, 1], [0, -1, -1], [0, 1, -1]])
        np.testing.assert_allclose(local, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("offset", "ends"),
    [
        ((0.0, 0.0), "passes"),
        ((0.0, 0.8), "passes"),
        ((0.8, 0.0), "passes"),
        ((0.9, 0.0), "hits"),
        ((1.1, 0.0), "hits"),
    ],
)
def test_judge_and_contact_agree_on_a_dive_through_a_larger_gate(offset, ends):
    """The hull flies along the passage with its axis in it, so that it reaches 0.18 m to the left and 0.05 m up."""
    vehicle = configuration.load(Vehicle, CONFIG / "drone.yaml")
    track = replace(TILTED, gates=(DIVE,))
    judge = race.Judge(track, vehicle.hull_radius, vehicle.hull_height)
    judge.start(0)
    q_map_body = track.attitudes[0]
    world, parameters = world_from_track(track, vehicle.hull_height), parameters_from_vehicle(vehicle)
    along = np.arange(-0.8, 0.8, 0.02)
    places = np.stack([along, *(np.full(len(along), one) for one in offset)], axis=-1)
    path = track.positions[0] + places @ track.rotations[0].T
    events = []
    for tick, p_map in enumerate(path, start=1):
        pose = Odometry(2_000_000 * tick, p_map, q_map_body, np.array([10.0, 0.0, 0.0]), np.zeros(3))
        events += judge.update(pose)
    distances = jax.jit(jax.vmap(lambda p: frame_distance(p, jnp.asarray(q_map_body), parameters, world.frames)[0]))
    nearest = float(distances(jnp.asarray(path)).min())
    assert any(event.is_passage for event in events) == (ends == "passes")
    assert any(event.state == race.CRASHED for event in events) == (ends == "hits")
    assert (nearest < 2e-3) == (ends == "hits")


def test_plates_have_the_size_and_attitude_of_their_gates():
    looks = configuration.load_section(Looks, CONFIG / "simulation.yaml", "renderer")
    plates = gate_plates(TILTED, looks, np.random.default_rng(1))
    np.testing.assert_allclose(plates.half_inner, [[0.75, 0.75], [1.0, 1.0], [0.75, 0.75]])
    np.testing.assert_allclose(plates.half_outer, [[1.05, 1.05], [1.2, 1.2], [1.05, 1.05]])
    np.testing.assert_allclose(plates.rotation, TILTED.rotations, atol=1e-6)


@pytest.mark.parametrize("sizes", [{"inner_side": 2.2}, {"outer_side": 1.4}, {"inner_side": -1.0}])
def test_a_frame_must_be_larger_than_its_opening(tmp_path, sizes):
    with pytest.raises(ValueError, match="inner_side"):
        replace(SHIPPED, gates=(Gate((0.0, 0.0, 2.0), 0.0, **sizes),))


def test_a_track_file_gives_tilts_and_sizes_by_gate(tmp_path):
    lines = (CONFIG / "track.yaml").read_text()
    first = "position: [-1.1, -1.6, 3.6], yaw_deg: 0.0"
    assert first in lines
    path = tmp_path / "track.yaml"
    path.write_text(lines.replace(first, first + ", pitch_deg: 30.0, inner_side: 1.0, outer_side: 1.3"))
    track = configuration.load(Track, path)
    assert track.inner_sides.tolist() == [1.0] + 6 * [1.5] and track.rotations[0, 2, 0] == pytest.approx(-0.5)
    path.write_text(lines.replace(first, first + ", tilt_deg: 30.0"))
    with pytest.raises(UsageError, match="unknown key 'tilt_deg'"):
        configuration.load(Track, path)
