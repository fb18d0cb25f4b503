"""Flies one race: fresh processes, the graph from podium to end, and the result read back from the recorded bag."""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from swift_ros.graph.runner import Runner, free_domain
from swift_ros.graph.topic_table import NODES
from swift_ros.race.judge import FINISHED
from swift_ros.race.result import BAG, FAULTS, REPORT
from swift_sim_bridge.racing.listener import Listener
from swift_sim_bridge.tcp_ports import free_port

RACERS = tuple(name for name in NODES if name != "camera")  # the simulator stands in for the camera
ARM_S, START_S = 1.0, 0.5
START_PATIENCE_S = 300.0  # wall: processes start, the simulator compiles
QUIET_PATIENCE_S = 90.0  # wall: between two words of the graph
AFTER_FINISH_S = 0.5  # of the race's clock: the race is over, the landing nobody's concern
AFTER_END_S = 4.0  # of the race's clock: by then the vehicle must be disarmed
AFTER_END_PATIENCE_S = 30.0  # wall


@dataclass(frozen=True)
class RaceOptions:
    """How to fly. config: folder; out: folder of this race; real_time: system clock instead of lockstep; discovery: how
    far the graph is heard, "local" or "subnet"; tell: is given each line to print; sitl: path of a Betaflight SITL
    binary that flies instead of the simulated flight controller, "" for none."""

    config: Path
    out: Path
    real_time: bool
    discovery: str
    tell: Callable[[str], None]
    sitl: str = ""


def node_parameters(seed: int, config: Path, out: Path, sitl: str = "") -> dict[str, dict]:
    """Return the ROS parameters of a race, by node; config: configuration folder, out: folder of this race."""
    port = free_port()
    watched = [name for name in RACERS if NODES[name].publishes and name != "race_monitor"]  # it does the watching
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
    }


class Flight:
    """One race in its own processes. Use as a context: leaving it ends them; the bag, the logs and the simulator's
    report stay in `options.out`.

    nodes: the Runner; listener: what is heard. Raises UsageError when a node refuses its input.
    """

    def __init__(self, seed: int, options: RaceOptions):
        self.options = options
        options.out.mkdir(parents=True, exist_ok=True)
        domain, self._reservation = free_domain()
        if options.discovery != "local":
            options.tell(f"  ROS domain {domain} is open to the subnet: anyone on it can publish commands")
        self.listener = Listener(domain, options.discovery, not options.real_time, options.tell)
        parameters = node_parameters(seed, options.config, options.out, options.sitl)
        how = {"lockstep": not options.real_time, "domain": domain, "discovery": options.discovery}
        self.nodes = Runner(RACERS, options.out / "logs", parameters, **how)

    def __enter__(self):
        self._begun_s = time.monotonic()
        self.nodes.__enter__()
        return self

    def __exit__(self, *exception):
        self.nodes.stop([name for name in RACERS if name not in ("bridge", "recorder")])
        self.nodes.stop(["recorder"])  # it hears the others out
        self.nodes.stop()
        self.listener.close()
        if self._reservation:
            self._reservation.close()
        (self.options.out / FAULTS).write_text(json.dumps(self.listener.faults, indent=1))

    def follow(self, until: Callable[[], bool] = lambda: False) -> None:
        """Listen until the race has ended, nothing more can come of it, or `until` holds."""
        listener = self.listener
        while listener.end is None and not until():
            listener.spin()
            for fault in self.nodes.faults():
                listener.say(fault)
                # nobody is left who could end the race, or it has not begun and never will
                if fault.startswith(("race_monitor", "bridge")) or not listener.link_ns:
                    listener.lose(fault)
            quiet_s, patience_s = time.monotonic() - self._begun_s, START_PATIENCE_S
            if listener.link_ns:
                quiet_s, patience_s = time.monotonic() - listener.heard_s, QUIET_PATIENCE_S
            if quiet_s > patience_s and listener.end is None:
                listener.say(f"the graph said nothing for {quiet_s:.0f} s; see {self.options.out / 'logs'}")
                listener.lose(listener.faults[-1])

    def play_out(self) -> None:
        """Let the end of the flight play out: until the vehicle is disarmed, or a while of the race's clock is over."""
        listener = self.listener
        mute = any(fault.startswith("betaflight") for fault in listener.faults)  # then time keeps to the wall
        deadline_s = time.monotonic() + (AFTER_END_S if mute else AFTER_END_PATIENCE_S)
        end_ns, wait_s = listener.end.stamp_ns, AFTER_FINISH_S if listener.end.state == FINISHED else AFTER_END_S
        while listener.armed and listener.link_ns - end_ns < 1e9 * wait_s and time.monotonic() < deadline_s:
            listener.spin()
            self.nodes.faults()
            if "bridge" not in self.nodes.running():
                return


def fly(seed: int, options: RaceOptions) -> None:
    """Fly one race. Raises UsageError when a node refuses its input."""
    with Flight(seed, options) as flight:
        flight.follow()
        flight.play_out()
