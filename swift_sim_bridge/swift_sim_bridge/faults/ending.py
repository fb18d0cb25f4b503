"""How a race with a fault ended, from its bag, the simulator's report and the logs of its nodes."""

import contextlib
import dataclasses
import json
import warnings
from pathlib import Path

from swift_ros.errors import DamagedRecording, UsageError
from swift_ros.graph.topic_table import NODES, full_name
from swift_ros.messages.stamps import message_stamp_ns
from swift_ros.race.judge import ENDS, FINISHED, LOST, RACING
from swift_ros.race.result import BAG, REPORT
from swift_ros.recording import bags
from swift_ros.recording.race_bag import read_record
from swift_sim_bridge.faults.catalogue import DISK, FLIGHT_CONTROLLER, FOREIGN_PUBLISHER, SERIAL, TIME_JUMP, Fault
from swift_sim_bridge.faults.injection import Flown

SAFE_S = 0.3  # s, longest time to the first safe frame
REST_M_S = 0.3  # m/s, a vehicle that is slower lies on the ground
FINISHED_RACE, LANDED, FELL, STRUCK = "finished", "landed", "fell", "struck a gate"
ENDINGS = (FINISHED_RACE, LANDED, FELL, STRUCK)


@dataclasses.dataclass(frozen=True)
class Ending:
    """How a race with a fault ended.

    Attributes:
        fault: the fault.
        way: one of ENDINGS.
        reason: what ended the race, by the race monitor or the runner.
        safe_s: s from the fault, or from the end of the race if that is later, to the first safe frame; None where no
            safe frame came before the flight's finish or after its link was lost.
        impact_m_s: closing speed of a crash, m/s; None without one.
        problems: sentences that say why the ending counts as undefined; empty for a defined one.
    """

    fault: Fault
    way: str
    reason: str
    safe_s: float | None
    impact_m_s: float | None
    problems: tuple[str, ...]


def ending_of(fault: Fault, flown: Flown, folder: Path) -> Ending:
    """Return the ending of a race whose files are in `folder`."""
    report = json.loads((folder / REPORT).read_text()) if (folder / REPORT).is_file() else {}
    end, impact = flown.end, report.get("impact_m_s")
    state, reason = (end.state, end.text) if end else ("", "")
    if state == FINISHED:
        way = FINISHED_RACE
    elif impact is None:
        way = LANDED
    else:
        way = STRUCK if "gate" in report["contact"] else FELL
    flown = _timed_by_bag(fault, flown, folder / BAG)
    safe_s = _stopped_s(fault, _safe_s(fault, flown), report)
    problems = [
        *_undefined_course(fault, flown, report),
        *_undefined_time(fault, flown, safe_s),
        *_unreadable_bag(fault, folder),
        *_tracebacks(folder),
    ]
    return Ending(fault, way, reason, safe_s, impact, tuple(problems))


def _timed_by_bag(fault: Fault, flown: Flown, bag: Path) -> Flown:
    """Return the flight with the times of its end and of its first safe frame from the bag, where it has them.

    In real time the process that planted the fault may lag. Stamps that jump are replaced by the times of reception.
    """
    status, link, jumps = full_name("race/status"), full_name("betaflight/link"), fault.kind == TIME_JUMP
    start_ns = end_ns = safe_ns = None
    with warnings.catch_warnings(), contextlib.suppress(UsageError):  # `_unreadable_bag` names what is wrong with it
        warnings.simplefilter("ignore")
        for topic, message, log_ns in bags.read(bag, [status, link]):
            time_ns = log_ns if jumps else message_stamp_ns(message)
            if topic == status and message.state == RACING and start_ns is None:
                start_ns = time_ns
            elif topic == status and message.state in ENDS and end_ns is None:
                end_ns = time_ns
            elif topic == link and safe_ns is None and start_ns is not None and time_ns > start_ns:
                safe_ns = time_ns if message.failsafe or not message.armed else None
    if flown.end and end_ns is not None:
        flown = dataclasses.replace(flown, end=dataclasses.replace(flown.end, stamp_ns=end_ns))
    return flown if safe_ns is None else dataclasses.replace(flown, safe_ns=safe_ns)


def _safe_s(fault: Fault, flown: Flown) -> float | None:
    """Return the time to the first safe frame, from the later of the fault and the end of the race."""
    if fault.target == FLIGHT_CONTROLLER:  # it stops the motors itself; no link status shows that while it restarts
        return None
    if flown.fault_ns is None or flown.end is None or flown.safe_ns is None or flown.end.state == FINISHED:
        return None
    begin_ns = max(flown.fault_ns, min(flown.end.stamp_ns, flown.safe_ns))
    return max(0.0, round(1e-9 * (flown.safe_ns - begin_ns), 3))


def _stopped_s(fault: Fault, safe_s: float | None, report: dict) -> float | None:
    """Return the time to the first safe frame, or from a crash to the stop of the motors where that is earlier.

    A serial line that loses bytes delays the flight controller's own report that it is disarmed.
    """
    crash_s, disarmed_s = report.get("crash_s"), report.get("disarmed_s")
    if fault.target != SERIAL or safe_s is None or crash_s is None or disarmed_s is None:
        return safe_s
    return min(safe_s, round(max(0.0, disarmed_s - crash_s), 3))


def _undefined_course(fault: Fault, flown: Flown, report: dict) -> list[str]:
    """Return what no race may do."""
    found = []
    if flown.fault_ns is None:
        found.append("the race ended before the fault")
    if flown.end is None:
        return [*found, "the race has no end"]
    if flown.end.state == LOST and not flown.end.text:
        found.append("the race was lost without a reason")
    if not report:
        found.append("the simulator left no report")
    elif report["speed_m_s"] > REST_M_S and report.get("disarmed_s") is None:
        # with stopped motors it may still slip off the gate that it hangs on, long after the crash
        found.append(f"at the end the vehicle moves at {report['speed_m_s']:.1f} m/s")
    if flown.end.state != FINISHED:
        unneeded = fault.target == DISK or fault.target in NODES and not NODES[fault.target].needed
        if unneeded:
            found.append(f"a fault of {fault.target}, which the flight does not need, ended it")
        if fault.kind == FOREIGN_PUBLISHER:
            found.append("another publisher ended the flight")
    return found


def _undefined_time(fault: Fault, flown: Flown, safe_s: float | None) -> list[str]:
    """Return what came too late."""
    found = []
    if safe_s is not None and safe_s > SAFE_S:
        found.append(f"the first safe frame came {safe_s:.2f} s after the end of the race")
    # the link status ends with its node, and the firmware's failsafe ends the flight; or the motors have stopped
    blind = fault.target in ("betaflight", FLIGHT_CONTROLLER)
    if flown.end and flown.end.state != FINISHED and flown.safe_ns is None and not blind:
        found.append("no safe frame was sent")
    return found


def _unreadable_bag(fault: Fault, folder: Path) -> list[str]:
    """Return why the bag cannot be read; damage is expected only where the recorder itself was the target."""
    own = fault.target in ("recorder", DISK)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            record = read_record(folder / BAG)
        except UsageError as error:
            return [f"the bag cannot be read: {error}"]
    damage = [str(one.message) for one in caught if issubclass(one.category, DamagedRecording)]
    if damage and not own:
        return [f"the bag is damaged: {damage[0]}"]
    return [] if record.start_ns is not None else ["the bag does not hold the start of the race"]


def _tracebacks(folder: Path) -> list[str]:
    """Return the nodes whose log has a traceback."""
    logs = sorted((folder / "logs").glob("*.log"))
    return [f"{path.stem} ended in a traceback" for path in logs if b"Traceback (most recent call" in path.read_bytes()]
