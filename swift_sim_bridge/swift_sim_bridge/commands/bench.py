"""Measure speed and load: latencies of the onboard nodes in real time, CPU time of renderer, detector and simulator,
the speed of the policy's training, and that of the physics beside other simulators."""

import json
import subprocess
import sys
from pathlib import Path


def command(subparsers) -> None:
    """Add the parser of `swiftros bench`."""
    parser = subparsers.add_parser("bench", help=__doc__, description=__doc__)
    parser.add_argument(
        "part",
        nargs="?",
        choices=("all", "physics", "training"),
        default="all",
        help="physics: only its speed, beside other simulators; training: only that of the policy (default: all)",
    )
    parser.add_argument(
        "--rivals",
        metavar="PYTHON",
        help="Python interpreter that has crazyflow, rotorpy or l2f to measure (default: this one)",
    )
    parser.add_argument("--bag", type=Path, help="bag of a race to replay in real time (default: fly a race first)")
    parser.add_argument("--config", metavar="DIR", help="configuration folder")
    parser.add_argument("--out", type=Path, default=Path("runs/bench"), help="folder of result.json and logs")
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Measure, print tables, write result.json. Returns 0, or 1 if no race could be flown for the replay."""
    from swift_ros.configuration import configuration_folder
    from swift_ros.results import fresh_folder
    from swift_ros.text import align
    from swift_sim_bridge.benchmarks import kernels, physics_speed, real_time, training_speed
    from swift_sim_bridge.parallel import use_all_cores

    use_all_cores()
    folder = configuration_folder(arguments.config)
    out = fresh_folder(arguments.out, ("result.json", "race", "logs", "bag", "latency"))
    result = {}
    if arguments.part == "all":
        bag = arguments.bag or _fly(out, folder)
        if bag is None:
            return 1
        result = real_time.measure(bag, folder, out)
        print(_real_time_tables(result))
        result["cpu_ms"] = kernels.measure(folder)
        print(_kernel_table(result["cpu_ms"]))
    if arguments.part != "physics":
        result["training"] = training_speed.measure(folder)
        print(align(training_speed.table(result["training"])) + "\n")
    if arguments.part != "training":
        result["physics"] = physics_speed.measure(folder, arguments.rivals)
        print(_physics_table(result["physics"]))
    (out / "result.json").write_text(json.dumps(result, indent=1) + "\n")
    print(out / "result.json")
    return 0


def _fly(out: Path, folder: Path) -> Path | None:
    """Fly one race in lockstep and return its bag, None if it left none."""
    words = [sys.executable, "-m", "swift_ros.cli", "race", "--seed", "0", "--config", str(folder)]
    subprocess.run([*words, "--out", str(out / "race")], check=False)
    return next((out / "race").rglob("bag"), None)


def _physics_table(measured: dict) -> str:
    from swift_ros.text import align
    from swift_sim_bridge.benchmarks import physics_speed

    descriptions = "\n".join(f"{name}: {text}" for name, text in measured["says"].items())
    core = f"simulated vehicle with sensors and MSP, no images: {measured['bridge_core']:.0f} x real time"
    return "\n\n".join((align(physics_speed.table(measured)), descriptions, core))


def _real_time_tables(graph: dict) -> str:
    from swift_ros.text import align

    hops = [("real time, ms", "n", "p50", "p99", "max")]
    hops += [
        (name, str(row["count"]), *(f"{row[key]:.2f}" for key in ("p50", "p99", "max")))
        for name, row in graph["latency_ms"].items()
    ]
    cores, resident_mb = graph["cores"], graph["resident_mb"]
    load = [("onboard node", "cores", "resident MB")]
    load += [(name, f"{cores[name]:.3f}", f"{resident_mb[name]:.0f}") for name in cores]
    load.append(("together", f"{sum(cores.values()):.2f}", f"{sum(resident_mb.values()):.0f}"))
    late = f"inputs replayed late: {graph['late_plays']}"
    return "\n\n".join((align(hops), align(load), late)) + "\n"


def _kernel_table(cpu_ms: dict) -> str:
    from swift_ros.text import align

    return align([("CPU time, median", "ms"), *((name, f"{value:.2f}") for name, value in cpu_ms.items())]) + "\n"
