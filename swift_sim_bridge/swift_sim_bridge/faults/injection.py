"""A race with a fault."""

import contextlib
import dataclasses
import json
import math
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

from swift_ros.graph.runner import die_with_parent, environment
from swift_ros.graph.topic_table import NODES, VEHICLE_NAMESPACE
from swift_ros.race.judge import RaceEvent
from swift_ros.race.result import BAG
from swift_sim_bridge.bridge.node import BROWN_OUT
from swift_sim_bridge.faults.catalogue import (
    FLIGHT_CONTROLLER,
    FOREIGN_PUBLISHER,
    FREEZE,
    FULL_DISK,
    KILL,
    KINDS,
    LOCKSTEP,
    RELAYED,
    SERIAL,
    TERMINATE,
    VICTIMS,
    WITH_NUMBERS,
    Fault,
)
from swift_sim_bridge.faults.relay import publisher_of, source_name
from swift_sim_bridge.faults.serial_line import SerialLine
from swift_sim_bridge.racing.race import RACERS, Flight, RaceOptions
from swift_sim_bridge.simulation.simulated_vehicle import TICK_NS
from swift_sim_bridge.tcp_ports import LOOPBACK, free_port

DISARM_S = 28.0  # s of race clock, longest time for flying on, braking and descending
SIGNALS = {KILL: signal.SIGKILL, TERMINATE: signal.SIGTERM, FREEZE: signal.SIGSTOP}
AT_REST_S = 3.0  # s of race clock after disarming, in which the vehicle falls to the ground and comes to rest
LINK_PATIENCE_S = 15.0  # working time; without a link for so long, the race clock is not known


@dataclasses.dataclass(frozen=True)
class Flown:
    """What the process that planted a fault knows of the flight.

    Attributes:
        fault_ns: stamp of the begin of the fault; None when the race ended before it.
        end: what ended the race; None without an end.
        safe_ns: see `Listener`.
        faults: sentences that the runner reported.
    """

    fault_ns: int | None
    end: RaceEvent | None
    safe_ns: int | None
    faults: tuple[str, ...]


def fly(fault: Fault, options: RaceOptions) -> Flown:
    """Fly a race with a fault until the vehicle is at rest. Raises UsageError when a node refuses its input."""
    line = None
    if fault.target == SERIAL:
        controller_port = free_port()
        line = SerialLine(controller_port, fault.seed)
        ports = {"bridge": {"port": controller_port}, "betaflight": {"port": f"tcp://{LOOPBACK}:{line.port}"}}
        options = dataclasses.replace(options, parameters=ports)
    topic = fault.target
    if _is_relayed(fault) and publisher_of(topic) == "bridge":
        # the simulator looks for its subscribers under the new name of its topic, where only the relay is
        awaited = [name for name in RACERS if name != "bridge" and topic not in NODES[name].subscribes]
        options = dataclasses.replace(options, parameters={"bridge": {"nodes": awaited}})
    flight = Flight(fault.seed, options)
    if _is_relayed(fault):
        flight.nodes.add_arguments(publisher_of(topic), ["-r", f"{topic}:={source_name(topic)}"])
    try:
        with flight, _faulty_node(fault, flight):
            fault_ns = _await_begin(fault, flight)
            if fault_ns is not None:
                _begin(fault, flight, line)
                _await_end(fault, flight, fault_ns)
                _end(fault, flight, line)
            flight.follow()
            flight.play_out()
            _come_to_rest(flight)
            listener = flight.listener
            return Flown(fault_ns, listener.end, listener.safe_ns, tuple(listener.faults))
    finally:
        if line:
            line.close()


def _is_relayed(fault: Fault) -> bool:
    return KINDS[fault.kind].targets in (RELAYED, WITH_NUMBERS)


@contextlib.contextmanager
def _faulty_node(fault: Fault, flight: Flight) -> Iterator[None]:
    """Run the relay or the foreign publisher that a fault needs."""
    if not _is_relayed(fault) and fault.kind != FOREIGN_PUBLISHER:
        yield
        return
    lockstep = fault.clock == LOCKSTEP
    text = json.dumps(dataclasses.asdict(fault))
    ros = ["--ros-args", "-r", f"__ns:=/{VEHICLE_NAMESPACE}", "-p", f"use_sim_time:={json.dumps(lockstep)}"]
    with open(flight.options.out / "logs" / "relay.log", "wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "swift_sim_bridge.faults.relay", text, *ros],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            preexec_fn=die_with_parent(os.getpid()),
            env=environment(flight.listener.domain, flight.options.discovery),
            start_new_session=True,
        )
    try:
        yield
    finally:
        process.kill()
        process.wait()


def _race_ns(flight: Flight) -> int | None:
    """Return the time since the start signal by the last link status, ns; None before the start."""
    listener = flight.listener
    return None if listener.start_ns is None else listener.link_ns - listener.start_ns


def _await_begin(fault: Fault, flight: Flight) -> int | None:
    """Follow the race to the begin of the fault; return its stamp, or None when the race ended before."""
    at_ns = round(1e9 * fault.at_s)
    flight.follow(until=lambda: (_race_ns(flight) or -1) >= at_ns)
    end, start_ns = flight.listener.end, flight.listener.start_ns
    # a fault of a topic can hold the clock of the lockstep before a link status shows that it has begun
    if end and (start_ns is None or end.stamp_ns < start_ns + at_ns - TICK_NS):
        return None
    return start_ns + at_ns


def _await_end(fault: Fault, flight: Flight, fault_ns: int) -> None:
    """Follow the race to the end of the fault, by the race's clock while it moves and by the steady clock."""
    end_ns, deadline_s = fault_ns + round(1e9 * fault.duration_s), time.monotonic() + fault.duration_s
    flight.follow(until=lambda: flight.listener.link_ns >= end_ns or time.monotonic() >= deadline_s)


def _begin(fault: Fault, flight: Flight, line: SerialLine | None) -> None:
    """Begin a fault of a process or a device; those of topics begin by themselves, in the relay."""
    if fault.target in VICTIMS and fault.kind in SIGNALS:
        os.kill(flight.nodes.process_id(fault.target), SIGNALS[fault.kind])
    elif fault.kind == FULL_DISK:
        written = max(path.stat().st_size for path in (flight.options.out / BAG).iterdir())
        resource.prlimit(flight.nodes.process_id("recorder"), resource.RLIMIT_FSIZE, (written, resource.RLIM_INFINITY))
    elif fault.target == FLIGHT_CONTROLLER:
        flight.listener.call(BROWN_OUT)
    elif line:
        line.disturb(fault.kind, fault.size)


def _end(fault: Fault, flight: Flight, line: SerialLine | None) -> None:
    """End a fault that lasts for some time."""
    if fault.kind == FREEZE:
        with contextlib.suppress(ProcessLookupError):  # it may have been started again, or ended
            os.kill(flight.nodes.process_id(fault.target), signal.SIGCONT)
    elif line:
        line.disturb("", 0.0)


def _come_to_rest(flight: Flight) -> None:
    """Wait until the vehicle is disarmed, then until it has fallen to the ground."""
    _wait(flight, DISARM_S, lambda: not flight.listener.armed)
    _wait(flight, AT_REST_S)


def _wait(flight: Flight, race_s: float, until=lambda: False) -> None:
    """Spin for some time of the race clock, s, or until a condition holds, or in lockstep the link is silent."""
    listener, now_s = flight.listener, flight.listener.working_time.now_s
    end_ns = listener.link_ns + round(1e9 * race_s)
    # in real time the race clock is known without a link
    deadline_s = time.monotonic() + race_s if flight.options.real_time else math.inf
    while listener.link_ns < end_ns and time.monotonic() < deadline_s and not until():
        if now_s() - listener.last_link_s > LINK_PATIENCE_S:
            return
        listener.spin()
