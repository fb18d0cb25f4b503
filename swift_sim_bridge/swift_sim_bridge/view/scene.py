"""Track, vehicle, poses, paths and images as Rerun archetypes. Entities below `map` are in the frame `map`, m."""

import cv2
import numpy as np
import rerun as rr

from swift_ros import geometry
from swift_ros.track import Track
from swift_ros.types import GateCorners, Odometry, RelativeGatePose
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.view.rows import Shape

MAP, VEHICLE, ESTIMATE, ODOM = "map", "map/vehicle", "map/estimate", "map/odom"
GATES, NEXT_GATE = "map/track/gates", "map/track/next_gate"
TRUTH_PATH, ESTIMATE_PATH, VIO_PATH = "map/path/truth", "map/path/estimate", "map/odom/path"
UNCERTAINTY, OBSERVED = "map/uncertainty", "map/estimate/observed_gates"
CAMERA, IMAGE = "camera", "camera/image"
CORNERS, INCOMPLETE = "camera/image/corners", "camera/image/incomplete_gates"
MAP_GATES, MATCHED = "camera/image/map_gates", "camera/image/matched_gates"

# RGB
STEEL, AMBER, GREEN, GREY = (140, 165, 190), (255, 160, 40), (90, 220, 110), (130, 130, 130)
BLUE = (60, 110, 255)  # differs from green, amber and grey for colour-blind eyes too
TRUTH, ESTIMATED, VIO = (235, 235, 235), (80, 170, 255), (230, 90, 200)
CARBON, FRONT = (100, 104, 110), (255, 120, 40)
PATH_RADIUS_M, EDGE_RADIUS_M = 0.015, 0.03
PODIUM_M = (0.5, 0.5, 0.05)  # half sizes
DEVIATIONS = 3.0  # standard deviations at the surface of the ellipsoid of the estimate's uncertainty
JPEG_QUALITY = 85  # of 100; a fisheye image of 384 x 384 px takes about a tenth of its pixels
RIM = np.linspace(0.0, 2.0 * np.pi, 24)  # rad, along a rotor disc


def track_shapes(track: Track) -> list[Shape]:
    """Return gates with their numbers, and the podium."""
    start, attitude = track.start_pose
    heading = geometry.rotate(attitude, np.array([1.0, 0.0, 0.0]))
    below = np.array([start[0], start[1], max(start[2] - PODIUM_M[2], track.bounds_min[2])])
    return [
        Shape(GATES, gate_frames(track)),
        Shape("map/track/numbers", gate_numbers(track.positions, track.outer_sides)),
        Shape(
            "map/track/podium",
            rr.Boxes3D(centers=[below], half_sizes=[PODIUM_M], quaternions=[attitude], colors=[GREY], labels=["start"]),
        ),
        Shape("map/track/podium/heading", rr.Arrows3D(origins=[below], vectors=[heading], colors=[GREY])),
    ]


def gate_frames(track: Track) -> rr.Boxes3D:
    """Return the frames of all gates: four solid bars for each."""
    centers, half_sizes, attitudes = [], [], []
    for gate in range(len(track.gates)):
        inner, outer = 0.5 * track.inner_sides[gate], 0.5 * track.outer_sides[gate]
        middle, width, depth = 0.5 * (inner + outer), 0.5 * (outer - inner), track.half_depth
        upright, level = (depth, width, outer), (depth, inner, width)
        bars = ((0, middle, 0, upright), (0, -middle, 0, upright), (0, 0, middle, level), (0, 0, -middle, level))
        for x, y, z, half_size in bars:
            centers.append(track.positions[gate] + track.rotations[gate] @ np.array([x, y, z], float))
            half_sizes.append(half_size)
            attitudes.append(track.attitudes[gate])
    return rr.Boxes3D(centers=centers, half_sizes=half_sizes, quaternions=attitudes, colors=[STEEL], fill_mode="solid")


def gate_numbers(positions, sides) -> rr.Points3D:
    """Return the numbers of the gates above their openings: positions (n, 3) m, sides (n,) m."""
    above = np.asarray(positions) + 0.6 * np.asarray(sides)[:, None] * [0.0, 0.0, 1.0]
    numbers = [str(number) for number in range(1, len(above) + 1)]
    return rr.Points3D(above, labels=numbers, radii=0.02, colors=[STEEL], show_labels=True)


def gate_rings(corners, color, radius_m: float = EDGE_RADIUS_M) -> rr.LineStrips3D:
    """Return the inner edges of gates with corners (n, 4, 3) m."""
    return rr.LineStrips3D(np.asarray(corners)[:, [0, 1, 2, 3, 0]], colors=[color], radii=radius_m)


def vehicle_shape(vehicle: Vehicle) -> rr.LineStrips3D:
    """Return arms and rotor discs in the frame base_link; the front rotors are orange."""
    hubs = np.array([rotor.position for rotor in vehicle.rotors])
    rim = vehicle.rotor_radius * np.stack([np.cos(RIM), np.sin(RIM), 0 * RIM], axis=-1)
    strips = [np.stack([np.zeros(3), hub]) for hub in hubs] + [hub + rim for hub in hubs]
    colors = [CARBON] * len(hubs) + [FRONT if hub[0] > 0 else TRUTH for hub in hubs]
    return rr.LineStrips3D(strips, colors=colors, radii=0.008)


def pose(state: Odometry) -> rr.Transform3D:
    """Return the pose of base_link in its world frame."""
    return rr.Transform3D(translation=state.p_world, quaternion=state.q_world_body)


def aligned(first: Odometry, second: Odometry) -> rr.Transform3D:
    """Return the pose of the world frame of `second` in that of `first`, of two poses of base_link at one time."""
    inverse = second.q_world_body * [-1.0, -1.0, -1.0, 1.0]
    q = geometry.quaternion_multiply(first.q_world_body, inverse)
    return rr.Transform3D(translation=first.p_world - geometry.rotate(q, second.p_world), quaternion=q)


def path_piece(points, color) -> rr.LineStrips3D:
    """Return a piece (n, 3) of a flown path, m."""
    return rr.LineStrips3D([np.asarray(points)], colors=[color], radii=PATH_RADIUS_M)


def uncertainty(state: Odometry) -> rr.Ellipsoids3D | None:
    """Return the ellipsoid of the position's covariance, `DEVIATIONS` wide; None without a covariance."""
    if state.covariance_pose is None or not np.isfinite(state.covariance_pose).all():
        return None
    variances, axes = np.linalg.eigh(state.covariance_pose[:3, :3])
    axes[:, 2] *= np.sign(np.linalg.det(axes))  # a rotation, not a reflection
    return rr.Ellipsoids3D(
        centers=[state.p_world],
        half_sizes=[DEVIATIONS * np.sqrt(np.maximum(variances, 0.0))],
        quaternions=[geometry.quaternion_from_matrix(axes)],
        colors=[ESTIMATED],
        fill_mode="majorwireframe",  # the vehicle is inside
        line_radii=0.004,
    )


def observed_gates(gates: list[RelativeGatePose]) -> rr.Arrows3D:
    """Return arrows from the vehicle to the gates that the camera has measured, in the frame base_link."""
    vectors = np.array([gate.p_body for gate in gates]).reshape(-1, 3)
    return rr.Arrows3D(vectors=vectors, origins=np.zeros_like(vectors), colors=[GREEN], radii=0.01)


def jpeg(image) -> rr.EncodedImage:
    """Return grey levels (H, W) as a JPEG image."""
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(image), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return rr.EncodedImage(contents=data.tobytes(), media_type="image/jpeg")


def detected_gates(entity: str, gates: list[GateCorners], color) -> list[Shape]:
    """Return the seen corners of gates in the image, and the lines between neighbours."""
    corners = [corner for gate in gates for corner in gate.corners_px[gate.seen]]
    edges = [edge for gate in gates for edge in gate.edges_px]
    return [
        Shape(entity, rr.Points2D(in_rerun(corners), colors=[color], radii=2.5)),
        Shape(f"{entity}/edges", image_lines(edges, color, 0.7)),
    ]


def image_lines(lines, color, radius_px: float) -> rr.LineStrips2D:
    """Return lines (k, 2) px of an image."""
    return rr.LineStrips2D([in_rerun(line) for line in lines], colors=[color], radii=radius_px)


def in_rerun(pixels) -> np.ndarray:
    """Return pixels (n, 2) of an image as Rerun counts them: the centre of the first one lies at 0.5, not at 0."""
    return np.reshape(pixels, (-1, 2)) + 0.5
