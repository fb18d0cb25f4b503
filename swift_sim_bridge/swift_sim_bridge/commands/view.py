"""Show a flight, the running graph, a gap report or a training in the Rerun viewer."""

import importlib.util
import json
from pathlib import Path

from swift_ros.errors import UsageError

LAYOUT = Path("recordings/foxglove.json")


def command(subparsers) -> None:
    """Add the parser of `swiftros view`."""
    parser = subparsers.add_parser("view", help=__doc__, description=__doc__)
    text = "a bag, or the folder of a race, a gap report or a training (default: the running graph)"
    parser.add_argument("path", nargs="?", type=Path, metavar="PATH", help=text)
    parser.add_argument("--web", action="store_true", help="a page in the browser of this machine, not a window")
    parser.add_argument("--save", type=Path, metavar="FILE.rrd", help="write a file for the viewer; no window opens")
    text = "write a layout of Foxglove with the same panels, and stop (default FILE: %(const)s)"
    parser.add_argument("--foxglove", type=Path, nargs="?", const=LAYOUT, metavar="FILE", help=text)
    live = parser.add_argument_group("the running graph")
    live.add_argument("--domain", type=int, help="ROS domain (default: ROS_DOMAIN_ID, else a running race's)")
    live.add_argument("--seconds", type=float, default=float("inf"), help="end after so many (default: at Ctrl-C)")
    live.add_argument("--config", metavar="DIR", help="folder with camera.yaml and drone.yaml of the vehicle")
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Show what the path holds, until the viewer is closed or Ctrl-C. Return 0. Raises UsageError on bad input."""
    from swift_sim_bridge.view import sources

    if arguments.foxglove is not None:
        return write_layout(arguments.foxglove)
    kind, path = sources.recognise(arguments.path) if arguments.path is not None else ("live", None)
    if arguments.save is not None and arguments.save.suffix != ".rrd":
        raise UsageError(f"--save {arguments.save} does not end with .rrd; the viewer would not open it")
    if not arguments.seconds > 0:
        raise UsageError(f"--seconds {arguments.seconds:g} is not above 0")
    if importlib.util.find_spec("rerun") is None:
        raise UsageError("`swiftros view` needs Rerun, about 500 MB, which is not installed; `make view` installs it")
    from swift_sim_bridge.view.viewer import Viewer, recording

    viewer = Viewer(arguments.web) if arguments.web or arguments.save is None else None
    try:
        if viewer and viewer.page:
            print(f"open {viewer.page}\nCtrl-C ends the page's server", flush=True)
        with recording(str(path or "running graph"), viewer, arguments.save) as stream:
            if path is None:
                show_live(arguments, viewer, stream)
            else:
                show_path(kind, path, stream)
            if arguments.save is None or arguments.web:
                print("all is shown", flush=True)
        if arguments.save is not None:
            print(f"{arguments.save}: {arguments.save.stat().st_size / 1e6:.1f} MB; open it with `rerun FILE`")
        if viewer:
            viewer.wait()
    finally:
        if viewer:
            viewer.close()
    return 0


def show_path(kind: str, path: Path, stream) -> None:
    """Write a flight, a gap report or a training to a recording of the viewer."""
    from swift_sim_bridge.view import bag, gap, sources, training

    print(f"{path}: {'a flight' if kind == sources.BAG else f'a {kind}'}", flush=True)
    {sources.BAG: bag, sources.GAP: gap, sources.TRAINING: training}[kind].show(path, stream)


def show_live(arguments, viewer, stream) -> None:
    """Write the running graph to a recording of the viewer, until it is closed, time is over, or Ctrl-C."""
    from swift_ros.configuration import configuration_folder
    from swift_ros.graph.domain import chosen_domain
    from swift_sim_bridge.view import live

    def has_ended() -> bool:
        return viewer is not None and viewer.has_ended

    received = live.show(
        chosen_domain(arguments.domain), configuration_folder(arguments.config), stream, arguments.seconds, has_ended
    )
    silent = [topic for topic, count in received.items() if not count]
    print(f"{sum(received.values())} messages" + (f"; none on {', '.join(silent)}" if silent else ""))


def write_layout(path: Path) -> int:
    """Write the layout of Foxglove and print how to open it; return 0. Raises UsageError when it cannot be written."""
    from swift_sim_bridge.view import foxglove

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(foxglove.layout(), indent=1) + "\n")
    except OSError as error:
        raise UsageError(f"--foxglove {path} cannot be written: {error.strerror}") from error
    print(f"{path}\n{foxglove.HOW_TO_OPEN}")
    return 0
