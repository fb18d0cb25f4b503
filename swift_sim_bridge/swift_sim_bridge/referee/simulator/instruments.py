"""The referee's instruments: the recording of a flight, with the sensor errors of the true vehicle file."""

from collections.abc import Collection

import numpy as np

from swift_ros.recording.flight_checks import checked_table
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_sim_bridge.referee.simulator.flight import LOOP_HZ, Truth
from swift_sim_bridge.referee.simulator.plant import GRAVITY
from swift_sim_bridge.referee.simulator.vectors import cross, product, rotate, rotate_back

LEAD_S = 2.0  # run-up at the start, which is not recorded
VIO_HZ = 100  # rate of visual-inertial odometry
VIO_WALK = 0.01  # random walk of its position in each axis, m per square root of a metre flown


def record(
    truth: Truth,
    content: dict,
    rng: np.random.Generator,
    rate_hz: int = LOOP_HZ,
    channels: Collection = (),
    name: str = "flight",
) -> FlightTable:
    """Return the recording of a flight.

    Args:
        truth: the flight; its gyro already has noise.
        content: content of the true vehicle file, with the noise sheet of the sensors.
        rng: random generator of the noise.
        rate_hz: sample rate, a divisor of LOOP_HZ.
        channels: channels to record, all if empty.
        name: name of the recording.
    """
    terms, noise = content.get("terms", {}), content["sensors"]
    rows = slice(round(LEAD_S * LOOP_HZ), None, LOOP_HZ // rate_hz)
    t = truth.t[rows] - LEAD_S

    def noisy(values, size):
        return values + size * rng.standard_normal(np.shape(values))

    late = terms.get("time_offset", {}).get("delay", 0.0) + 1e-6 * terms.get("clock_drift", {}).get("ppm", 0.0) * t
    p, q, v = marker_pose(truth, terms, truth.t[rows] - late)
    small = noise["attitude_rad"] * rng.standard_normal((len(t), 3))
    accel = accelerometer(truth, terms)
    shaken = noise["vibration_m_s2"] * truth.rotor_speed.mean(axis=1) / truth.rotor_speed.mean()
    accel = noisy(accel, np.hypot(noise["accel_m_s2"], shaken)[:, None])
    commands = truth.t_command >= LEAD_S - 1e-9
    written = {
        "p_world": Samples(t, noisy(p, noise["position_m"])),
        "v_world": Samples(t, noisy(v, noise["velocity_m_s"])),
        "q_world_body": Samples(t, times(q, rotation(small))),
        "gyro_body": Samples(t, truth.gyro[rows]),
        "specific_force_body": Samples(t, accel[rows]),
        "rotor_speed": Samples(
            t,
            np.maximum(
                truth.rotor_speed[rows] * noisy(np.ones(truth.rotor_speed[rows].shape), noise["rotor_relative"]), 0.0
            ),
        ),
        "motor_command": Samples(t, truth.u[rows]),
        "thrust_command": Samples(truth.t_command[commands] - LEAD_S, truth.thrust[commands]),
        "omega_command_body": Samples(truth.t_command[commands] - LEAD_S, truth.rates[commands]),
        "voltage": Samples(t, noisy(truth.voltage[rows], noise["vbat_v"])),
        "current": Samples(t, noisy(truth.current[rows], noise["ibat_a"])),
        **vio(truth, terms, rng),
    }
    return checked_table(name, {key: samples for key, samples in written.items() if not channels or key in channels})


def accelerometer(truth: Truth, terms: dict) -> np.ndarray:
    """Return the reading of the accelerometer (n, 3), m/s^2, without noise."""
    arm = np.array(terms.get("imu_lever_arm", {}).get("position", [0.0] * 3))
    w = truth.w
    force = truth.specific_force + np.cross(truth.angular_acceleration, arm) + np.cross(w, np.cross(w, arm))
    scale = np.array(terms.get("accel_scale", {}).get("scale", [0.0] * 3))
    return (1.0 + scale) * force + np.array(terms.get("accel_bias", {}).get("bias", [0.0] * 3))


def marker_pose(truth: Truth, terms: dict, t):
    """Return position (n, 3) m, attitude (n, 4) and velocity (n, 3) m/s of the markers' frame at times t (n,) s."""
    at = np.clip(np.rint(t * LOOP_HZ).astype(int), 0, len(truth.t) - 1)
    ahead = (t - truth.t[at])[:, None]
    gravity = np.array([0.0, 0.0, GRAVITY])
    acceleration = np.stack(rotate(truth.q[at].T, truth.specific_force[at].T), axis=1) - gravity
    p = truth.p[at] + ahead * truth.v[at] + 0.5 * ahead**2 * acceleration
    v = truth.v[at] + ahead * acceleration
    w = truth.w[at] + ahead * truth.angular_acceleration[at]
    q = times(truth.q[at], rotation(ahead * (truth.w[at] + 0.5 * ahead * truth.angular_acceleration[at])))
    offset = terms.get("marker_offset", {}).get("position", [0.0] * 3)
    p = p + np.stack(rotate(q.T, np.broadcast_to(np.array(offset)[:, None], w.T.shape)), axis=1)
    v = v + np.stack(rotate(q.T, cross(w.T, np.array(offset)[:, None] * np.ones(len(t)))), axis=1)
    skew = np.array(terms.get("frame_misalignment", {}).get("rotation", [0.0] * 3))
    return p, times(q, rotation(np.broadcast_to(skew, w.shape))), v


def vio(truth: Truth, terms: dict, rng) -> dict[str, Samples]:
    """Return the pose channels of visual-inertial odometry.

    It has its own origin and heading, a scale error, and a random walk with the distance flown.
    """
    rows = slice(round(LEAD_S * LOOP_HZ), None, LOOP_HZ // VIO_HZ)
    p, q, t = truth.p[rows], truth.q[rows], truth.t[rows] - LEAD_S
    scale = 1.0 + terms.get("vio_scale", {}).get("scale", 0.0)
    heading = rotation(np.array([[0.0, 0.0, rng.uniform(-np.pi, np.pi)]]))
    steps = np.linalg.norm(np.diff(p, axis=0, prepend=p[:1]), axis=1)
    walk = np.cumsum(VIO_WALK * np.sqrt(steps)[:, None] * rng.standard_normal(p.shape), axis=0)
    own = np.stack(rotate(heading[0], (scale * (p - p[0])).T), axis=1) + walk + 0.002 * rng.standard_normal(p.shape)
    turned = times(np.broadcast_to(heading, q.shape), times(q, rotation(0.003 * rng.standard_normal(p.shape))))
    return {"p_vio": Samples(t, own), "q_vio_body": Samples(t, turned)}


def in_body_frame(q, vectors) -> np.ndarray:
    """Return world vectors (n, 3) in the body frame of attitudes q (n, 4)."""
    return np.stack(rotate_back(q.T, vectors.T), axis=1)


def times(a, b) -> np.ndarray:
    """Return the quaternion products (n, 4)."""
    return np.stack(product(a.T, b.T), axis=1)


def rotation(vector) -> np.ndarray:
    """Return the quaternions (n, 4) of rotation vectors (n, 3) rad."""
    half = 0.5 * np.linalg.norm(vector, axis=1, keepdims=True)
    return np.concatenate([0.5 * vector * np.sinc(half / np.pi), np.cos(half)], axis=1)
