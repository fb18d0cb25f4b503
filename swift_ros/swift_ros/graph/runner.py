"""Runs nodes of the graph's table as processes: starts them, reports dead or frozen ones, and ends all of them.

`ros2 launch` and this runner start a node with the same arguments, which both take from `launch_row`.
"""

import ctypes
import json
import os
import signal
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

from swift_ros.configuration import prefixes
from swift_ros.errors import UsageError
from swift_ros.graph.discovery import choose
from swift_ros.graph.topic_table import NODES, VEHICLE_NAMESPACE, NodeRow
from swift_ros.library_threads import use_one_thread
from swift_ros.working_time import WorkingTime

# Signals that end a node, with the working time (s) after which the next one is sent; the recorder needs the first
# seconds to complete its bag, the simulator to write its report. On a busy machine they need longer by the clock.
SIGNALS = ((signal.SIGINT, 5.0), (signal.SIGTERM, 2.0), (signal.SIGKILL, 2.0))
POLL_S = 0.02  # s; period of the check whether processes have ended
_PR_SET_PDEATHSIG = 1  # option of prctl(2): signal to this process when its parent ends


def launch_row(
    row: NodeRow, parameters: dict | None = None, *, lockstep: bool = False, namespace: str = VEHICLE_NAMESPACE
) -> dict:
    """Return the keyword arguments of `launch_ros.actions.Node` for a node: package, executable and ros_arguments."""
    values = {"use_sim_time": True} if lockstep else {}
    arguments = ["-r", f"__ns:=/{namespace}"]
    for name, value in (values | (parameters or {})).items():
        arguments += ["-p", f"{name}:={json.dumps(value)}"]
    return {"package": row.package, "executable": row.executable, "ros_arguments": arguments}


def launch_rows(names, parameters: dict[str, dict], **how) -> dict[str, dict]:
    """Return `launch_row` of each named node.

    Args:
        names: names of nodes of the table.
        parameters: ROS parameters by node name; those under "*" are for all nodes.
        how: keyword arguments of `launch_row`.

    Raises:
        UsageError: a name is not in the table.
    """
    not_in_table = set(names) - set(NODES)
    if not_in_table:
        raise UsageError(f"there is no node '{sorted(not_in_table)[0]}'; there are {', '.join(NODES)}")
    common = parameters.get("*", {})
    return {name: launch_row(NODES[name], common | parameters.get(name, {}), **how) for name in names}


def command_line(launch: dict) -> list[str]:
    """Return the command line for the result of `launch_row`. Raises UsageError when the node is not installed."""
    return [str(executable_path(launch["package"], launch["executable"])), "--ros-args", *launch["ros_arguments"]]


def executable_path(package: str, executable: str) -> Path:
    """Return the path of an installed executable. Raises UsageError when it is not installed."""
    for prefix in prefixes():
        for folder in (prefix / "lib" / package, prefix / "bin"):
            if os.access(folder / executable, os.X_OK):
                return folder / executable
    raise UsageError(f"the executable {executable} of package {package} is not installed; run make setup")


def environment(domain: int, discovery: str = "local") -> dict[str, str]:
    """Return the environment of child processes: this process's own, with a ROS domain and a range of discovery."""
    found = dict(os.environ) | {"ROS_DOMAIN_ID": str(domain)}
    use_one_thread(found)
    choose(discovery, found)
    return found


def die_with_parent(parent: int):
    """Return a function for `preexec_fn`: the kernel then kills the child when its parent dies, even by SIGKILL."""
    libc = ctypes.CDLL(None)

    def prepare():
        libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # the parent died before the call above
            os._exit(1)

    return prepare


RESTARTS = 3  # of each node that the flight does not need; one that fails more often does not work here
RESTART_AFTER_S = 1.0  # s; a node that is only stopped for a moment continues by itself
FROZEN_S = 0.2  # s for which a node is stopped by a signal before that is a fault; until then the watchdogs decide


@dataclass(frozen=True)
class NodeFault:
    """A node that has exited or is stopped by a signal.

    Attributes:
        node: its name.
        sentence: what happened to it, and what happens next.
    """

    node: str
    sentence: str

    @property
    def needed(self) -> bool:
        """Whether the flight needs the node."""
        return NODES[self.node].needed


class Runner:
    """Running nodes. Use it as a context manager: on exit all nodes are ended.

    Args:
        names: names of the nodes to start.
        logs: folder for one log file per node.
        parameters: ROS parameters by node name; those under "*" are for all nodes.
        lockstep: whether the nodes run on simulated time.
        domain: ROS domain.
        discovery: who can reach the nodes, a key of `DISCOVERY`.
    """

    def __init__(
        self, names, logs: Path, parameters: dict[str, dict], *, lockstep: bool, domain: int, discovery: str = "local"
    ):
        rows = launch_rows(names, parameters, lockstep=lockstep)
        self._commands = {name: command_line(launch) for name, launch in rows.items()}
        self._logs = Path(logs)
        self._environment = environment(domain, discovery)
        self._processes: dict[str, subprocess.Popen] = {}
        self._reported: set[str] = set()
        self._restarts = dict.fromkeys(names, 0)
        self._restart_due_s: dict[str, float] = {}
        self._stopped_s: dict[str, float] = {}

    def add_arguments(self, name: str, arguments: list[str]) -> None:
        """Add ROS arguments to the command line of a node that is not started yet."""
        self._commands[name] = [*self._commands[name], *arguments]

    def __enter__(self):
        self._logs.mkdir(parents=True, exist_ok=True)
        try:
            for name, command in self._commands.items():
                self._start(name, command, "wb")
        except BaseException:
            self.stop()
            raise
        return self

    def _start(self, name: str, command: list[str], mode: str) -> None:
        with open(self.log(name), mode) as log:
            self._processes[name] = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                preexec_fn=die_with_parent(os.getpid()),
                env=self._environment,
                start_new_session=True,
            )

    def __exit__(self, *exception):
        self.stop()

    def log(self, name: str) -> Path:
        """Return the log file of a node."""
        return self._logs / f"{name}.log"

    def process_id(self, name: str) -> int:
        """Return the process identifier of a node."""
        return self._processes[name].pid

    def running(self) -> list[str]:
        """Return the names of the nodes that have not exited."""
        return [name for name, process in self._processes.items() if process.poll() is None]

    def faults(self) -> list[NodeFault]:
        """Return the nodes that have exited or are stopped by a signal; restart those that the flight does not need.

        Each fault is reported once. Call this often: nodes are started again in here.

        Raises UsageError with the node's own sentence when it exited with code 2 (bad input) at its first start.
        """
        found = self._restart()
        for name, process in self._processes.items():
            sentence = None if name in self._reported else self._fault(name, process)
            if sentence:
                self._reported.add(name)
                found.append(NodeFault(name, sentence + self._schedule_restart(name)))
        return found

    def _schedule_restart(self, name: str) -> str:
        """Plan to start a node again that the flight does not need; return the end of its fault's sentence."""
        if NODES[name].needed:
            return ""
        if self._restarts[name] == RESTARTS:
            return f"; the flight goes on without it, it failed {RESTARTS + 1} times"
        self._restart_due_s[name] = time.monotonic() + RESTART_AFTER_S
        return "; the flight goes on, and it is started again"

    def _restart(self) -> list[NodeFault]:
        """Start the nodes again that are due; return those for which that is not possible."""
        failed = []
        for name in [name for name, due_s in self._restart_due_s.items() if time.monotonic() >= due_s]:
            del self._restart_due_s[name]
            self._reported.discard(name)
            process = self._processes[name]
            if process.poll() is None:
                if _process_state(process.pid) not in ("T", "t"):
                    continue  # it continues by itself
                process.kill()
                process.wait()
            self._restarts[name] += 1
            extra = [f"{key}:={json.dumps(value)}" for key, value in NODES[name].restart_parameters]
            try:
                self._start(name, [*self._commands[name], *(word for one in extra for word in ("-p", one))], "ab")
            except OSError as error:
                self._reported.add(name)
                failed.append(NodeFault(name, f"{name} cannot be started again: {error.strerror}"))
        return failed

    def _fault(self, name: str, process: subprocess.Popen) -> str | None:
        code = process.poll()
        if code == 2 and not self._restarts[name]:
            raise UsageError(self.last_log_line(name) or f"{name} refused to start; see {self.log(name)}")
        if code is not None:
            how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"exited with {code}"
            return f"{name} {how}; see {self.log(name)}"
        if _process_state(process.pid) not in ("T", "t"):
            self._stopped_s.pop(name, None)
            return None
        stopped_s = self._stopped_s.setdefault(name, time.monotonic())
        return f"{name} is frozen (stopped by a signal)" if time.monotonic() - stopped_s > FROZEN_S else None

    def last_log_line(self, name: str) -> str:
        """Return the last line of a node's log, empty when there is none."""
        lines = self.log(name).read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else ""

    def stop(self, names=None) -> None:
        """End the named nodes, by default all, with the signals of `SIGNALS`. Frozen nodes are killed at once."""
        chosen = [process for name, process in self._processes.items() if names is None or name in names]
        for kind, timeout_s in SIGNALS:
            for process in chosen:
                if process.poll() is None:
                    frozen = _process_state(process.pid) in ("T", "t")
                    process.send_signal(signal.SIGKILL if frozen else kind)
            waiting = WorkingTime()
            while waiting.now_s() < timeout_s and any(process.poll() is None for process in chosen):
                time.sleep(POLL_S)
        self._reported.update(self._processes if names is None else names)
        for name in self._processes if names is None else names:
            self._restart_due_s.pop(name, None)


def _process_state(process_id: int) -> str:
    """Return the kernel's letter for the state of a process, empty when it is gone."""
    try:
        text = Path(f"/proc/{process_id}/stat").read_text()
    except OSError:
        return ""
    return text.rsplit(")", 1)[1].split()[0]
