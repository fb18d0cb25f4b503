"""The room of the race, drawn by the renderer of the simulator, in colour."""

from dataclasses import replace

import cv2
import jax.numpy as jnp
import numpy as np

from swift_sim_bridge.rendering import scene as scenes
from swift_sim_bridge.rendering import textures
from swift_sim_bridge.rendering.scene import Plates, Room
from swift_sim_bridge.rendering.surfaces import Rays, add_brightness
from swift_sim_bridge.video.flight import Flight
from swift_sim_bridge.video.painter import View

SHARE = 0.7  # of the frame's resolution, at which the room is rendered: half of the time, and hardly seen
# m, from the path to the walls where no track gives the flight volume
MARGIN_M = np.array([6.0, 6.0, 4.0])
TONE = 0.26  # mean brightness of the surfaces, which differs from seed to seed by a factor of five
# Brightness 0 to 1 to BGR: dark and blue, so that gates, vehicle and texts stand out.
SHADES = np.array([[30, 20, 14], [88, 68, 56], [156, 136, 124], [225, 218, 212]], float)
NO_PLATES = Plates(*(np.zeros((0, *shape), np.float32) for shape in ((3,), (3, 3), (2,), (2,), (), (), ())))


class Hall:
    """The room of a flight, with the surfaces that its seed draws."""

    def __init__(self, flight: Flight, seed: int, view: View):
        """Make the room.

        Args:
            flight: whose hall it is.
            seed: of the surfaces.
            view: of the frames; its pose is not used.
        """
        rng = np.random.default_rng(seed)
        scene = _scene(flight, rng)
        self._stack = jnp.asarray(textures.stack(flight.looks.families, flight.looks.textures, rng).reshape(-1))
        self._scene = replace(scene, plates=NO_PLATES)
        self._size = round(SHARE * view.height), round(SHARE * view.width)
        self._frame = view.width, view.height
        self._focal_px = SHARE * view.focal_px
        height, width = self._size
        v, u = np.mgrid[0:height, 0:width]
        plane = np.stack([(u + 0.5 - width / 2) / self._focal_px, (v + 0.5 - height / 2) / self._focal_px, 1.0 + 0 * u])
        rays = plane.reshape(3, -1) / np.linalg.norm(plane.reshape(3, -1), axis=0)
        self._rays = Rays(jnp.asarray(rays, jnp.float32), jnp.zeros(rays.shape[1], jnp.float32))
        self._dark = jnp.zeros(rays.shape[1], jnp.float32)
        exposure = TONE / float(np.mean(scene.room.tone))
        # the edges of a frame are darker
        self._exposure = (exposure * rays[2] ** 1.5).reshape(height, width).astype(np.float32)

    @property
    def room(self) -> Room:
        """Corners and surfaces."""
        return self._scene.room

    def image(self, view: View) -> np.ndarray:
        """Return the empty hall (H, W, 3) BGR uint8."""
        pose = view.p_world.astype(np.float32), view.rotation.astype(np.float32)
        light = add_brightness(self._dark, self._stack, self._scene, pose, self._rays, float(1 / self._focal_px))
        levels = np.clip(np.asarray(light).reshape(self._size) * self._exposure, 0, 1)
        colored = cv2.LUT(cv2.cvtColor((255 * levels).astype(np.uint8), cv2.COLOR_GRAY2BGR), _SHADE_OF_LEVEL)
        return cv2.resize(colored, self._frame, interpolation=cv2.INTER_LINEAR)


def _scene(flight: Flight, rng):
    """Return the scene as the simulator draws it; without a track a room around the path."""
    if flight.track is not None:
        return scenes.race_scene(flight.track, flight.looks, rng)
    low, high = flight.path.p_world.min(axis=0) - MARGIN_M, flight.path.p_world.max(axis=0) + MARGIN_M
    low[2] = flight.path.p_world[:, 2].min()
    return scenes.exposed(NO_PLATES, scenes.room(low, high, flight.looks, rng), flight.looks, rng)


def _lut() -> np.ndarray:
    at = np.linspace(0, 1, 256)
    columns = [np.interp(at, np.linspace(0, 1, len(SHADES)), SHADES[:, channel]) for channel in range(3)]
    return np.stack(columns, axis=-1)[None].astype(np.uint8)


_SHADE_OF_LEVEL = _lut()
