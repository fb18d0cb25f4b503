"""What a training of the gate detector reads: settings, camera, track, images and the first network."""

import shlex
from dataclasses import dataclass
from pathlib import Path

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_ros.errors import UsageError
from swift_ros.perception.upright import UprightView
from swift_ros.track import Track
from swift_ros.trained_for.detector import of_detector
from swift_sim_bridge.gate_detector import export, model
from swift_sim_bridge.gate_detector.images.composed import ComposedExamples
from swift_sim_bridge.gate_detector.images.composites import pictures
from swift_sim_bridge.gate_detector.images.composites.composer import Composer
from swift_sim_bridge.gate_detector.images.labelled import LabelledExamples
from swift_sim_bridge.gate_detector.images.own_gates import files
from swift_sim_bridge.gate_detector.images.rendered import RenderedExamples
from swift_sim_bridge.gate_detector.images.sources import Mixture, Source
from swift_sim_bridge.gate_detector.training.settings import DetectorTraining
from swift_sim_bridge.labels.folder import LABELS, LabelledFolder
from swift_sim_bridge.model_files.provenance import file_hash
from swift_sim_bridge.rendering.renderer import CircleRenderer

SHIPPED = "shipped"  # --start-from: the network of the repository or of the installation


@dataclass(frozen=True)
class FirstNetwork:
    """The network with which a training begins.

    Attributes:
        source: as in the command: a file, or SHIPPED.
        hashes: SHA-256 of the file by its name.
        weights: of the network.
    """

    source: str
    hashes: dict[str, str]
    weights: dict


def first_network(source: str) -> FirstNetwork:
    """Return the network of a file, or the shipped one. Raises UsageError when there is none that fits."""
    path = configuration.shipped_folder() / "models" / "gate_detector.onnx" if source == SHIPPED else Path(source)
    if not path.is_file():
        raise UsageError(f"--start-from names {path}, which does not exist; name a gate_detector.onnx, or {SHIPPED}")
    return FirstNetwork(source, {path.name: file_hash(path)}, export.read_detector(path))


@dataclass(frozen=True)
class DetectorJob:
    """What stays the same during one sitting of a training.

    Attributes:
        settings: of the training; it ends after `settings.steps`.
        camera: the lens and its mount, of the rendered images.
        track: of the rendered images that do not show a random track.
        out: folder of checkpoint, log, picture and model.
        folders: labelled images, of any lenses.
        photographs: folder of backgrounds of composed images; None without.
        own_gates: folder of pictures, meshes and labelled photographs of gates for composed images; None without.
        fov_deg: assumed horizontal field of view of labelled photographs of own gates without `camera.yaml`, degrees.
        first: the network with which it begins; None for random weights.
    """

    settings: DetectorTraining
    camera: Camera
    track: Track
    out: Path
    folders: tuple[LabelledFolder, ...] = ()
    photographs: Path | None = None
    own_gates: Path | None = None
    fov_deg: float | None = None
    first: FirstNetwork | None = None

    def __post_init__(self):
        for option, is_given, share in (
            ("--images", self.folders, "labelled_share"),
            ("--photographs", self.photographs, "composed_share"),
            ("--own-gates", self.own_gates, "composed_share"),
        ):
            if is_given and not getattr(self.settings, share):
                raise UsageError(f"{option} has no effect: '{share}' in training.yaml is 0; give it a higher value")

    @property
    def conditions(self) -> dict:
        """What the training reads, without its length, which the sittings have."""
        files = {"camera": configuration.content(self.camera), "track": configuration.content(self.track)}
        chosen = configuration.content(self.settings)
        del chosen["steps"], files["track"]["name"]
        if not self.settings.composed_share:
            del chosen["composites"]
        layers = {name: list(shape) for name, shape in model.layer_shapes().items()}
        conditions = {"networks": layers} | files | chosen
        if self.folders:
            conditions["images"] = {str(folder.path): file_hash(folder.path / LABELS) for folder in self.folders}
        if self._pictures:
            conditions["pictures"] = self._pictures
        return conditions | ({"start_from": self.first.hashes} if self.first else {})

    @property
    def _pictures(self) -> dict[str, str]:
        """Folders of pictures for composed images by their options."""
        folders = {"--photographs": self.photographs, "--own-gates": self.own_gates}
        return {option: str(path) for option, path in folders.items() if path}

    @property
    def command(self) -> str:
        """The command line that reproduces the training."""
        words = ["--seed", self.settings.seed, "--steps", self.settings.steps]
        if self.folders:
            words += ["--images", *(folder.path for folder in self.folders)]
        fields_of_view = {self.fov_deg, *(folder.fov_deg for folder in self.folders)} - {None}
        words += [word for fov_deg in fields_of_view for word in ("--fov-deg", f"{fov_deg:g}")]
        words += [word for pair in self._pictures.items() for word in pair]
        if self.first:
            words += ["--start-from", self.first.source]
        return shlex.join(["swiftros", "train", "detector", *map(str, words)])

    @property
    def trained_for(self) -> dict:
        """Camera, gates and looks for the provenance, and the labelled images."""
        content = of_detector(self.camera, self.track, configuration.content(self.settings.looks))
        if self.folders:
            content["images"] = [_summary(folder) for folder in self.folders]
        return content


def _summary(folder: LabelledFolder) -> dict:
    return {
        "folder": folder.path.name,
        "labels_sha256": file_hash(folder.path / LABELS),
        "images": len(folder.images),
        "gates": sum(len(image.gates) for image in folder.images),
    }


def examples_of(job: DetectorJob, circle: CircleRenderer) -> Source:
    """Return the source of a training's examples, rendered by `circle` where they are not labelled images."""
    settings = job.settings
    shares: list[tuple[Source, float]] = []
    if job.folders:
        shares.append((LabelledExamples(settings, job.folders), settings.labelled_share))
    synthetic = 1.0 - sum(share for _, share in shares)
    if settings.composed_share:
        bar = 0.5 * (job.track.outer_side / job.track.inner_side - 1.0)
        own = files.read(job.own_gates, bar, job.fov_deg) if job.own_gates else ()
        composer = Composer(settings.composites, pictures.read(job.photographs, own))
        shares.append((ComposedExamples(settings, composer), synthetic * settings.composed_share))
    if settings.composed_share < 1.0:
        view = UprightView(job.camera, settings.panorama)
        rendered = RenderedExamples(settings, job.camera, view, job.track, circle)
        shares.append((rendered, synthetic * (1.0 - settings.composed_share)))
    return Mixture([(source, share) for source, share in shares if share])
