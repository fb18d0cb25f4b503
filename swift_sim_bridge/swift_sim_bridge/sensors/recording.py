"""The flight table of a flight with known truth, as the instruments of a vehicle file record it.

Errors are those of the vehicle file: its `terms`, and white noise by its noise sheet `sensors`. The functions are those
of the simulator, so that an effect that is identified in a recording is the simulated one.
"""

import numpy as np

from swift_ros.camera.model import Camera
from swift_ros.corner_rays import ORDER_FROM_BEHIND
from swift_ros.recording.flight_table import DetectedGates, FlightTable, Samples
from swift_ros.track import Track, to_gate_frame
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.sensors import imu_errors
from swift_sim_bridge.sensors.camera import flown_camera, image_errors, project_corners
from swift_sim_bridge.sensors.clock import Moving, moving_at, pose_delay
from swift_sim_bridge.sensors.imu_errors import ImuTruth
from swift_sim_bridge.sensors.motion_capture import captured, with_noise
from swift_sim_bridge.sensors.terms import sensor_terms
from swift_sim_bridge.sensors.vio import Vio, VioSettings
from swift_sim_bridge.sensors.world import flown_track

NEAREST_GATE_M = 1.0  # m; a nearer gate does not fit into the image


def record(t, trace, vehicle: Vehicle, rng) -> FlightTable:
    """Return the flight table of a flight: motion capture, IMU, rotors, motors, battery.

    The velocity is recorded only where the noise sheet has `velocity_m_s`.

    Args:
        t: (n,) s, evenly spaced.
        trace: a `physics.trace.Trace`, its fields (n, ...) at the times t; motor commands are those of the step before.
        vehicle: with sensor terms and noise sheet.
        rng: draws the noise.
    """
    terms, noise = sensor_terms(vehicle), vehicle.sensors
    t, dt = np.asarray(t, dtype=float), float(t[1] - t[0])
    motion = Moving(*(np.asarray(getattr(trace, name), dtype=float) for name in Moving._fields))
    rotor_speed = np.asarray(trace.rotor_speed, dtype=float)
    gyro, accel = record_imu(dt, motion.omega_body, trace.specific_force_body, rotor_speed, vehicle, rng)

    def noisy(values, name):
        values = np.asarray(values, dtype=float)
        return values + noise.get(name, 0.0) * rng.standard_normal(values.shape)

    seen = captured(moving_at(t - pose_delay(t - t[0], terms), t, motion), terms)
    seen = with_noise(seen, noise.get("position_m", 0.0), noise.get("attitude_rad", 0.0), rng)
    channels = {
        "p_world": Samples(t, seen.p_world),
        "q_world_body": Samples(t, seen.q_world_body),
        "gyro_body": Samples(t, gyro),
        "specific_force_body": Samples(t, accel),
        "rotor_speed": Samples(t, rotor_speed * (1 + noisy(np.zeros(rotor_speed.shape), "rotor_relative"))),
        "motor_command": Samples(t - dt, np.asarray(trace.motor_command, dtype=float)),
        "voltage": Samples(t, noisy(trace.voltage, "vbat_v")),
        "current": Samples(t, noisy(trace.current, "ibat_a")),
    }
    if "velocity_m_s" in noise:
        channels["v_world"] = Samples(t, noisy(seen.v_world, "velocity_m_s"))
    return FlightTable(vehicle.name, channels)


def record_imu(dt: float, omega_body, specific_force_body, rotor_speed, vehicle: Vehicle, rng):
    """Return gyro (n, 3) rad/s and accelerometer (n, 3) m/s^2, recorded every dt s.

    The noise sheet's `vibration_m_s2` is the root mean square over the flight; it is proportional to the rotors' speed.
    """
    terms, noise = sensor_terms(vehicle), vehicle.sensors
    omega_body, specific_force_body = (np.asarray(rows, dtype=float) for rows in (omega_body, specific_force_body))
    alpha_body = imu_errors.angular_acceleration(omega_body, dt)
    truth = ImuTruth(dt, omega_body, alpha_body, specific_force_body, np.asarray(rotor_speed, dtype=float))
    gyro, accel, _ = imu_errors.distort(truth, terms, rng)
    speed = np.sqrt(np.mean(truth.rotor_speed**2, axis=-1, keepdims=True))
    shaken = noise.get("vibration_m_s2", 0.0) * speed / max(np.sqrt(np.mean(speed**2)), 1e-9)
    gyro = gyro + noise.get("gyro_rad_s", 0.0) * rng.standard_normal(gyro.shape)
    accel = accel + np.hypot(noise.get("accel_m_s2", 0.0), shaken) * rng.standard_normal(accel.shape)
    return imu_errors.clip(gyro, accel, terms)


def record_vio(t, motion: Moving, settings: VioSettings, terms: dict, rng) -> dict[str, Samples]:
    """Return the channels `p_vio` and `q_vio_body`.

    Args:
        t: (n,) s.
        motion: (n, ...) of the body at t.
        settings: of the odometry.
        terms: coefficients of the sensor terms, by name.
        rng: draws the drift.
    """
    t = np.asarray(t, dtype=float)
    vio, late = Vio(settings, rng, terms), terms.get("vio_latency")
    seen = moving_at(t - (late.delay if late else 0.0), t, motion)
    rows = [vio.measure(round(1e9 * stamp), *row) for stamp, row in zip(t, zip(*seen, strict=True), strict=True)]
    p_vio, q_vio_body = (np.stack([getattr(row, name) for row in rows]) for name in ("p_world", "q_world_body"))
    return {"p_vio": Samples(t, p_vio), "q_vio_body": Samples(t, q_vio_body)}


def record_gates(t, motion: Moving, camera: Camera, track: Track, vehicle: Vehicle, rng) -> DetectedGates:
    """Return the gates in the images of a flight; no gate occludes another.

    Args:
        t: (n,) s.
        motion: (n, ...) of the body at t.
        camera: as the stack uses it.
        track: the map, as the stack uses it.
        vehicle: with sensor terms.
        rng: draws the corner noise.
    """
    t, terms = np.asarray(t, dtype=float), sensor_terms(vehicle)
    stamps, late = np.arange(t[0], t[-1], 1.0 / camera.rate_hz), terms.get("processing_latency")
    body, stands = moving_at(stamps - (late.delay if late else 0.0), t, motion), flown_track(track, terms)
    points = stands.corners.reshape(-1, 3)
    pixels, inside = project_corners(flown_camera(camera, terms), image_errors(terms), body, points, rng)
    pixels, inside = pixels.reshape(len(stamps), -1, 4, 2), inside.reshape(len(stamps), -1, 4).all(axis=-1)
    local = to_gate_frame(stands.positions, stands.rotations, body.p_world[:, None])
    pixels = np.where((local[..., 0] > 0)[..., None, None], pixels[:, :, ORDER_FROM_BEHIND], pixels)
    image, gate = np.nonzero(inside & (np.linalg.norm(local, axis=-1) > NEAREST_GATE_M))
    return DetectedGates(stamps[image], pixels[image, gate], camera, track)
