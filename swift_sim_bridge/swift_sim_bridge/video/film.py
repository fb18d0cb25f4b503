"""The frames of the video of a flight."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from swift_ros.race.judge import FINISHED
from swift_sim_bridge.video import chase, shapes
from swift_sim_bridge.video.dashboard import Dashboard
from swift_sim_bridge.video.flight import Flight
from swift_sim_bridge.video.hall import Hall
from swift_sim_bridge.video.onboard import Onboard
from swift_sim_bridge.video.painter import Faces, View, paint

ASPECT = 16 / 9
FOCAL_SHARE = 0.60  # of a frame's width: a horizontal field of view of 80 degrees
BEFORE_S, AFTER_S = 1.0, 2.0  # of the recording that a video of a race shows before the start and after the end
FLASH_S = 0.45  # for which a gate that was just passed is green
INSET = (950, 24, 306)  # left, top, side of the onboard image, px of a frame with a height of 720
NOWHERE = np.zeros(3), np.eye(3)


@dataclass(frozen=True)
class Cut:
    """What a video shows.

    Attributes:
        height: of a frame, px.
        fps: frames a second.
        slow: s of video for a second of flight.
        first_s, last_s: of the flight; None: a second before the start signal, two after the end of the race.
    """

    height: int = 720
    fps: float = 30.0
    slow: float = 1.0
    first_s: float | None = None
    last_s: float | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of a frame, px; both are even, as the format demands."""
        return 2 * round(self.height * ASPECT / 2), self.height


def frame_times(flight: Flight, cut: Cut) -> np.ndarray:
    """Return the times of the frames, s of the flight, within the recorded poses; empty where none is left."""
    first, last = float(flight.path.t[0]), float(flight.path.t[-1])
    if flight.events:
        first = max(first, -BEFORE_S)
        if flight.end is not None:
            last = min(last, flight.seconds(flight.end.stamp_ns) + AFTER_S)
    first = first if cut.first_s is None else max(cut.first_s, float(flight.path.t[0]))
    last = last if cut.last_s is None else min(cut.last_s, float(flight.path.t[-1]))
    return first + np.arange(max(int((last - first) * cut.fps * cut.slow + 1e-6), 0)) / (cut.fps * cut.slow)


class Film:
    """Draws the frames of a flight, in the order of time."""

    def __init__(self, flight: Flight, seed: int, cut: Cut):
        """Make it.

        Args:
            flight: that is shown.
            seed: of the hall's surfaces.
            cut: what is shown of it.
        """
        self._flight, self._cut = flight, cut
        width, height = cut.size
        self._view = View(width, height, FOCAL_SHARE * width, *NOWHERE)
        self._hall = Hall(flight, seed, self._view)
        self._craft = shapes.Craft(flight.vehicle)
        self._dashboard = Dashboard(flight, height)
        scale = height / 720
        self._inset = [round(scale * length) for length in INSET]
        self._onboard = Onboard(self._inset[2], flight.camera, flight.track)
        self._fastest = max(float(np.linalg.norm(flight.path.v_world, axis=1).max()), 1.0)

    def views(self, times) -> list[View]:
        """Return the chase camera at times (m,) s."""
        room = self._hall.room
        cameras = chase.follow(self._flight.path, times, room.low, room.high)
        sizes = self._view.width, self._view.height, self._view.focal_px
        return [View(*sizes, p, rotation) for p, rotation in zip(cameras.p_world, cameras.rotations, strict=True)]

    def frames(self, times) -> Iterator[np.ndarray]:
        """Yield the frames (H, W, 3) BGR uint8 at times (m,) s, which must increase."""
        flight = self._flight
        images = _Newest(flight.images())
        poses = flight.path.at(times)
        for i, view in enumerate(self.views(times)):
            t = float(times[i])
            frame = self._hall.image(view)
            paint(frame, view, [shapes.shadow(flight.vehicle, poses.p_world[i], float(self._hall.room.low[2]))])
            batches = self._craft.faces(poses.p_world[i], poses.q_world_body[i], t)
            batches.append(shapes.trail(flight.path, t, view.p_world, self._fastest))
            if flight.track is not None:
                batches.append(self._gates(t, view))
            paint(frame, view, batches)
            newest = images.at(flight.begin_ns + round(1e9 * t))
            if newest is not None:
                self._draw_onboard(frame, *newest)
            self._dashboard.draw(frame, t, newest is not None)
            yield frame

    def _gates(self, t: float, view: View) -> Faces:
        """Return the gates: the next one in amber, one that was just passed in green."""
        flight, count = self._flight, len(self._flight.track.gates)
        colors = [shapes.STEEL] * count
        passed = [event for event in flight.passages if flight.seconds(event.stamp_ns) <= t]
        is_over = flight.end is not None and t >= flight.seconds(flight.end.stamp_ns)
        next_gate = passed[-1].next_gate if passed else 0
        if flight.events and not is_over:
            colors[next_gate] = shapes.AMBER
        if is_over and flight.end.state != FINISHED:
            colors[next_gate] = shapes.RED
        if passed and t - flight.seconds(passed[-1].stamp_ns) < FLASH_S:
            colors[(next_gate - 1) % count] = shapes.GREEN
        return shapes.gates(flight.track, colors, view.p_world)

    def _draw_onboard(self, frame, stamp_ns: int, image) -> None:
        flight, (left, top, side) = self._flight, self._inset
        pose = None if flight.estimate is None else flight.estimate.at([flight.seconds(stamp_ns)])
        place = frame[top : top + side, left : left + side]
        self._onboard.draw(place, image, flight.detections.get(stamp_ns, []), pose)


class _Newest:
    """The newest image at times that increase, from a stream of (stamp_ns, image)."""

    def __init__(self, stream):
        self._stream, self._now = stream, None
        self._next = next(stream, None)

    def at(self, stamp_ns: int):
        """Return the last (stamp_ns, image) up to a stamp (ns); None before the first."""
        while self._next is not None and self._next[0] <= stamp_ns:
            self._now, self._next = self._next, next(self._stream, None)
        return self._now
