"""Maps of an ideal corner network, for the tests of the grouping: gates at given places, corners that are hidden."""

from dataclasses import replace

import numpy as np

from swift_ros import configuration, geometry
from swift_ros import track as tracks
from swift_ros.perception.corner_grouping import GroupingSettings
from swift_sim_bridge.gate_detector.corner_states import HIDDEN
from swift_sim_bridge.gate_detector.images.rendered import label_gates
from swift_sim_bridge.gate_detector.images.targets import GateLimits, panorama_labels, rasterize
from swift_sim_bridge.rendering import scene as scenes

SETTINGS = GroupingSettings(peak_threshold=0.3, edge_threshold=0.35, most_peaks=16, stride=2)
LEVEL = geometry.quaternion_from_yaw(np.array(0.0))


def gates_at(repository, places):
    """Return plates of gates at ((x, y, z), yaw in degrees)."""
    track = configuration.load(tracks.Track, repository / "config/track.yaml")
    track = replace(track, gates=tuple(tracks.Gate(position, yaw) for position, yaw in places))
    zero, one = (0.0, 0.0), (1.0, 1.0)
    looks = scenes.Looks(("plain",), 1, zero, one, one, one, zero, one, one, 0, zero, zero, zero, 1)
    return scenes.gate_plates(track, looks, np.random.default_rng(0))


def maps_of(view, plates, q_world_body, hide=()):
    """Return the maps of an ideal network, the true corners in the panorama and their states."""
    count = len(plates.centre)
    labels = label_gates(view.camera, plates, count, np.zeros(3), q_world_body, GateLimits(9.0, 78.0, 16.0))
    q_world_camera = geometry.quaternion_multiply(q_world_body, view.camera.q_body_camera)
    r_world_camera = geometry.rotation_matrix(q_world_camera)
    points, state = panorama_labels(view, labels, r_world_camera)
    for gate, corner in hide:
        state[gate, corner] = HIDDEN
    target, _ = rasterize(view, labels, points, state, r_world_camera)
    return np.moveaxis(target, -1, 0), points, state
