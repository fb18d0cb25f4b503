"""Gates of the map in an image, from the pose of the vehicle."""

import numpy as np

from swift_ros import geometry
from swift_ros.camera import model as lens
from swift_sim_bridge.gate_detector.corner_states import VISIBLE as IN_VIEW
from swift_sim_bridge.gate_detector.evaluation.setup import DetectorSetup
from swift_sim_bridge.gate_detector.images.rendered import label_gates
from swift_sim_bridge.labels.labelled_images import NOT_LABELLED, OCCLUDED, VISIBLE, LabelledGate, problem_of
from swift_sim_bridge.rendering.scene import gate_plates

LEAST_SIDE_PX = 5.0  # a smaller gate is a dot: neither a person nor the detector finds its corners


def project(camera, setup: DetectorSetup, track, state) -> tuple[list[LabelledGate], bool]:
    """Return the gates in an image, the nearest first, and whether these are all that it shows.

    A corner behind another gate, or at the border of the image, is OCCLUDED. One outside of the image is not labelled.

    Args:
        camera: of the image.
        setup: looks of the plates and limits, of which the result does not depend.
        track: the map.
        state: Odometry of the vehicle in the map.
    """
    plates = gate_plates(track, setup.looks, np.random.default_rng(0))  # their looks do not matter
    q_world_body = geometry.normalize(state.q_world_body)
    labels = label_gates(camera, plates, len(track.gates), state.p_world, q_world_body, setup.limits)
    pixels, theta = lens.project(camera, labels.rays_camera)
    imaged = (theta < camera.half_angle) & (lens.inside_px(camera, pixels) > 0)
    gates, complete = [], True
    for k in np.argsort(labels.distance):
        visibility = np.where(labels.state[k] == IN_VIEW, VISIBLE, OCCLUDED)
        visibility[~imaged[k]] = NOT_LABELLED
        if not (visibility == VISIBLE).any():
            continue
        gate = LabelledGate(np.where((visibility == NOT_LABELLED)[:, None], np.nan, pixels[k]), visibility)
        if labels.side_px[k] >= LEAST_SIDE_PX and not problem_of(gate, camera.width, camera.height):
            gates.append(gate)
        else:
            complete = False
    return gates, complete
