"""CPU time of the computations of a frame: renderer, gate detector, simulated tick. One thread, medians."""

import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np

from swift_ros import configuration, geometry
from swift_ros.camera.model import Camera
from swift_ros.track import Track

ROUNDS = 40  # measurements of which the median is taken
TICK_ROUNDS = 300  # likewise for the simulated tick, which is shorter


def cpu_ms(work: Callable[[int], object], rounds: int = ROUNDS) -> float:
    """Return the median CPU time (ms) of `work(k)`; a first call, which compiles, does not count."""
    work(0)
    spent = []
    for k in range(rounds):
        start_s = time.process_time()
        work(k)
        spent.append(1e3 * (time.process_time() - start_s))
    return float(np.median(spent))


def poses(track: Track, count: int = ROUNDS):
    """Return `count` poses (p_world, q_world_body, v_world, omega_body) of a vehicle that flies towards the gates."""
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
    """Return the CPU time (ms) by computation.

    These are an image of the renderer, an image through the detector (upright view, network, grouping), and a tick of
    the simulated vehicle with flight controller and sensors.
    """
    from swift_sim_bridge.gate_detector.evaluation.setup import load_setup
    from swift_sim_bridge.rendering.renderer import Renderer
    from swift_sim_bridge.rendering.scene import Looks
    from swift_sim_bridge.simulation.simulated_vehicle import TICK_NS, SimulatedVehicle

    camera = configuration.load(Camera, folder / "camera.yaml")
    track = configuration.load(Track, folder / "track.yaml")
    looks = configuration.load_section(Looks, folder / "simulation.yaml", "renderer")
    renderer, rows = Renderer(camera, track, looks, 0), poses(track)
    images = [renderer.render(*row) for row in rows]
    detector = load_setup(folder).detector
    result = {"renderer, an image": cpu_ms(lambda k: renderer.render(*rows[k]))}
    result["detector, an image"] = cpu_ms(lambda k: detector.detect(images[k], rows[k][1]))
    with jax.enable_x64(True):  # as the bridge runs it
        vehicle = SimulatedVehicle(folder, 0)

        def tick(_):
            vehicle.sense(vehicle.tick * TICK_NS)
            vehicle.advance()

        result["simulated vehicle, a tick of 10 ms"] = cpu_ms(tick, TICK_ROUNDS)
    return result
