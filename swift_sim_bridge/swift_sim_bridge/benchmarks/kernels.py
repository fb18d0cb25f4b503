"""CPU time of the pieces that the frame budget is made of: renderer, detector, simulated tick. One thread, medians."""

import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np

from swift_ros import configuration, geometry
from swift_ros.camera.model import Camera
from swift_ros.track import Track

ROUNDS = 40


def cpu_ms(work: Callable[[int], object], rounds: int = ROUNDS) -> float:
    """Return the median CPU time (ms) of `work(k)`, after one call that does not count."""
    work(0)
    spent = []
    for k in range(rounds):
        begun = time.process_time()
        work(k)
        spent.append(1e3 * (time.process_time() - begun))
    return float(np.median(spent))


def poses(track: Track, count: int = ROUNDS):
    """Return (p_world, q_world_body, v_world, omega_body) of a vehicle before the gates, racing towards them."""
    rng, rows = np.random.default_rng(0), []
    for k in range(count):
        gate = k % len(track.gates)
        forward = track.rotations[gate][:, 0]
        position = track.positions[gate] - rng.uniform(3.0, 8.0) * forward + rng.normal(0.0, 0.3, 3)
        pitch = geometry.quaternion_from_rotation_vector(np.array([0.0, 0.5, 0.0]))
        attitude = geometry.quaternion_multiply(geometry.quaternion_from_yaw(track.yaws[gate]), pitch)
        rows.append((position, attitude, 12.0 * forward, rng.normal(0.0, 2.0, 3)))
    return rows


def measure(folder: Path) -> dict[str, float]:
    """Return CPU ms by piece: an image of the renderer, an image through the detector (turned, network, grouping), a
    tick of the simulated vehicle with its flight controller and sensors."""
    from swift_sim_bridge.gate_detector import report
    from swift_sim_bridge.rendering.renderer import Renderer
    from swift_sim_bridge.rendering.scene import Looks
    from swift_sim_bridge.simulation.simulated_vehicle import TICK_NS, SimulatedVehicle

    camera = configuration.load(Camera, folder / "camera.yaml")
    track = configuration.load(Track, folder / "track.yaml")
    looks = configuration.load_section(Looks, folder / "simulation.yaml", "renderer")
    renderer, rows = Renderer(camera, track, looks, 0), poses(track)
    images = [renderer.render(*row) for row in rows]
    stage = report.load(folder)
    result = {"renderer, an image": cpu_ms(lambda k: renderer.render(*rows[k]))}
    result["detector, an image"] = cpu_ms(lambda k: stage.detector.detect(images[k], rows[k][1]))
    with jax.enable_x64(True):  # as the bridge runs it
        vehicle = SimulatedVehicle(folder, 0)

        def tick(_):
            vehicle.sense(vehicle.tick * TICK_NS)
            vehicle.advance()

        result["simulated vehicle, a tick of 10 ms"] = cpu_ms(tick, 300)
    return result
