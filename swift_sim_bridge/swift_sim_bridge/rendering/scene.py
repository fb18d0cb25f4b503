"""The scene of the renderer: gates and other flat objects in a box-shaped room, its surfaces, lamps and exposure.

A scene is plain arrays. All random draws are made when it is built, from a generator that the caller seeds.
"""

from dataclasses import dataclass, replace

import jax
import numpy as np

from swift_ros.configuration import refuse_falling, refuse_outside, within
from swift_sim_bridge.rendering import textures

PAIRS = ("room_margin", "tile", "gate_tone", "surface_tone", "contrast", "gain", "gamma", "glare")
PAIRS += ("vignetting", "noise")


@dataclass(frozen=True)
class Looks:
    """Section `renderer` of `config/simulation.yaml`: how scenes look. Pairs are (lowest, highest) of a uniform draw.

    Attributes:
        families: texture families, see `textures`.
        textures: number of textures that a renderer draws.
        room_margin: m, from the flight volume to walls and ceiling.
        tile: m of wall that one texture covers.
        gate_tone, surface_tone: mean brightness (0..1 at gain 1) of frames and of walls.
        contrast: of textures.
        gain, gamma: of the exposure.
        lamps: number of ceiling lamps with glare.
        glare: brightness of a lamp.
        vignetting: share of light that is lost at the edge of the image circle.
        noise: standard deviation, grey levels.
        blur_poses: largest number of poses averaged over the exposure.
    """

    families: tuple[str, ...]
    textures: int = within(1, 10_000)
    room_margin: tuple[float, float] = within(0.0, 1000.0)
    tile: tuple[float, float] = within(0.01, 1000.0)
    gate_tone: tuple[float, float] = within(0.0, 1.0)
    surface_tone: tuple[float, float] = within(0.0, 1.0)
    contrast: tuple[float, float] = within(0.0, 1.0)
    gain: tuple[float, float] = within(0.01, 100.0)
    gamma: tuple[float, float] = within(0.05, 10.0)
    lamps: int = within(0, 1000)
    glare: tuple[float, float] = within(0.0, 100.0)
    vignetting: tuple[float, float] = within(0.0, 1.0)
    noise: tuple[float, float] = within(0.0, 255.0)
    blur_poses: int = within(1, 1000)

    def __post_init__(self):
        for family in self.families:
            refuse_outside(textures.FAMILIES, families=family)
        if not self.families:
            raise ValueError(f"'families' names none; list one or more of {', '.join(textures.FAMILIES)}")
        refuse_falling(**{name: value for name, value in vars(self).items() if name in PAIRS})


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Plates:
    """Flat rectangles with a rectangular opening, in the world frame: gates, and panels (opening of size zero).

    Attributes:
        centre: (n, 3) m.
        rotation: (n, 3, 3), columns are normal, left, up.
        half_outer, half_inner: (n, 2) m, half sides to the left and up.
        texture: (n,), row of the texture stack.
        tone, contrast: (n,).
    """

    centre: np.ndarray
    rotation: np.ndarray
    half_outer: np.ndarray
    half_inner: np.ndarray
    texture: np.ndarray
    tone: np.ndarray
    contrast: np.ndarray


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Room:
    """A box-shaped room. Values (6,) belong to its sides -x, +x, -y, +y, floor, ceiling.

    Attributes:
        low, high: (3,) m, corners.
        texture: (6,), row of the texture stack.
        tile: (6,) m, covered by one texture.
        tone, contrast: (6,).
        gradient: (3,), relative change of light a metre.
        lamps: (k, 3) m.
        glare: (k,), brightness of the lamps.
    """

    low: np.ndarray
    high: np.ndarray
    texture: np.ndarray
    tile: np.ndarray
    tone: np.ndarray
    contrast: np.ndarray
    gradient: np.ndarray
    lamps: np.ndarray
    glare: np.ndarray


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Scene:
    """Plates, room and exposure: gain, gamma, vignetting, noise (grey levels)."""

    plates: Plates
    room: Room
    gain: np.ndarray
    gamma: np.ndarray
    vignetting: np.ndarray
    noise: np.ndarray


def gate_plates(track, looks: Looks, rng) -> Plates:
    """Return the gates of a track as plates, each with a random texture and tone."""
    count = len(track.gates)
    return Plates(
        centre=track.positions.astype(np.float32),
        rotation=track.rotations.astype(np.float32),
        half_outer=_square(track.outer_sides),
        half_inner=_square(track.inner_sides),
        texture=rng.integers(0, looks.textures, count).astype(np.int32),
        tone=rng.uniform(*looks.gate_tone, count).astype(np.float32),
        contrast=rng.uniform(*looks.contrast, count).astype(np.float32),
    )


def _square(sides) -> np.ndarray:
    """Return half sides (n, 2) of squares, to the left and up."""
    return np.repeat(sides[:, None] / 2, 2, axis=1).astype(np.float32)


def join(*plates: Plates) -> Plates:
    """Return all plates in one record."""
    return jax.tree.map(lambda *rows: np.concatenate(rows), *plates)


def room(bounds_min, bounds_max, looks: Looks, rng) -> Room:
    """Return a room around a flight volume (m), its floor at the volume's lowest height."""
    low = np.array(bounds_min, np.float32) - rng.uniform(*looks.room_margin, 3).astype(np.float32)
    high = np.array(bounds_max, np.float32) + rng.uniform(*looks.room_margin, 3).astype(np.float32)
    low[2] = bounds_min[2]
    lamps = rng.uniform(low, high, (looks.lamps, 3)).astype(np.float32)
    lamps[:, 2] = high[2]
    return Room(
        low=low,
        high=high,
        texture=rng.integers(0, looks.textures, 6).astype(np.int32),
        tile=rng.uniform(*looks.tile, 6).astype(np.float32),
        tone=rng.uniform(*looks.surface_tone, 6).astype(np.float32),
        contrast=rng.uniform(*looks.contrast, 6).astype(np.float32),
        gradient=rng.uniform(-0.012, 0.012, 3).astype(np.float32),
        lamps=lamps,
        glare=rng.uniform(*looks.glare, looks.lamps).astype(np.float32),
    )


def exposed(plates: Plates, surroundings: Room, looks: Looks, rng) -> Scene:
    """Return the scene of plates in a room, with an exposure drawn from the looks."""
    gain, gamma, vignetting, noise = (
        np.float32(rng.uniform(*pair)) for pair in (looks.gain, looks.gamma, looks.vignetting, looks.noise)
    )
    return Scene(plates, surroundings, gain, gamma, vignetting, noise)


def race_scene(track, looks: Looks, rng) -> Scene:
    """Return a track's gates in a room of random looks."""
    plates = gate_plates(track, looks, rng)
    return exposed(plates, room(track.bounds_min, track.bounds_max, looks, rng), looks, rng)


def without_gates(scene: Scene) -> Scene:
    """Return the scene with all plates of size zero, in which a detector must find no gate."""
    zero = np.zeros_like(scene.plates.half_outer)
    return replace(scene, plates=replace(scene.plates, half_outer=zero, half_inner=zero))
