"""Label the gates in images of a folder or a bag: on a page in the browser, or without a person from known poses."""

import sys
from pathlib import Path

PROGRESS_EVERY = 20  # images
PORT = 8765  # of the page


def command(subparsers) -> None:
    """Add the parser of `swiftros label`."""
    parser = subparsers.add_parser("label", help=__doc__, description=__doc__)
    parser.add_argument("path", type=Path, metavar="PATH", help="folder of images, or bag with camera/image_raw")
    parser.add_argument("--out", type=Path, metavar="DIR", help="of a bag: folder of its frames (default: runs/labels)")
    parser.add_argument("--config", type=Path, metavar="DIR", help="camera, track and network (default: the bag's)")
    parser.add_argument("--every", type=int, default=10, metavar="N", help="of a bag: each N-th image (default 10)")
    parser.add_argument("--poses", metavar="TOPIC", help="of a bag: poses in the map, or none (default: the best)")
    parser.add_argument("--fov-deg", type=float, metavar="DEG", help="horizontal field of view, without a camera.yaml")
    parser.add_argument("--port", type=int, default=PORT, help=f"of the page, 0 for a free one (default {PORT})")
    kinds = parser.add_mutually_exclusive_group()
    kinds.add_argument("--self-label", action="store_true", help="label a bag by its poses, where the images agree")
    kinds.add_argument("--import", type=Path, metavar="FILE", dest="imported", help="COCO .json or CVAT .xml")
    kinds.add_argument("--export", type=Path, metavar="FILE", help="COCO .json or CVAT .xml of the labels")
    parser.add_argument("--empty", action="store_true", help="with --import: images without a gate show none")
    parser.set_defaults(run=run)


def run(arguments) -> int:
    """Label, import or export. Return 0. Raises UsageError on bad input."""
    if arguments.export:
        return _export(arguments.path, arguments.export)
    if arguments.imported:
        return _import(arguments)
    frames = _frames(arguments)
    return _self_label(frames, arguments) if arguments.self_label else _serve(frames, arguments)


def _frames(arguments):
    """Return the frames of the folder or bag. Raises UsageError."""
    from swift_ros.errors import UsageError
    from swift_ros.recording.bags import mcap_files
    from swift_ros.recording.replay import find_bag
    from swift_sim_bridge.labelling import frames

    path = arguments.path
    if not path.exists():
        raise UsageError(f"{path} does not exist; give a folder of images or a bag")
    if not mcap_files(path) and not any(path.rglob("*.mcap")):
        if arguments.self_label:
            raise UsageError(f"{path} holds no bag; --self-label needs the poses of one")
        return frames.of_folder(path, arguments.fov_deg)
    wanted = frames.BagFrames(arguments.every, arguments.poses, arguments.config)
    out = arguments.out or Path("runs/labels")
    found = frames.of_bag(find_bag(path), out, wanted, lambda done: _print_done(done, None))
    print(f"{len(found.images)} frames in {out}", file=sys.stderr)
    return found


def _proposer(frames, config: Path | None):
    from swift_ros import configuration
    from swift_sim_bridge.gate_detector.evaluation.setup import load_setup
    from swift_sim_bridge.labelling.proposals import Proposer

    return Proposer(frames, load_setup(configuration.configuration_folder(config)))


def _serve(frames, arguments) -> int:
    from swift_sim_bridge.labelling import clicks
    from swift_sim_bridge.labelling.server import LabellingServer
    from swift_sim_bridge.labelling.session import Session

    unlevelled = sum(image.q_world_camera is None for image in frames.images)
    if unlevelled:
        print(f"the attitude of {unlevelled} images is not known: the camera is taken to be level", file=sys.stderr)
    server = LabellingServer(Session(_proposer(frames, arguments.config)), arguments.port)
    print(f"open {server.address} in a browser; labels go to {frames.path}; end with Ctrl-C", flush=True)
    try:
        server.serve_forever()
    except KeyboardInterrupt:
        print(file=sys.stderr)
    finally:
        server.server_close()
    print(clicks.summary(frames.path / clicks.CLICKS) or "nothing was accepted")
    return 0


def _self_label(frames, arguments) -> int:
    from swift_sim_bridge.labelling.self_labels import label_flight
    from swift_sim_bridge.labels import coco, folder
    from swift_sim_bridge.labels.labelled_images import FLIGHT

    result = label_flight(_proposer(frames, arguments.config), _print_done)
    before = frames.labelled()
    by_others = {name: image for name, image in before.items() if image.source != FLIGHT}
    images = before | {image.file_name: image for image in result.images} | by_others
    coco.write(frames.path / folder.LABELS, list(images.values()))
    print("\n".join(result.sentences()))
    if by_others:
        print(f"{len(by_others)} images keep the labels that they had from a person or an import")
    print(frames.path / folder.LABELS)
    return 0


def _import(arguments) -> int:
    from swift_ros.errors import UsageError
    from swift_sim_bridge.labelling import frames
    from swift_sim_bridge.labels import coco, cvat, exchange, folder

    target = frames.of_folder(arguments.path, arguments.fov_deg)
    read = {".json": exchange.read_coco, ".xml": cvat.read}.get(arguments.imported.suffix.lower())
    if read is None:
        raise UsageError(f"{arguments.imported} is neither COCO (.json) nor CVAT (.xml)")
    found, counts = exchange.taken(read(arguments.imported), target.images, arguments.empty)
    images = target.labelled() | {image.file_name: image for image in found}
    coco.write(target.path / folder.LABELS, list(images.values()))
    print("\n".join(counts.sentences()))
    print(target.path / folder.LABELS)
    return 0


def _export(path: Path, file: Path) -> int:
    from swift_ros.errors import UsageError
    from swift_sim_bridge.labels import coco, cvat, folder

    write = {".json": coco.write, ".xml": cvat.write}.get(file.suffix.lower())
    if write is None:
        raise UsageError(f"--export {file} is neither COCO (.json) nor CVAT (.xml)")
    if not (path / folder.LABELS).is_file():
        raise UsageError(f"{path} holds no {folder.LABELS}; label its images with `swiftros label {path}`")
    images = coco.read(path / folder.LABELS)
    write(file, images)
    print(f"{len(images)} images with {sum(len(image.gates) for image in images)} gates -> {file}")
    return 0


def _print_done(done: int, total: int | None) -> None:
    if done % PROGRESS_EVERY == 0 or done == total:
        end = "\n" if done == total else ""
        print(f"\r{done}{f' of {total}' if total else ''} frames", end=end, file=sys.stderr, flush=True)
