"""Run the simulator alone, in real time; fly it by publishing commands or from any MSP client."""

import json
import select
import sys
import tempfile
from pathlib import Path

from swift_ros.errors import UsageError
from swift_ros.graph.discovery import DISCOVERY
from swift_ros.graph.domain import RunDomain
from swift_ros.graph.runner import Runner
from swift_ros.graph.topic_table import SERVICES, full_name
from swift_ros.race.result import FAULTS, REPORT
from swift_ros.results import fresh_folder
from swift_sim_bridge.commands.race import (
    add_files,
    add_flight_controller,
    chosen_files,
    chosen_sitl,
    configure,
    other_files,
    print_unmodelled,
    print_warnings,
)
from swift_sim_bridge.seeds import check_seeds
from swift_sim_bridge.tcp_ports import require_free

COMMAND = "command/body_rate_thrust"
START_PATIENCE_S = 120.0  # working time: processes start, the simulator compiles
PORT = 5761  # TCP port of MSP, as Betaflight SITL has it
SITL_PORT = 5771  # with SITL, which uses PORT itself
HELP = """
  fly by topics: publish swift_msgs/msg/BodyRateThrust, 50 times a second or more, on
    {command}, such as
    ROS_DOMAIN_ID={domain} ros2 topic pub -r 100 {command} swift_msgs/msg/BodyRateThrust '{{thrust: 10.5}}'
    (docs/simulation/index.md has the same in Python, for an environment without `ros2`); then type `arm`, then `start`
  the state is on {truth} and {vio}{images}
  type arm, start, stop or quit"""


def command(subparsers) -> None:
    """Add the parser of `swiftros sim`."""
    parser = subparsers.add_parser("sim", help=__doc__, description=__doc__)
    parser.add_argument("--seed", type=int, default=0, help="of sensor noise and looks (default %(default)s)")
    port_help = f"TCP port (default {PORT}; {SITL_PORT} with sitl, which uses {PORT} itself)"
    parser.add_argument("--msp-port", type=int, metavar="PORT", help=port_help)
    parser.add_argument("--msp-client", action="store_true", help="leave the MSP port to another client")
    parser.add_argument("--no-images", action="store_true", help="render nothing")
    add_files(parser)
    add_flight_controller(parser)
    parser.add_argument("--out", metavar="DIR", help="folder of logs and report (default: a temporary folder)")
    parser.add_argument(
        "--discovery", choices=DISCOVERY, default="local", help="who can reach the graph (default: %(default)s)"
    )
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Simulate until `quit` or Ctrl-C. Returns 0, or 1 when a needed node was lost. Raises UsageError."""
    from swift_sim_bridge.racing.listener import Listener

    check_seeds(arguments.seed, arguments.seed)
    sitl = chosen_sitl(arguments)
    arguments.msp_port = arguments.msp_port or (SITL_PORT if sitl else PORT)
    # Otherwise the node betaflight would connect to the process that uses the port already.
    require_free(arguments.msp_port, "give another --msp-port")
    files = chosen_files(arguments.config, **other_files(arguments))
    run_domain = RunDomain()  # before earlier results are removed
    out = fresh_folder(Path(arguments.out or tempfile.mkdtemp(prefix="swift-sim-")), (REPORT, FAULTS, "config", "logs"))
    folder = configure(out, files)
    names = ("bridge",) if arguments.msp_client else ("bridge", "betaflight", "race_monitor")
    domain = run_domain.number
    print(f"configuration: {folder}; logs: {out}; ROS domain: {domain}", flush=True)
    if not sitl:
        print_unmodelled(folder)
    print_warnings(folder)
    if arguments.discovery != "local":
        print(f"ROS domain {domain} is open to the subnet: anyone on it can publish commands", flush=True)
    listener = Listener(domain, arguments.discovery, False, lambda line: print(line, flush=True))
    how = {"lockstep": False, "domain": domain, "discovery": arguments.discovery}
    try:
        with Runner(names, out / "logs", parameters(arguments, folder, out, sitl), **how) as nodes:
            return _attend(nodes, listener, arguments)
    except KeyboardInterrupt:
        return 0
    finally:
        (out / FAULTS).write_text(json.dumps(listener.faults, indent=1))
        listener.close()
        run_domain.close()


def parameters(arguments, folder: Path, out: Path, sitl: str = "") -> dict[str, dict]:
    """Return the ROS parameters of the simulator and of the two nodes that let one fly it by topics."""
    report = str((out / REPORT).resolve())
    port = arguments.msp_port
    return {
        "*": {"config": str(folder.resolve())},
        "bridge": {
            "seed": arguments.seed,
            "port": port,
            "images": not arguments.no_images,
            "report": report,
            "sitl": sitl,
        },
        "betaflight": {
            "port": f"tcp://127.0.0.1:{port}",
            "connect_timeout_s": START_PATIENCE_S,
            "state_required": False,
        },
        "race_monitor": {"nodes": ["betaflight"], "time_limit_s": 3600.0},
    }


def _attend(nodes: Runner, listener, arguments) -> int:
    """Print events and run typed commands until `quit` or the loss of a needed node; return the exit code."""
    clock, welcomed, typing = listener.working_time, False, sys.stdin is not None
    started_s = clock.now_s()
    while True:
        listener.spin()
        for fault in nodes.faults():
            if fault.needed:
                listener.report_fault(fault.sentence)
                print(f"swiftros: the simulation has ended: {fault.sentence}", file=sys.stderr)
                return 1
            listener.warn(fault.sentence)
        if not welcomed and _is_up(listener, arguments):
            print(_welcome(arguments, listener.domain), flush=True)
            welcomed = True
        if not welcomed and clock.now_s() - started_s > START_PATIENCE_S:
            raise UsageError(f"the simulator did not start within {START_PATIENCE_S:.0f} s; see its log in --out")
        if listener.end is not None:
            print("  the flight is over; type arm to fly again from where the vehicle is, or quit", flush=True)
            listener.end = None
        typed = _typed() if typing and welcomed else None
        typing = typing and typed != ""
        if typed == "quit":
            return 0
        if typed and not arguments.msp_client:
            _request(listener, typed)


def _is_up(listener, arguments) -> bool:
    """Return whether the simulator publishes and, unless an external client has it, the link works."""
    return bool(listener.endpoints("ground_truth/odometry")[0]) if arguments.msp_client else bool(listener.link_ns)


def _welcome(arguments, domain: int) -> str:
    """Return the help that is printed when the simulator has started in a ROS domain."""
    lines = f"the simulator runs; its flight controller has MSP on tcp://127.0.0.1:{arguments.msp_port}"
    if arguments.msp_client:
        return lines + "\n  connect a client there; type quit to end"
    names = {"command": COMMAND, "truth": "ground_truth/odometry", "vio": "vio/raw"}
    images = "" if arguments.no_images else f", images are on {full_name('camera/image_raw')}"
    return lines + HELP.format(**{key: full_name(name) for key, name in names.items()}, images=images, domain=domain)


def _typed() -> str | None:
    """Return the line typed, "" at the end of the input, None if there is none yet."""
    ready, _, _ = select.select([sys.stdin], [], [], 0)
    if not ready:
        return None
    line = sys.stdin.readline()
    return line.strip() or (None if line else "")


def _request(listener, typed: str) -> None:
    """Call the race service that was typed; print a refusal."""
    service = f"race/{typed}"
    if service not in SERVICES:
        print(f"  '{typed}' is not a command; type arm, start, stop or quit", flush=True)
        return
    refusal = listener.call(service)
    if refusal:
        print(f"  {refusal}", flush=True)
