"""The simulator's part of `result.json`: hashes of commands and ground truth, thrust-to-weight, late events."""

from collections import deque
from dataclasses import dataclass

from swift_sim_bridge.simulation.simulated_vehicle import SimulatedVehicle

MARKS = (
    6000  # ticks of 10 ms whose marks are kept: an end is announced at most so long after it, also by a slow machine
)


@dataclass(frozen=True)
class _Mark:
    """State of a flight before a tick; the hashes include the ground truth of `stamp_ns` and the answer to it."""

    stamp_ns: int
    msp_sha256: str
    truth_sha256: str
    pack: tuple
    ticks: int


class RaceReport:
    """Records marks of a flight and makes the report of the last flight from them.

    With a real firmware that runs by the wall clock the report also has `firmware_drift_s`, the largest lag of
    simulated time behind the wall clock.

    Attributes:
        late_ticks: in real time, ticks begun more than 10 ms late.
        late_commands: in real time, ticks while armed without a new command.
        late_images: in real time, images not drawn because the previous one was still being drawn.
    """

    def __init__(self, seed: int, vehicle: SimulatedVehicle):
        self._seed, self._vehicle = seed, vehicle
        self._start = self._mark(-1)
        self._marks = deque([self._start], maxlen=MARKS)
        self._end_ns: int | None = None
        self.late_ticks = self.late_commands = self.late_images = 0

    def _mark(self, stamp_ns: int) -> _Mark:
        v = self._vehicle
        return _Mark(stamp_ns, v.flight_controller.commands_sha256, v.truth_sha256, v.pack, v.tick)

    def note(self, stamp_ns: int) -> None:
        """Record a mark of the flight when the state of `stamp_ns` has been answered."""
        self._marks.append(self._mark(stamp_ns))

    def arm(self) -> None:
        """Begin the report of another flight, if one has ended."""
        if self._end_ns is not None:
            self._start, self._end_ns = self._mark(-1), None

    def end(self, stamp_ns: int) -> None:
        """End the race at a stamp; ticks flown after it, whose number depends on the machine, are not reported."""
        self._end_ns = stamp_ns if self._end_ns is None else self._end_ns

    def as_dict(self) -> dict:
        """Return the report of the race up to its end, or up to now if the race has not ended."""
        last = self._mark(-1)
        if self._end_ns is not None:
            before = (mark for mark in reversed(self._marks) if mark.stamp_ns < self._end_ns)
            last = next(before, self._marks[0])
        packs = (self._start.pack, last.pack)
        firmware = self._vehicle.firmware
        by_wall_clock = firmware is not None and not firmware.sitl.stepped
        drift = {"firmware_drift_s": round(firmware.max_drift_s, 4)} if by_wall_clock else {}
        return {
            "seed": self._seed,
            "thrust_to_weight": [round(self._vehicle.thrust_to_weight(pack), 4) for pack in packs],
            "msp_sha256": last.msp_sha256,
            "truth_sha256": last.truth_sha256,
            "ticks": last.ticks,
            "contact": self._vehicle.crash,
            "impact_m_s": self._vehicle.impact_m_s,
            "speed_m_s": round(self._vehicle.speed_m_s, 3),
            "crash_s": self._vehicle.crash_s,
            "disarmed_s": self._vehicle.disarmed_s,
            "late_ticks": self.late_ticks,
            "late_commands": self.late_commands,
            "late_images": self.late_images,
            **drift,
        }
