"""State of the vehicle in the map: odometry at its own rate, corrected by the gates of late images.

Odometry is buffered by stamp, so that the gates of an image are applied at its stamp, and the correction is propagated
to all later odometry. Lockstep is deterministic: an image takes effect exactly `processing_latency` after its stamp, so
that the state at t waits for the gates of all images up to t minus this latency. In real time nothing waits: gates take
effect when they are received.

The filter on corners takes the path of the odometry from its velocity, and smooths that by the accelerometer. The
paper's filter takes position and velocity as they are.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from swift_ros import geometry
from swift_ros.camera.model import Camera
from swift_ros.corner_rays import corner_sigma_rad
from swift_ros.estimation.assignment import Assignment, Match, PoseEstimate, resolve_ambiguity, to_scale
from swift_ros.estimation.corner_filter import CornerFilter
from swift_ros.estimation.drift_filter import DriftFilter
from swift_ros.estimation.input_check import gates_refusal, odometry_refusal
from swift_ros.estimation.podium_check import PodiumCheck
from swift_ros.estimation.repeated_views import RepeatedViews
from swift_ros.estimation.settings import EstimatorSettings
from swift_ros.estimation.specific_force import SpecificForce
from swift_ros.estimation.velocity_path import VelocityPath
from swift_ros.timeline import Timeline
from swift_ros.track import Track
from swift_ros.types import GateUpdate, ImuSample, IncompleteGate, Odometry, RelativeGatePose

MAX_REFUSED_IMAGES = 20  # successive refused images up to which each widens the uncertainty more than the last one
IMAGES_PER_CHECK = 10  # of the calibration; more checks cost time and find an error hardly earlier
CHECKS_IN_A_ROW = 3  # that find an error, before the operator gets it: a second; false gates pass, an error stays
MIN_CONFIDENCE = 0.1  # a message may have a confidence of 0, whose standard deviation would not be finite
NEEDS_WHOLE_GATES = "only the filter on corners uses incomplete gates"
WHOLE_GATES_REFUSED = "whole gates are refused: the estimate may be wrong"
ACCELEROMETER = (
    "the accelerometer does not agree with the odometry, whose velocity is now used without it; compare axes, unit and "
    "calibration of imu/data_raw with base_link"
)
MAX_HELD = 10_000  # states that wait for the gates of an image, 100 s; bounds the memory when a node has died


@dataclass
class EstimatorOutput:
    """Result of one call.

    Attributes:
        states: states in the map, by stamp.
        updates: stamp (ns) of each processed image, and the results of its gates.
        warnings: sentences for the operator.
    """

    states: list[Odometry] = field(default_factory=list)
    updates: list[tuple[int, list[GateUpdate]]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


class StateEstimator:
    """The estimator.

    Args:
        settings: of the node state_estimator.
        track: gates of the map and start of the vehicle.
        camera: the camera.
        lockstep: wait for the gates of each image.
    """

    def __init__(self, settings: EstimatorSettings, track: Track, camera: Camera, lockstep: bool):
        self._settings = settings
        self._track = track
        self._camera = camera
        self._assignment = Assignment(
            track.corners, camera.p_body_camera, settings.gate_chi_square, settings.rival_margin
        )
        self._views = RepeatedViews(settings.corner_bias_share, settings.view_change_deg, camera.p_body_camera)
        self._podium = PodiumCheck(camera, track, self._assignment, settings.gate_chi_square)
        self._said: set[str] = set()  # what was said about calibration and accelerometer
        self._repeated: dict[str, int] = {}  # checks in a row that found each error of the calibration
        self._image_count = 0
        self._lockstep = lockstep
        self._delay_ns = round(camera.processing_latency * 1e9) if lockstep else 0
        self._timeline = Timeline(settings.history_s)
        self._alignment: tuple[np.ndarray, np.ndarray] | None = None
        self._forces = SpecificForce()
        self._path = VelocityPath(settings.vio_return_s)
        self._filter: CornerFilter | DriftFilter | None = None
        self._last_correction_ns = -1
        self._successive_refused = 0
        self._images: deque[int] = deque()  # announced images, whose gates have not come yet
        self._newest_answer_ns = -1
        # Received gates with a stamp, whole and incomplete ones, not yet applied.
        self._answers: deque[tuple[int, list[RelativeGatePose], list[IncompleteGate]]] = deque()
        self._held: deque[Odometry] = deque()

    def image(self, stamp_ns: int) -> None:
        """Announce an image. In lockstep the states then wait for its gates."""
        if self._lockstep and stamp_ns > self._newest_answer_ns:
            self._images.append(stamp_ns)

    def imu(self, sample: ImuSample) -> None:
        """Add a sample of the IMU, in the frame of base_link."""
        self._forces.add(sample)

    def odometry(self, odometry: Odometry) -> EstimatorOutput:
        """Add odometry (odom -> base_link) and return the states that are due."""
        newest = self._held[-1] if self._held else self._timeline.newest
        warning = odometry_refusal(odometry, newest)
        if warning:
            return EstimatorOutput(warnings=[warning])
        if len(self._held) >= MAX_HELD:
            return EstimatorOutput(
                warnings=[f"no gates came for the image with stamp {self._images[0]} ns; odometry is refused"]
            )
        self._held.append(self._align(odometry))
        return self._release()

    def gates(
        self, stamp_ns: int, observations: list[RelativeGatePose], incomplete: Sequence[IncompleteGate] = ()
    ) -> EstimatorOutput:
        """Add the whole and the incomplete gates of the image with stamp `stamp_ns` and return the result."""
        if stamp_ns <= self._newest_answer_ns:
            return EstimatorOutput(
                warnings=[f"gates with stamp {stamp_ns} ns follow gates with stamp {self._newest_answer_ns} ns"]
            )
        self._newest_answer_ns = stamp_ns
        while self._images and self._images[0] <= stamp_ns:
            self._images.popleft()
        warning = gates_refusal(stamp_ns, observations, incomplete)
        self._answers.append((stamp_ns, [], []) if warning else (stamp_ns, observations, list(incomplete)))
        output = self._release()
        if warning:
            output.warnings.append(warning)
        return output

    def _align(self, odometry: Odometry) -> Odometry:
        """Return the odometry in the map according to the start pose; the filters correct the rest."""
        if self._alignment is None:
            self._alignment = _alignment(self._settings.alignment, self._track, odometry)
        q_map_odom, p_map_odom = self._alignment
        q_map_body = geometry.quaternion_multiply(q_map_odom, odometry.q_world_body)
        return replace(
            odometry,
            p_world=geometry.rotate(q_map_odom, odometry.p_world) + p_map_odom,
            q_world_body=geometry.normalize(q_map_body),
        )

    def _release(self) -> EstimatorOutput:
        """Process held odometry, and the gates that are due before it, in the order of their stamps."""
        output = EstimatorOutput()
        while self._held:
            now_ns = self._held[0].stamp_ns
            if self._images and self._images[0] <= now_ns - self._delay_ns:
                return output
            odometry = self._held.popleft()
            if self._settings.filter == "corners":
                odometry = self._path.add(odometry)
            self._timeline.add(odometry)
            if self._filter is None:
                self._filter = self._start_filter(odometry)
            self._advance_filter()
            self._apply_due(now_ns, output)
            output.states.append(_state(odometry, self._filter.pose_estimate(odometry)))
            output.warnings += self._accelerometer_warnings()
        newest = self._timeline.newest
        if newest is not None and not self._lockstep:
            self._apply_due(newest.stamp_ns, output)
        return output

    def _start_filter(self, first: Odometry) -> CornerFilter | DriftFilter:
        if self._settings.filter == "corners":
            return CornerFilter(self._settings, self._camera, self._timeline, self._forces)
        return DriftFilter(self._settings, first)

    def _advance_filter(self) -> None:
        """Propagate the filter to the oldest odometry of the buffer; its process noise depends on the flown path."""
        oldest = self._timeline.oldest
        if oldest is not None and oldest.stamp_ns > self._last_correction_ns:
            self._correct(oldest, [], [])

    def _apply_due(self, now_ns: int, output: EstimatorOutput) -> None:
        """Apply the gates that are due at a time."""
        while self._answers and self._answers[0][0] <= now_ns - self._delay_ns:
            stamp_ns, whole, incomplete = self._answers.popleft()
            output.updates.append((stamp_ns, self._apply(stamp_ns, whole, incomplete)))
            output.warnings += self._calibration_warnings()

    def _accelerometer_warnings(self) -> list[str]:
        """Return once that the accelerometer does not agree with the odometry."""
        agrees = not isinstance(self._filter, CornerFilter) or self._filter.accelerometer_agrees
        if agrees or ACCELEROMETER in self._said:
            return []
        self._said.add(ACCELEROMETER)
        return [ACCELEROMETER]

    def _calibration_warnings(self) -> list[str]:
        """Return what was not said before: on the mount, on each error of the calibration, or on missing gates."""
        self._image_count += 1
        if self._image_count % IMAGES_PER_CHECK or self._filter is None:
            return []
        errors = self._filter.evidence.sentences()
        self._repeated = {name: self._repeated.get(name, 0) + 1 for name in errors}
        sentences = {name: errors[name] for name, times in self._repeated.items() if times >= CHECKS_IN_A_ROW}
        if mount := self._podium.mount_warning():
            sentences = {"mount": mount}
        elif not errors:
            sentences = {"missing gates": self._podium.missing_warning()}
        new = {name: sentence for name, sentence in sentences.items() if sentence and name not in self._said}
        self._said |= set(new)
        return list(new.values())

    def _apply(
        self, stamp_ns: int, observations: list[RelativeGatePose], incomplete: list[IncompleteGate]
    ) -> list[GateUpdate]:
        """Correct the filter at the stamp of an image; return the result of each gate."""
        odometry = self._timeline.at(stamp_ns)
        if odometry is None or stamp_ns < self._last_correction_ns:
            reason = "the buffer holds no odometry for the image's stamp"
            return [_refused(reason) for _ in [*observations, *incomplete]]
        assert self._filter is not None  # it starts with the first odometry of the buffer
        pose_estimate = self._filter.pose_estimate(odometry)
        matches = self._associate(observations, pose_estimate)
        resolved = [self._resolve(*row, pose_estimate.q_map_body) for row in zip(observations, matches, strict=True)]
        reasons = self._correct(odometry, matches, resolved)
        explained = self._podium.explain(odometry, pose_estimate, matches)
        if explained:
            self._filter.observe(odometry, [self._views.weighed(match, pose_estimate) for match in explained])
        if observations:
            self._successive_refused = min(self._successive_refused + 1, MAX_REFUSED_IMAGES) if all(reasons) else 0
            self._filter.add_position_variance(self._successive_refused * self._settings.refusal_widening_m)
        updates = [_update(*row, pose_estimate) for row in zip(matches, resolved, reasons, strict=True)]
        taken = frozenset(match.gate for match in matches)
        return updates + self._apply_incomplete(odometry, incomplete, taken)

    def _apply_incomplete(self, odometry: Odometry, gates: list[IncompleteGate], taken) -> list[GateUpdate]:
        """Correct the filter by incomplete gates after the whole ones of an image; return the result of each gate.

        Two or three corners say less about which gate they belong to. They are compared with the estimate that the
        whole gates have corrected, and not used where these were refused in two successive images.

        Args:
            odometry: at the stamp of the image.
            gates: the incomplete gates.
            taken: indices of the gates of the map that are whole in this image.
        """
        if not gates or not isinstance(self._filter, CornerFilter):
            return [_refused(NEEDS_WHOLE_GATES) for _ in gates]
        if self._successive_refused > 1:
            return [_refused(WHOLE_GATES_REFUSED) for _ in gates]
        matches = self._associate(gates, self._filter.pose_estimate(odometry), taken)
        reasons = self._correct(odometry, matches, [])
        nothing = np.full(3, np.nan)  # without a pose, they imply no position of the vehicle
        return [
            GateUpdate(match.gate, nothing, match.mahalanobis, not reason, reason)
            if match.gate >= 0
            else _refused(reason)
            for match, reason in zip(matches, reasons, strict=True)
        ]

    def _associate(
        self,
        gates: Sequence[RelativeGatePose | IncompleteGate],
        pose_estimate: PoseEstimate,
        taken: frozenset[int] = frozenset(),
    ) -> list[Match]:
        """Return one Match for each observed gate, with the standard deviation of what its view adds."""
        rays = np.array([gate.rays_body for gate in gates]).reshape(-1, 4, 3)
        confidence = np.clip([gate.confidence for gate in gates], MIN_CONFIDENCE, 1.0)
        sigma_deg = self._settings.corner_sigma_deg * confidence**-self._settings.corner_confidence_power
        sigma = corner_sigma_rad(rays, sigma_deg, self._settings.corner_sigma_share)
        matches = self._assignment.assign(rays, sigma, pose_estimate, taken)
        return [self._views.weighed(match, pose_estimate) if match.gate >= 0 else match for match in matches]

    def _resolve(self, observation: RelativeGatePose, match: Match, q_map_body) -> RelativeGatePose:
        """Return the observation with IPPE's better pose first, and with the size of the matched gate."""
        if match.gate < 0:
            return observation
        ratio = self._track.inner_sides[match.gate] / self._track.inner_side
        return to_scale(resolve_ambiguity(observation, match, q_map_body), ratio, self._camera.p_body_camera)

    def _correct(self, odometry: Odometry, matches: list[Match], observations) -> list[str]:
        """Correct the filter; return the reason why each match was refused, "" when it was accepted."""
        assert self._filter is not None  # it starts with the first odometry of the buffer
        self._last_correction_ns = odometry.stamp_ns
        return self._filter.correct(odometry, matches, observations)


def _alignment(kind: str, track: Track, first: Odometry):
    """Return q_map_odom (4,) and p_map_odom (3,): a rotation about the vertical and a translation."""
    if kind == "map":
        return np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3)
    position, attitude = track.start_pose
    yaw = geometry.yaw_of(attitude) - geometry.yaw_of(np.asarray(first.q_world_body))
    q_map_odom = geometry.quaternion_from_yaw(yaw)
    return q_map_odom, position - geometry.rotate(q_map_odom, np.asarray(first.p_world))


def _state(odometry: Odometry, pose_estimate: PoseEstimate) -> Odometry:
    """Return the corrected state; its covariance has rotations about body axes."""
    to_body = np.eye(6)
    to_body[3:, 3:] = geometry.rotation_matrix(pose_estimate.q_map_body).T
    return replace(
        odometry,
        p_world=pose_estimate.p_map,
        q_world_body=pose_estimate.q_map_body,
        v_body=geometry.rotate_inverse(pose_estimate.q_map_body, pose_estimate.v_map),
        covariance_pose=to_body @ pose_estimate.covariance @ to_body.T,
    )


def _refused(reason: str) -> GateUpdate:
    return GateUpdate(-1, np.zeros(3), float("nan"), False, reason)


def _update(match: Match, observation: RelativeGatePose, reason: str, pose_estimate: PoseEstimate) -> GateUpdate:
    if match.gate < 0 or match.corners_map is None:
        return _refused(reason)
    implied = match.corners_map.mean(axis=0) - geometry.rotate(pose_estimate.q_map_body, observation.p_body)
    return GateUpdate(match.gate, implied - pose_estimate.p_map, match.mahalanobis, not reason, reason)
