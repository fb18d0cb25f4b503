"""Poses and velocities of recorded races, from a bag, an .npz of arrays, or a .csv of a lap."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from swift_ros import geometry
from swift_ros.errors import UsageError
from swift_ros.graph.topic_table import full_name
from swift_sim_bridge.rendering.motion import BodyMotion

STILL_M_S = 0.5  # slower poses are on the podium and are left out
TRUTH = "ground_truth/odometry"
LAP_COLUMNS = (
    "px_m",
    "py_m",
    "pz_m",
    "qx",
    "qy",
    "qz",
    "qw",
    "vx_mps",
    "vy_mps",
    "vz_mps",
    "wx_radps",
    "wy_radps",
    "wz_radps",
)


@dataclass(frozen=True)
class FlownPoses:
    """Poses and velocities.

    Attributes:
        p_world: (n, 3) m.
        q_world_body: (n, 4).
        v_world: (n, 3) m/s.
        omega_body: (n, 3) rad/s.
    """

    p_world: np.ndarray
    q_world_body: np.ndarray
    v_world: np.ndarray
    omega_body: np.ndarray

    def __len__(self):
        return len(self.p_world)

    def motion(self, k: int) -> BodyMotion:
        """Return pose and velocity number k."""
        return BodyMotion(self.p_world[k], self.q_world_body[k], self.v_world[k], self.omega_body[k])

    def thinned(self, most: int) -> "FlownPoses":
        """Return at most `most` of the poses, evenly spaced."""
        keep = np.unique(np.linspace(0, len(self) - 1, most).astype(int)) if len(self) > most else slice(None)
        return FlownPoses(*(value[keep] for value in vars(self).values()))

    def save(self, path: Path) -> None:
        """Write an .npz that `read` takes; float32, which is small enough to ship."""
        np.savez_compressed(path, **{name: value.astype(np.float32) for name, value in vars(self).items()})


def read_all(paths: list[Path]) -> FlownPoses:
    """Return the moving poses of all files. Raises UsageError if there are none."""
    parts = [read(path) for path in paths]
    joined = [np.concatenate(columns) for columns in zip(*(vars(part).values() for part in parts), strict=True)]
    flying = np.linalg.norm(joined[2], axis=-1) > STILL_M_S
    if not flying.any():
        raise UsageError(f"no pose moves in {', '.join(map(str, paths))}; give bags of races")
    return FlownPoses(*(column[flying] for column in joined))


def read(path: Path) -> FlownPoses:
    """Return the poses in a file: an .npz by `FlownPoses.save`, a lap's .csv, or a bag with ground truth.

    Raises:
        UsageError: the file is missing or holds no poses.
    """
    if not path.exists():
        raise UsageError(f"{path} does not exist; give a bag, an .npz or a .csv of flown poses")
    if path.suffix == ".npz":
        return _from_arrays(path)
    return _from_lap(path) if path.suffix == ".csv" else _from_bag(path)


def _from_arrays(path):
    try:
        with np.load(path) as arrays:
            columns = [arrays[name].astype(float) for name in FlownPoses.__dataclass_fields__]
    except (OSError, ValueError, KeyError) as error:
        raise UsageError(f"{path} holds no flown poses ({error}); save them with FlownPoses.save") from error
    return FlownPoses(*columns)


def _from_lap(path):
    with path.open() as file:
        names = file.readline().strip().split(",")
        missing = [name for name in LAP_COLUMNS if name not in names]
        if missing:
            raise UsageError(f"{path} lacks the column '{missing[0]}'; its header must name {', '.join(LAP_COLUMNS)}")
        rows = np.loadtxt(file, delimiter=",", ndmin=2)
    table = rows[:, [names.index(name) for name in LAP_COLUMNS]]
    return FlownPoses(table[:, :3], geometry.normalize(table[:, 3:7]), table[:, 7:10], table[:, 10:])


def _from_bag(path):
    from swift_ros.messages.motion import from_odometry  # ROS messages are needed for a bag only
    from swift_ros.recording import bags

    states = [from_odometry(message) for _, message, _ in bags.read(path, [full_name(TRUTH)])]
    if not states:
        raise UsageError(f"{path} has no message on {full_name(TRUTH)}; give a bag that a simulated race recorded")
    q = np.stack([state.q_world_body for state in states])
    v_body = np.stack([state.v_body for state in states])
    omega = np.stack([state.omega_body for state in states])
    return FlownPoses(np.stack([state.p_world for state in states]), q, geometry.rotate(q, v_body), omega)
