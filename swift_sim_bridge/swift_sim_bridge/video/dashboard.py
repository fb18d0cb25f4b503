"""Times, gates, speed, thrust, battery and error of the estimate as texts, bars and a curve over a frame."""

from typing import NamedTuple

import cv2
import numpy as np

from swift_ros.race.judge import FINISHED
from swift_ros.recording.flight_table import Samples
from swift_sim_bridge.video.flight import Flight
from swift_sim_bridge.video.painter import fill
from swift_sim_bridge.video.shapes import AMBER, BLUE, GREEN, RED, speed_colors

HEIGHT = 720  # px; all measures below are of a frame with this height
WHITE, GREY, DARK = (245, 245, 245), (175, 170, 165), (26, 20, 16)
STRIP = 112  # px, height of the strip at the bottom
CHART = (214, 634, 520, 62)  # left, top, width, height of the curve of speed
FULL_ERROR_M = 0.5  # of the bar of the estimate's error
CELL_V = (3.3, 4.2)  # of the bar of the battery
NAME = 26  # characters of a bag's name that the panel holds
STALE_S = 0.5  # a value is not shown longer than this without a new sample
BANNER_S = 0.35  # before the end of the race, at which the banner has its full height
LIGHT, BOLD = 400, 700  # weights of the font


class Bar(NamedTuple):
    """A value with its bar: where it stands (px), texts, share of the bar, color."""

    left: int
    label: str
    text: str
    unit: str
    share: float
    color: tuple


class Dashboard:
    """Draws the state of a flight over frames of one size."""

    def __init__(self, flight: Flight, height: int):
        """Make it for frames of a height (px)."""
        self._flight, self._scale = flight, height / HEIGHT
        self._font = cv2.FontFace("sans")
        self._speed = np.linalg.norm(flight.path.v_world, axis=1)
        self._fastest = max(float(self._speed.max()), 1.0)
        self._most_thrust = max(float(flight.thrust.values.max(initial=0.0)), 1.0)
        self._first_s = 0.0 if flight.events else float(flight.path.t[0])
        self._last_s = flight.seconds(flight.end.stamp_ns) if flight.end else float(flight.path.t[-1])
        self._chart = self._speed_chart()
        self._ahead = np.where(self._chart.any(axis=2, keepdims=True), np.uint8(78), np.uint8(0)).repeat(3, axis=2)

    def draw(self, frame, t: float, has_image: bool) -> None:
        """Draw the state at a time (s) over a frame."""
        top = self._px(HEIGHT - STRIP)
        _darken(frame[top:], 0.74)
        self._draw_speed(frame, t)
        self._draw_chart(frame, t)
        for bar in self._bars(t):
            self._draw_bar(frame, bar)
        self._draw_race(frame, t)
        if has_image:
            self._draw_legend(frame)
        end = self._flight.end
        if end is not None and t >= self._last_s:
            finished = end.state == FINISHED
            text = f"FINISHED   {self._last_s:.2f} s" if finished else f"{end.state.upper()}: {end.text}"
            self._draw_banner(frame, text, GREEN if finished else RED)
        elif self._flight.notes and t >= self._flight.path.t[-1] - BANNER_S and self._flight.end is None:
            self._draw_banner(frame, "THE RECORDING ENDS HERE", AMBER)

    def _px(self, length: float) -> int:
        return round(length * self._scale)

    def _text(self, frame, text: str, place, size: int, color=WHITE, weight=LIGHT) -> int:
        """Write a text whose baseline begins at a place (px of a frame of 720); return where it ends."""
        at = self._px(place[0]), self._px(place[1])
        (end, _), _ = cv2.putText(frame, text, at, color, self._font, max(self._px(size), 6), weight)
        return round(end / self._scale)

    def _draw_speed(self, frame, t: float) -> None:
        self._text(frame, "SPEED", (36, 636), 15, GREY)
        end = self._text(frame, f"{np.interp(t, self._flight.path.t, self._speed):.1f}", (34, 692), 54, WHITE, BOLD)
        self._text(frame, "m/s", (end + 8, 692), 20, GREY)

    def _speed_chart(self) -> np.ndarray:
        """Return the curve of speed over the flight, filled with its colors, (h, w, 3)."""
        width, height = self._px(CHART[2]), self._px(CHART[3])
        at = np.linspace(self._first_s, self._last_s, width)
        speed = np.interp(at, self._flight.path.t, self._speed)
        chart = np.zeros((height, width, 3), np.uint8)
        below = np.arange(height)[:, None] >= height - height * speed / self._fastest
        return np.where(below[..., None], speed_colors(speed, self._fastest)[None].astype(np.uint8), chart)

    def _draw_chart(self, frame, t: float) -> None:
        left, top, width, height = map(self._px, CHART)
        place = frame[top : top + height, left : left + width]
        span = max(self._last_s - self._first_s, 1e-3)
        flown = int(np.clip((t - self._first_s) / span, 0, 1) * width)
        cv2.max(place[:, :flown], self._chart[:, :flown], dst=place[:, :flown])
        cv2.max(place[:, flown:], self._ahead[:, flown:], dst=place[:, flown:])
        for event in self._flight.passages:
            x = left + int((self._flight.seconds(event.stamp_ns) - self._first_s) / span * width)
            color = WHITE if event.next_gate == 1 % len(self._flight.track.gates) else GREY
            cv2.line(frame, (x, top + height), (x, top + height + self._px(6)), color, 1)
        if 0 < flown < width:
            cv2.line(frame, (left + flown, top - self._px(6)), (left + flown, top + height), WHITE, max(1, self._px(2)))

    def _bars(self, t: float) -> list[Bar]:
        flight, bars = self._flight, []
        thrust, voltage = _value(flight.thrust, t), _value(flight.voltage, t)
        if thrust is not None:
            bars.append(Bar(772, "THRUST", f"{thrust:.1f}", "m/s²", thrust / self._most_thrust, AMBER))
        if voltage is not None:
            low, high = (flight.cells * cell for cell in CELL_V)
            share = np.clip((voltage - low) / (high - low), 0, 1) if flight.cells else 1.0
            bars.append(Bar(938, "BATTERY", f"{voltage:.1f}", "V", float(share), GREEN if share > 0.25 else RED))
        error = None if flight.error is None else _value(flight.error, t)
        if error is not None:
            color = GREEN if error < 0.2 else RED
            bars.append(Bar(1104, "ESTIMATE ERROR", f"{100 * error:.0f}", "cm", min(error / FULL_ERROR_M, 1), color))
        return bars

    def _draw_bar(self, frame, bar: Bar) -> None:
        self._text(frame, bar.label, (bar.left, 636), 15, GREY)
        end = self._text(frame, bar.text, (bar.left, 672), 32, WHITE, BOLD)
        self._text(frame, bar.unit, (end + 6, 672), 18, GREY)
        corners = np.array([(0, 684), (140, 684), (140, 692), (0, 692)], float) + [bar.left, 0]
        fill(frame, self._scale * corners, (70, 62, 56))
        corners[1:3, 0] = bar.left + 140 * np.clip(bar.share, 0.0, 1.0)
        fill(frame, self._scale * corners, bar.color)

    def _draw_race(self, frame, t: float) -> None:
        """Draw time, lap and gate, and the laps that are done."""
        flight, track = self._flight, self._flight.track
        panel = frame[self._px(20) : self._px(146), self._px(24) : self._px(320)]
        _darken(panel, 0.68)
        shown = min(max(t, self._first_s), self._last_s) if flight.events else t
        end = self._text(frame, f"{shown:.2f}", (40, 72), 46, WHITE, BOLD)
        self._text(frame, "s", (end + 8, 72), 22, GREY)
        if track is None or not flight.events:
            self._text(frame, flight.bag.stem[:NAME], (40, 106), 18, GREY)
            return
        passed = [event for event in flight.passages if flight.seconds(event.stamp_ns) <= t]
        gates = len(track.gates)
        lap = min(max(len(passed) - 1, 0) // gates + 1, track.laps)
        gate = (passed[-1].next_gate if passed else 0) + 1
        finished = len(passed) == track.passages
        text = f"lap {lap} of {track.laps}" + ("" if finished else f"    gate {gate} of {gates}")
        self._text(frame, text, (40, 104), 22, WHITE)
        starts = [flight.seconds(event.stamp_ns) for event in passed[::gates]]
        laps = "    ".join(f"{lap:.2f} s" for lap in np.diff(starts))
        self._text(frame, laps or track.name, (40, 132), 18, GREY)

    def _draw_legend(self, frame) -> None:
        _darken(frame[self._px(338) : self._px(362), self._px(856) : self._px(1262)], 0.5)
        at = 868
        parts = ("onboard", GREY), ("detected", GREEN), ("incomplete", BLUE), ("map at the estimate", AMBER)
        for text, color in parts:
            at = self._text(frame, text, (at, 355), 15, color) + 12

    def _draw_banner(self, frame, text: str, color) -> None:
        (_, _, width, _) = cv2.getTextSize((0, 0), text, (0, 0), self._font, self._px(34), BOLD)
        width = width / self._scale
        left, top = 0.5 * (frame.shape[1] / self._scale - width), 540
        panel = frame[
            self._px(top - 42) : self._px(top + 18), max(self._px(left - 24), 0) : self._px(left + width + 24)
        ]
        _darken(panel, 0.72)
        self._text(frame, text, (left, top), 34, color, BOLD)


def _value(samples: Samples, t: float) -> float | None:
    """Return the newest sample at a time (s); None without a recent one."""
    i = int(np.searchsorted(samples.t, t, side="right")) - 1
    return float(samples.values[i]) if i >= 0 and t - samples.t[i] <= STALE_S else None


def _darken(part, opacity: float) -> None:
    """Blend a part of a frame with a dark color."""
    cv2.addWeighted(part, 1.0 - opacity, np.full_like(part, DARK), opacity, 0.0, dst=part)
