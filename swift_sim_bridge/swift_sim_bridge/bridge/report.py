"""What the simulator alone knows of a race, for `result.json`: hashes of what was exchanged, thrust, what was late."""

from dataclasses import dataclass

from swift_sim_bridge.simulation.simulated_vehicle import SimulatedVehicle


@dataclass(frozen=True)
class _Mark:
    """Where a flight was before a tick: `stamp_ns` and hashes include the state of that stamp and its answer."""

    stamp_ns: int
    msp_sha256: str
    truth_sha256: str
    pack: tuple[float, float, dict | None]
    ticks: int


class RaceReport:
    """Keeps marks of a flight and turns them into the report.

    Only in real time: late_ticks, begun more than 10 ms late; late_commands, ticks while armed without a new command;
    late_images, not drawn because the one before was not done. Only with a real firmware that flies by the wall clock:
    firmware_drift_s, the most by which simulated time lagged behind it.
    """

    def __init__(self, seed: int, vehicle: SimulatedVehicle):
        self._seed, self._vehicle = seed, vehicle
        self._marks = [self._mark(-1)]
        self._end_ns: int | None = None
        self.late_ticks = self.late_commands = self.late_images = 0

    def _mark(self, stamp_ns: int) -> _Mark:
        v = self._vehicle
        return _Mark(stamp_ns, v.flight_controller.commands_sha256, v.truth_sha256, v.pack, v.tick)

    def note(self, stamp_ns: int) -> None:
        """Take note of the flight as it is when the state of `stamp_ns` has been answered."""
        self._marks.append(self._mark(stamp_ns))

    def end(self, stamp_ns: int) -> None:
        """Take the race for ended. When that becomes known depends on the machine; what was flown before does not."""
        self._end_ns = stamp_ns if self._end_ns is None else self._end_ns

    def as_dict(self) -> dict:
        """Return the report of the race up to its end, or of all that was flown where it has none."""
        last = self._mark(-1)
        if self._end_ns is not None:
            last = next(mark for mark in reversed(self._marks) if mark.stamp_ns < self._end_ns)
        packs = (self._marks[0].pack, last.pack)
        firmware = self._vehicle.firmware
        paced = firmware is not None and not firmware.sitl.stepped
        drift = {"firmware_drift_s": round(firmware.worst_s, 4)} if paced else {}
        return {
            "seed": self._seed,
            "thrust_to_weight": [round(self._vehicle.thrust_to_weight(pack), 4) for pack in packs],
            "msp_sha256": last.msp_sha256,
            "truth_sha256": last.truth_sha256,
            "ticks": last.ticks,
            "contact": self._vehicle.crash,
            "disarmed_s": self._vehicle.disarmed_s,
            "late_ticks": self.late_ticks,
            "late_commands": self.late_commands,
            "late_images": self.late_images,
            **drift,
        }
