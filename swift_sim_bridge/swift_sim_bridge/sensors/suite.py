"""The sensors of a vehicle, read together once per tick."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from swift_ros import configuration
from swift_ros.types import Odometry
from swift_ros.vehicle import Vehicle
from swift_sim_bridge import seeds
from swift_sim_bridge.sensors.clock import History, Moving
from swift_sim_bridge.sensors.imu import Imu, ImuSettings
from swift_sim_bridge.sensors.imu_errors import ImuTruth
from swift_sim_bridge.sensors.motion_capture import MotionCapture, odometry
from swift_sim_bridge.sensors.vio import Vio, VioSettings


@dataclass(frozen=True)
class Sensed:
    """Readings of one tick.

    Attributes:
        truth: true motion.
        motion_capture: measured motion; the truth without terms and noise of motion capture.
        vio: odometry in the frame of its first measurement.
        gyro: (3,) rad/s.
        specific_force_body: (3,) m/s^2.
        filmed: the body at the time that an image stamped now shows.
    """

    truth: Odometry
    motion_capture: Odometry
    vio: Odometry
    gyro: np.ndarray
    specific_force_body: np.ndarray
    filmed: Moving


class Sensors:
    """IMU, VIO, motion capture and the time of the camera.

    Args:
        path: of simulation.yaml.
        vehicle: whose noise sheet is used.
        terms: its sensor terms.
        seed: of all random errors.

    Attributes:
        distorts_imu: whether the IMU needs the true samples within a tick.
    """

    def __init__(self, path: Path, vehicle: Vehicle, terms: dict, seed: int):
        noise = vehicle.sensors
        imu = configuration.load_section(ImuSettings, path, "imu")
        vio = configuration.load_section(VioSettings, path, "vio")
        gyro_noise, accel_noise = noise.get("gyro_rad_s", 0.0), noise.get("accel_m_s2", 0.0)
        vibration_rng = seeds.generator(seed, "imu_vibration")
        self._imu = Imu(imu, gyro_noise, accel_noise, seeds.generator(seed, "imu"), terms, vibration_rng)
        self._vio = Vio(vio, seeds.generator(seed, "vio"), terms)
        self._motion_capture = MotionCapture(terms, noise, seeds.generator(seed, "motion_capture"))
        late = (terms.get(name) for name in ("vio_latency", "processing_latency"))
        self._vio_delay, self._image_delay = (term.delay if term else 0.0 for term in late)
        self._history = History()
        self.distorts_imu = self._imu.distorts

    def sense(self, stamp_ns: int, t: float, moving: Moving, specific_force_body, samples: ImuTruth | None) -> Sensed:
        """Return the readings of a tick.

        Args:
            stamp_ns: time stamp of the readings.
            t: s after the start, later than the last tick.
            moving: the true motion.
            specific_force_body: (3,) m/s^2, true.
            samples: true samples since the last tick; needed if `distorts_imu`.
        """
        self._history.add(t, moving)
        truth = odometry(stamp_ns, moving)
        vio = self._vio.measure(stamp_ns, *self._history.before(self._vio_delay))
        if self.distorts_imu:
            assert samples is not None, "an IMU with errors needs the samples of the tick"
            gyro, accel = self._imu.measure_samples(samples)
        else:
            gyro, accel = self._imu.measure(moving.omega_body, specific_force_body)
        return Sensed(
            truth=truth,
            motion_capture=self._motion_capture.measure(truth, t, self._history),
            vio=vio,
            gyro=gyro,
            specific_force_body=accel,
            filmed=self._history.before(self._image_delay),
        )
