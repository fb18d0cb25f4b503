"""The runner: command lines, reported faults, and that no process is left running."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from patience import PATIENCE_S, wait_for

from swift_ros.errors import UsageError
from swift_ros.graph import runner
from swift_ros.graph.runner import Runner, command_line, executable_path, launch_row
from swift_ros.graph.topic_table import NODES
from swift_ros.working_time import WorkingTime

SLEEPER = "import time; print('up', flush=True); time.sleep(3600)"
IGNORES_SIGNALS = "import signal; [signal.signal(s, signal.SIG_IGN) for s in (2, 15)]; " + SLEEPER


@pytest.fixture
def scripts(monkeypatch):
    """Let rows of the table run small scripts instead of nodes: scripts["policy"] = source."""
    sources = {}

    def command(launch):
        return [sys.executable, "-c", sources[launch["executable"]]]

    monkeypatch.setattr(runner, "command_line", command)
    return sources


def start(tmp_path, *names):
    return Runner(names, tmp_path / "logs", {}, lockstep=True, domain=1)


def test_launch_file_and_runner_start_a_node_with_the_same_arguments():
    for row in NODES.values():
        parameters = {"config": "/a folder", "nodes": ["vio", "policy"], "auto_arm_s": 1.0, "fast": True}
        launch = launch_row(row, parameters, lockstep=True, namespace="blue")
        line = command_line(launch)
        assert line[0] == str(executable_path(row.package, row.executable))
        assert line[1:] == ["--ros-args", *launch["ros_arguments"]]
        assert launch["ros_arguments"][:4] == ["-r", "__ns:=/blue", "-p", "use_sim_time:=true"]
        assert (
            'nodes:=["vio", "policy"]' in launch["ros_arguments"] and 'config:="/a folder"' in launch["ros_arguments"]
        )


def test_the_error_names_a_node_that_is_not_installed(monkeypatch):
    monkeypatch.setattr(runner, "prefixes", lambda: [])
    with pytest.raises(UsageError, match="policy of package swift_ros is not installed; run make setup"):
        executable_path("swift_ros", "policy")


def test_a_node_that_exits_is_reported_once_and_the_others_run_until_they_are_stopped(tmp_path, scripts):
    scripts |= {"vio": SLEEPER, "policy": "import sys; sys.exit(3)"}
    with start(tmp_path, "vio", "policy") as nodes:
        found = []
        wait_for(lambda: found.extend(nodes.faults()) or found)
        assert len(found) == 1 and found[0].node == "policy"
        assert found[0].sentence.startswith("policy exited with 3")
        assert nodes.faults() == [] and nodes.running() == ["vio"]
        process = nodes.process_id("vio")
    assert not Path(f"/proc/{process}").exists()


def test_killed_and_frozen_nodes_are_reported_and_frozen_ones_are_killed_at_once(tmp_path, scripts, monkeypatch):
    monkeypatch.setattr(runner, "SIGNALS", ((signal.SIGINT, PATIENCE_S),))
    scripts |= {"vio": SLEEPER, "policy": SLEEPER}
    with start(tmp_path, "vio", "policy") as nodes:
        wait_for(lambda: all(nodes.last_log_line(name) == "up" for name in ("vio", "policy")))
        os.kill(nodes.process_id("vio"), signal.SIGKILL)
        os.kill(nodes.process_id("policy"), signal.SIGSTOP)
        found = []
        wait_for(lambda: found.extend(nodes.faults()) or len(found) == 2)
        sentences = {fault.node: fault.sentence for fault in found}
        assert sentences["vio"].startswith("vio was killed by SIGKILL")
        assert sentences["policy"].startswith("policy is frozen")
        frozen = nodes.process_id("policy")
    assert not Path(f"/proc/{frozen}").exists()


def test_a_node_that_is_stopped_for_a_moment_is_no_fault(tmp_path, scripts):
    scripts["policy"] = SLEEPER
    with start(tmp_path, "policy") as nodes:
        wait_for(lambda: nodes.last_log_line("policy") == "up")
        for kind in (signal.SIGSTOP, signal.SIGCONT, signal.SIGSTOP):
            os.kill(nodes.process_id("policy"), kind)
            wait_for(
                lambda k=kind: (
                    runner._process_state(nodes.process_id("policy")) in ("T" if k != signal.SIGCONT else "SR")
                )
            )
            assert nodes.faults() == []
        wait_for(lambda: nodes.faults())


def test_bad_input_of_a_node_is_reported_with_its_own_message(tmp_path, scripts):
    scripts["policy"] = "import sys; print('policy: models/x.onnx is missing; train one'); sys.exit(2)"
    with pytest.raises(UsageError, match="models/x.onnx is missing"), start(tmp_path, "policy") as nodes:
        wait_for(lambda: nodes.faults())


def test_a_node_that_ignores_sigint_and_sigterm_is_killed(tmp_path, scripts, monkeypatch):
    monkeypatch.setattr(runner, "SIGNALS", ((signal.SIGINT, 0.2), (signal.SIGTERM, 0.2), (signal.SIGKILL, PATIENCE_S)))
    scripts["policy"] = IGNORES_SIGNALS
    with start(tmp_path, "policy") as nodes:
        wait_for(lambda: nodes.last_log_line("policy") == "up")
        process = nodes.process_id("policy")
    assert not Path(f"/proc/{process}").exists()


def test_on_a_busy_machine_a_node_has_time_to_save_its_work(tmp_path, scripts, monkeypatch):
    class BusyMachine(WorkingTime):
        def now_s(self):
            return super().now_s() / 30

    monkeypatch.setattr(runner, "WorkingTime", BusyMachine)
    monkeypatch.setattr(runner, "SIGNALS", ((signal.SIGINT, 0.2), (signal.SIGKILL, PATIENCE_S)))
    scripts["policy"] = f"""
import signal, sys, time
def save(*_):
    time.sleep(1.0)
    print("saved", flush=True)
    sys.exit(0)
signal.signal(signal.SIGINT, save)
{SLEEPER}"""
    with start(tmp_path, "policy") as nodes:
        wait_for(lambda: nodes.last_log_line("policy") == "up")
    assert nodes.last_log_line("policy") == "saved"


def test_no_process_is_left_when_the_runner_itself_is_killed(tmp_path):
    story = f"""
import sys, time
from pathlib import Path
from swift_ros.graph import runner
runner.command_line = lambda launch: [sys.executable, "-c", {IGNORES_SIGNALS!r}]
with runner.Runner(["policy"], Path({str(tmp_path)!r}), {{}}, lockstep=True, domain=1) as nodes:
    print(nodes.process_id("policy"), flush=True)
    time.sleep(3600)
"""
    parent = subprocess.Popen([sys.executable, "-c", story], stdout=subprocess.PIPE, text=True)
    child = int(parent.stdout.readline())
    log = tmp_path / "policy.log"
    wait_for(lambda: log.exists() and log.read_text() == "up\n")  # from here on it ignores SIGINT and SIGTERM
    assert is_alive(child) and parent_of(child) == parent.pid
    parent.kill()
    parent.wait()
    parent.stdout.close()
    wait_for(lambda: not is_alive(child), f"process {child} still runs after its runner")


def is_alive(process_id):
    return runner._process_state(process_id) not in ("", "Z")


def parent_of(process_id):
    return int(Path(f"/proc/{process_id}/stat").read_text().rsplit(")", 1)[1].split()[1])
