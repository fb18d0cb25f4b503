"""The state of the vehicle in the map: odometry at its own rate, corrected by the gates of images that come late.

Odometry is buffered by stamp, so that an image's gates are applied where the image was taken, and the correction is
carried on to every odometry stamp. In lockstep nothing is left to chance: an image takes effect exactly
`processing_latency` after its stamp, so that the state at t waits for the answer to every image taken up to t minus
that. In real time nothing waits: gates count from the moment they come.

The velocity handed on is the odometry's own, in the body frame. Adding the estimated rate of the drift makes it worse.
"""

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from swift_ros import geometry
from swift_ros.camera.model import Camera
from swift_ros.corner_rays import corner_sigma_rad
from swift_ros.estimation.assignment import Assignment, Belief, Match, resolve
from swift_ros.estimation.corner_filter import CornerFilter
from swift_ros.estimation.drift_filter import DriftFilter
from swift_ros.estimation.settings import EstimatorSettings
from swift_ros.timeline import Timeline
from swift_ros.track import Track
from swift_ros.types import GateUpdate, Odometry, RelativeGatePose

MOST_WIDENING = 20  # images in a row that widen the doubt more and more
LONGEST_WAIT = 10_000  # states held for an answer; a node that died must not fill the memory


@dataclass
class Output:
    """What a call brought about: states in the map by stamp, what was done with the gates of each image (by its stamp),
    and complaints, each a sentence."""

    states: list[Odometry] = field(default_factory=list)
    updates: list[tuple[int, list[GateUpdate]]] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)


class StateEstimator:
    def __init__(self, settings: EstimatorSettings, track: Track, camera: Camera, lockstep: bool):
        self._settings = settings
        self._track = track
        self._camera = camera
        self._focal_px = 0.5 * (camera.fx + camera.fy)
        self._assignment = Assignment(
            track.corners, camera.p_body_camera, settings.gate_chi_square, settings.rival_margin
        )
        self._lockstep = lockstep
        self._delay_ns = round(camera.processing_latency * 1e9) if lockstep else 0
        self._timeline = Timeline(settings.history_s)
        self._alignment = None
        self._filter = None
        self._last_correction_ns = -1
        self._refused_in_a_row = 0
        self._images: deque[int] = deque()  # announced, not yet answered
        self._newest_answer_ns = -1
        self._answers: deque[tuple[int, list[RelativeGatePose]]] = deque()  # answered, not yet applied
        self._held: deque[Odometry] = deque()

    def image(self, stamp_ns: int) -> None:
        """An image was taken. In lockstep its answer is waited for, however late it comes."""
        if self._lockstep and stamp_ns > self._newest_answer_ns:
            self._images.append(stamp_ns)

    def odometry(self, odometry: Odometry) -> Output:
        """Take odometry (odom -> base_link) and return the states that are due."""
        newest = self._held[-1] if self._held else self._timeline.newest
        complaint = _complaint(odometry, newest)
        if complaint:
            return Output(complaints=[complaint])
        if len(self._held) >= LONGEST_WAIT:
            return Output(complaints=[f"the gates of image {self._images[0]} ns never came; odometry is left out"])
        self._held.append(self._align(odometry))
        return self._release()

    def gates(self, stamp_ns: int, sightings: list[RelativeGatePose]) -> Output:
        """Take the gates of the image of `stamp_ns` and return what this brought about."""
        if stamp_ns <= self._newest_answer_ns:
            return Output(complaints=[f"gates of stamp {stamp_ns} ns follow those of {self._newest_answer_ns} ns"])
        self._newest_answer_ns = stamp_ns
        while self._images and self._images[0] <= stamp_ns:
            self._images.popleft()
        sound = all(np.isfinite(s.rays_body).all() and np.isfinite(s.covariance).all() for s in sightings)
        self._answers.append((stamp_ns, sightings if sound else []))
        output = self._release()
        if not sound:
            output.complaints.append(f"gates of stamp {stamp_ns} ns hold what is not a number; they are left out")
        return output

    def _align(self, odometry: Odometry) -> Odometry:
        """Return the odometry in the map as the start says they lie; the filters correct the rest."""
        if self._alignment is None:
            self._alignment = _alignment(self._settings.alignment, self._track, odometry)
        q_map_odom, p_map_odom = self._alignment
        q_map_body = geometry.quaternion_multiply(q_map_odom, odometry.q_world_body)
        return replace(
            odometry,
            p_world=geometry.rotate(q_map_odom, odometry.p_world) + p_map_odom,
            q_world_body=geometry.normalize(q_map_body),
        )

    def _release(self) -> Output:
        """Work off, in the order of their stamps, held odometry and the answers that are due before it."""
        output = Output()
        while self._held:
            now_ns = self._held[0].stamp_ns
            if self._images and self._images[0] <= now_ns - self._delay_ns:
                return output
            odometry = self._held.popleft()
            if self._filter is None:
                self._filter = self._start_filter(odometry)
            self._timeline.add(odometry)
            self._keep_up()
            self._apply_due(now_ns, output)
            output.states.append(_state(odometry, self._filter.belief(odometry)))
        newest = self._timeline.newest
        if newest is not None and not self._lockstep:
            self._apply_due(newest.stamp_ns, output)
        return output

    def _start_filter(self, first: Odometry) -> CornerFilter | DriftFilter:
        if self._settings.filter == "corners":
            return CornerFilter(self._settings, self._camera.p_body_camera, first)
        return DriftFilter(self._settings, first)

    def _keep_up(self) -> None:
        """Move the filter on to the oldest odometry that an image may still refer to: the drift grows with the path."""
        oldest = self._timeline.oldest
        if oldest.stamp_ns > self._last_correction_ns:
            self._correct(oldest, [], [])

    def _apply_due(self, now_ns: int, output: Output) -> None:
        while self._answers and self._answers[0][0] <= now_ns - self._delay_ns:
            stamp_ns, sightings = self._answers.popleft()
            output.updates.append((stamp_ns, self._apply(stamp_ns, sightings)))

    def _apply(self, stamp_ns: int, sightings: list[RelativeGatePose]) -> list[GateUpdate]:
        """Correct the filter where the image was taken."""
        odometry = self._timeline.at(stamp_ns)
        if odometry is None or stamp_ns < self._last_correction_ns:
            reason = "no odometry is kept for the image's stamp"
            return [GateUpdate(-1, np.zeros(3), float("nan"), False, reason) for _ in sightings]
        if not sightings:
            self._correct(odometry, [], [])
            return []
        belief = self._filter.belief(odometry)
        rays = np.array([sighting.rays_body for sighting in sightings])
        sigma = corner_sigma_rad(
            rays, self._settings.corner_sigma_px, self._settings.corner_sigma_share, self._focal_px
        )
        matches = self._assignment.assign(rays, sigma, belief)
        resolved = [resolve(s, m, belief.q_map_body) for s, m in zip(sightings, matches, strict=True)]
        reasons = self._correct(odometry, matches, resolved)
        self._refused_in_a_row = min(self._refused_in_a_row + 1, MOST_WIDENING) if all(reasons) else 0
        self._filter.widen(self._refused_in_a_row * self._settings.refusal_widening_m)
        return [_update(*row, belief) for row in zip(matches, resolved, reasons, strict=True)]

    def _correct(self, odometry: Odometry, matches: list[Match], sightings) -> list[str]:
        self._last_correction_ns = odometry.stamp_ns
        return self._filter.correct(odometry, matches, sightings)


def _alignment(kind: str, track: Track, first: Odometry):
    """Return (q_map_odom (4,), p_map_odom (3,)): odom is turned about the vertical and moved, never tilted."""
    if kind == "map":
        return np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3)
    position, attitude = track.start_pose
    yaw = geometry.yaw_of(attitude) - geometry.yaw_of(np.asarray(first.q_world_body))
    q_map_odom = geometry.quaternion_from_yaw(yaw)
    return q_map_odom, position - geometry.rotate(q_map_odom, np.asarray(first.p_world))


def _complaint(odometry: Odometry, newest: Odometry | None) -> str:
    if newest is not None and odometry.stamp_ns <= newest.stamp_ns:
        return f"odometry of stamp {odometry.stamp_ns} ns follows one of {newest.stamp_ns} ns; it was left out"
    values = np.concatenate([odometry.p_world, odometry.q_world_body, odometry.v_body, odometry.omega_body])
    if not np.isfinite(values).all():
        return f"odometry of stamp {odometry.stamp_ns} ns holds a value that is not a number; it was left out"
    return ""


def _state(odometry: Odometry, belief: Belief) -> Odometry:
    """Return the corrected state; the record's covariance has rotations about body axes."""
    to_body = np.eye(6)
    to_body[3:, 3:] = geometry.rotation_matrix(belief.q_map_body).T
    return replace(
        odometry,
        p_world=belief.p_map,
        q_world_body=belief.q_map_body,
        covariance_pose=to_body @ belief.covariance @ to_body.T,
    )


def _update(match: Match, sighting: RelativeGatePose, reason: str, belief: Belief) -> GateUpdate:
    if match.gate < 0:
        return GateUpdate(-1, np.zeros(3), float("nan"), False, reason)
    implied = match.corners_map.mean(axis=0) - geometry.rotate(belief.q_map_body, sighting.p_body)
    return GateUpdate(match.gate, implied - belief.p_map, match.mahalanobis, not reason, reason)
