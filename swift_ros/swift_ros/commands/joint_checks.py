"""Checks of more than one record of a configuration folder, and of the models that it names."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from swift_ros.errors import UsageError
from swift_ros.plausibility import of_track
from swift_ros.plausibility.finding import IMPOSSIBLE, Finding
from swift_ros.plausibility.shortest_way import shortest_m

NODES = "nodes.yaml"
AHEAD = 2.0  # of a camera from the middle of the vehicle, over the reach of its hull: small ones carry it ahead


def findings(records: dict, folder: Path | None) -> Iterator[tuple[str, Finding]]:
    """Yield (file name, finding) about records by file name, or by (file name, section).

    Args:
        records: those that were read, each possible by itself.
        folder: the configuration folder; None for a file that is checked alone.
    """
    if {"track.yaml", "drone.yaml"} <= set(records):
        yield from (("track.yaml", one) for one in of_track.findings_with(records["track.yaml"], records["drone.yaml"]))
    yield from (("camera.yaml", Finding(IMPOSSIBLE, sentence)) for sentence in _mount(records))
    sentences = [*_times(records), *_race_time(records), *_late_images(records), *_battery(records)]
    if folder is not None:
        sentences += [*_models(records, folder), *_images(records)]
    yield from ((NODES, Finding(IMPOSSIBLE, sentence)) for sentence in sentences)


def _times(records: dict) -> Iterator[str]:
    link, bridge = records.get((NODES, "betaflight")), records.get((NODES, "bridge"))
    if link and bridge and link.lockstep_silence_s <= bridge.patience_s:
        yield (
            f"section 'betaflight', 'lockstep_silence_s' {link.lockstep_silence_s:g} s must be above 'patience_s' "
            f"{bridge.patience_s:g} s of the section 'bridge', which waits so long for an answer"
        )


def _race_time(records: dict) -> Iterator[str]:
    track, race, vio = (records.get(name) for name in ("track.yaml", (NODES, "race_monitor"), (NODES, "vio")))
    if track and race and vio:
        way_m = shortest_m(track)
        shortest_s = way_m / vio.max_speed
        if race.time_limit_s < shortest_s:
            yield (
                f"section 'race_monitor', 'time_limit_s' {race.time_limit_s:g} s is too short: {track.laps} 'laps' of "
                f"track.yaml are at least {way_m:.0f} m, and take {shortest_s:.1f} s at 'max_speed' "
                f"{vio.max_speed:g} m/s of the section 'vio'; give a longer time in s, fewer laps, or a higher speed"
            )


def _late_images(records: dict) -> Iterator[str]:
    camera, estimator = records.get("camera.yaml"), records.get((NODES, "state_estimator"))
    if camera and estimator and camera.processing_latency >= estimator.history_s:
        yield (
            f"section 'state_estimator', 'history_s' {estimator.history_s:g} s is not above the 'processing_latency' "
            f"{camera.processing_latency:g} s of camera.yaml: no image would be used; give a larger one"
        )


def _mount(records: dict) -> Iterator[str]:
    camera, vehicle = records.get("camera.yaml"), records.get("drone.yaml")
    if camera and vehicle:
        reach = float(np.hypot(vehicle.hull_radius, vehicle.hull_height))
        if np.linalg.norm(camera.position) > AHEAD * reach:
            yield (
                f"'position' is {np.linalg.norm(camera.position):.3g} m from the middle of {vehicle.name}, which ends "
                f"at {vehicle.hull_radius:g} m; give m in the body frame, or correct 'hull_radius' of drone.yaml"
            )


def _battery(records: dict) -> Iterator[str]:
    link, vehicle = records.get((NODES, "betaflight")), records.get("drone.yaml")
    if link and vehicle and vehicle.battery.cells:
        full_v = vehicle.battery.open_circuit_full / vehicle.battery.cells
        if link.min_cell_v >= full_v:
            yield (
                f"section 'betaflight', 'min_cell_v' {link.min_cell_v:g} V is not below the {full_v:.3g} V of a full "
                "cell of drone.yaml: the vehicle never arms; give a smaller one"
            )
        if link.assumed_voltage and not 0.5 < link.assumed_voltage / vehicle.battery.open_circuit_full < 1.5:
            yield (
                f"section 'betaflight', 'assumed_voltage' {link.assumed_voltage:g} V does not fit the pack of "
                f"{vehicle.battery.open_circuit_full:g} V of drone.yaml; give the voltage of the pack"
            )


def _models(records: dict, folder: Path) -> Iterator[str]:
    """Yield what the nodes say about their models."""
    from swift_ros.perception.corner_network import CornerNetwork  # ONNX Runtime, which most checks do not need
    from swift_ros.policy.actor import Actor

    loaders = {
        "gate_detector": lambda settings: CornerNetwork(folder / settings.model, settings.providers),
        "policy": lambda settings: Actor(folder / settings.model),
    }
    for section, load in loaders.items():
        if (NODES, section) in records:
            try:
                load(records[NODES, section])
            except UsageError as error:
                yield f"section '{section}', key 'model': {error}"


def _images(records: dict) -> Iterator[str]:
    camera = records.get((NODES, "camera"))
    if camera and camera.kind in ("video", "folder") and not Path(camera.path).exists():
        yield f"section 'camera', 'path' names {camera.path}, which does not exist; give the {camera.kind} with images"
