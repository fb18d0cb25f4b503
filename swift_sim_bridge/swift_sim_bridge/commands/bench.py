"""Measure speed and load: latencies of the onboard nodes in real time, CPU time of renderer, detector and simulator."""

import json
import subprocess
import sys
from pathlib import Path


def command(subparsers) -> None:
    """Add the parser of `swiftros bench`."""
    parser = subparsers.add_parser("bench", help=__doc__, description=__doc__)
    parser.add_argument("--bag", type=Path, help="a race's bag to play in real time (default: fly a race first)")
    parser.add_argument("--config", metavar="DIR", help="configuration folder")
    parser.add_argument("--out", type=Path, default=Path("runs/bench"), help="folder of result.json and logs")
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Measure, print tables, write result.json. Return 0, or 1 when the race to play could not be flown."""
    from swift_ros.configuration import configuration_folder
    from swift_ros.results import fresh_folder
    from swift_sim_bridge.evaluation import kernels, real_time

    folder = configuration_folder(arguments.config)
    out = fresh_folder(arguments.out, ("result.json", "race", "logs", "bag", "latency"))
    bag = arguments.bag or _fly(out, folder)
    if bag is None:
        return 1
    graph = real_time.measure(bag, folder, out)
    cpu = kernels.measure(folder)
    (out / "result.json").write_text(json.dumps(graph | {"cpu_ms": cpu}, indent=1) + "\n")
    print(_tables(graph, cpu))
    print(out / "result.json")
    return 0


def _fly(out: Path, folder: Path) -> Path | None:
    """Fly one race in lockstep and return its bag, None when there is none to play."""
    words = [sys.executable, "-m", "swift_ros.cli", "race", "--seed", "0", "--config", str(folder)]
    subprocess.run([*words, "--out", str(out / "race")], check=False)
    return next((out / "race").rglob("bag"), None)


def _tables(graph: dict, cpu: dict) -> str:
    from swift_ros.text import align

    hops = [("real time, ms", "n", "p50", "p99", "max")]
    hops += [(name, str(row["count"]), *(f"{row[key]:.2f}" for key in ("p50", "p99", "max")))
             for name, row in graph["latency_ms"].items()]
    load = [("onboard nodes together", ""), ("cores", f"{graph['cores']:.2f}"),
            ("resident memory, MB", f"{graph['resident_mb']:.0f}"),
            ("messages played late", str(graph["late_plays"]))]
    kernels = [("CPU time, median", "ms"), *((name, f"{value:.2f}") for name, value in cpu.items())]
    return "\n\n".join(align(rows) for rows in (hops, load, kernels))
