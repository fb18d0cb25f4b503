"""One race in processes of its own: the graph from the podium to the end, recorded into a bag."""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from swift_ros.graph.domain import RunDomain
from swift_ros.graph.runner import Runner
from swift_ros.graph.topic_table import NODES
from swift_ros.race.judge import FINISHED
from swift_ros.race.result import BAG, FAULTS, REPORT
from swift_sim_bridge.racing.listener import Listener
from swift_sim_bridge.tcp_ports import free_port

RACERS = tuple(name for name in NODES if name != "camera")  # the simulator stands in for the camera
ARM_S, START_S = 1.0, 0.5  # delays of arming after the first link status, and of the start after arming
START_PATIENCE_S = 300.0  # working time: processes start, the simulator compiles
QUIET_PATIENCE_S = 90.0  # working time: longest silence of the graph
AFTER_FINISH_S = 0.5  # race clock: the recording goes on for so long after a finish, unless RaceOptions.land
AFTER_END_S = 28.0  # race clock: the vehicle must have flown on, levelled, braked and sunk within this time
AFTER_END_PATIENCE_S = 60.0  # working time: limit of both


@dataclass(frozen=True)
class RaceOptions:
    """How to fly a race.

    Attributes:
        config: configuration folder.
        out: folder of this race.
        real_time: system clock instead of lockstep.
        discovery: who can reach the graph, "local" or "subnet".
        progress: called with each line to print.
        sitl: path of a Betaflight SITL binary in place of the simulated flight controller; "" for none.
        land: follow the vehicle to the ground after a finish, too.
        parameters: further ROS parameters by node, which precede those of `node_parameters`.
    """

    config: Path
    out: Path
    real_time: bool
    discovery: str
    progress: Callable[[str], None]
    sitl: str = ""
    land: bool = False
    parameters: dict[str, dict] = field(default_factory=dict)


def node_parameters(seed: int, config: Path, out: Path, domain: int, sitl: str = "") -> dict[str, dict]:
    """Return the ROS parameters of a race, by node.

    Args:
        seed: of the simulator.
        config: configuration folder.
        out: folder of this race.
        domain: ROS domain.
        sitl: path of a Betaflight SITL binary; "" for none.
    """
    port = free_port()
    watched = [name for name in RACERS if NODES[name].publishes and name != "race_monitor"]  # the watchdog itself
    return {
        "*": {"config": str(config.resolve())},
        "bridge": {
            "seed": seed,
            "port": port,
            "report": str((out / REPORT).resolve()),
            "nodes": [name for name in RACERS if name != "bridge"],
            "sitl": sitl,
        },
        "betaflight": {"port": f"tcp://127.0.0.1:{port}", "connect_timeout_s": START_PATIENCE_S},
        "race_monitor": {"auto_arm_s": ARM_S, "auto_start_s": START_S, "nodes": watched},
        "recorder": {"folder": str((out / BAG).resolve())},
        "mavlink_telemetry": telemetry_parameters(domain),
    }


def telemetry_parameters(domain: int) -> dict[str, int]:
    """Return the ROS parameters by which simulations side by side are separate vehicles for a ground station.

    The MAVLink system identifier is the ROS domain. 0 is no identifier: in domain 0 that of nodes.yaml stays.
    """
    return {"system_id": domain} if domain else {}


class Flight:
    """One race in processes of its own, as a context manager: leaving it ends them.

    The bag, the logs and the simulator's report stay in `options.out`. Methods raise UsageError when a node refuses its
    input.

    Attributes:
        options: of the race.
        nodes: the Runner of the processes.
        listener: follows the race.
    """

    def __init__(self, seed: int, options: RaceOptions):
        self.options = options
        options.out.mkdir(parents=True, exist_ok=True)
        self._write_faults([])  # also a race that is interrupted at its start has the file
        self._domain = RunDomain()
        domain = self._domain.number
        if options.discovery != "local":
            options.progress(f"  ROS domain {domain} is open to the subnet: anyone on it can publish commands")
        self._failed: set[str] = set()
        self.listener = Listener(domain, options.discovery, not options.real_time, options.progress)
        parameters = node_parameters(seed, options.config, options.out, domain, options.sitl)
        for node, more in options.parameters.items():
            parameters[node] = parameters.get(node, {}) | more
        how = {"lockstep": not options.real_time, "domain": domain, "discovery": options.discovery}
        self.nodes = Runner(RACERS, options.out / "logs", parameters, **how)

    def __enter__(self):
        self._started_s = self.listener.working_time.now_s()
        self.nodes.__enter__()
        return self

    def __exit__(self, *exception):
        self._write_faults(self.listener.faults)
        self.nodes.stop([name for name in RACERS if name not in ("bridge", "recorder")])
        self.nodes.stop(["recorder"])  # after the others, to record their last messages
        self.nodes.stop()
        self.listener.close()
        self._domain.close()

    def _write_faults(self, faults: list[str]) -> None:
        (self.options.out / FAULTS).write_text(json.dumps(faults, indent=1))

    def follow(self, until: Callable[[], bool] = lambda: False) -> None:
        """Spin until the race has ended, can no longer end by itself, or `until` holds."""
        listener = self.listener
        while listener.end is None and not until():
            listener.spin()
            for fault in self.nodes.faults():
                if not fault.needed:
                    listener.warn(fault.sentence)
                    continue
                listener.report_fault(fault.sentence)
                self._failed.add(fault.node)
                # no node is left that could end the race, or it cannot begin
                if fault.node in ("race_monitor", "bridge") or not listener.link_ns:
                    listener.abort(fault.sentence)
            since_s, patience_s = self._started_s, START_PATIENCE_S
            if listener.link_ns:
                since_s, patience_s = listener.last_message_s, QUIET_PATIENCE_S
            quiet_s = listener.working_time.now_s() - since_s
            if quiet_s > patience_s and listener.end is None:
                listener.report_fault(f"no message in the graph for {quiet_s:.0f} s; see {self.options.out / 'logs'}")
                listener.abort(listener.faults[-1])

    def play_out(self) -> None:
        """Spin after the end of the race until the vehicle is disarmed or the time for it is over."""
        listener = self.listener
        no_link = "betaflight" in self._failed  # then the race clock is not known
        clock = time.monotonic if no_link else listener.working_time.now_s
        deadline_s = clock() + (AFTER_END_S if no_link else AFTER_END_PATIENCE_S)
        lands = self.options.land or listener.end.state != FINISHED
        end_ns, wait_s = listener.end.stamp_ns, AFTER_END_S if lands else AFTER_FINISH_S
        while listener.armed and listener.link_ns - end_ns < 1e9 * wait_s and clock() < deadline_s:
            listener.spin()
            self.nodes.faults()
            if "bridge" not in self.nodes.running():
                return


def fly(seed: int, options: RaceOptions) -> None:
    """Fly one race. Raises UsageError when a node refuses its input."""
    with Flight(seed, options) as flight:
        flight.follow()
        flight.play_out()
