"""The composer: one call draws one labelled image."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from swift_ros.camera import model as lens
from swift_sim_bridge.gate_detector.corner_states import IGNORED, VISIBLE
from swift_sim_bridge.gate_detector.images.composites import (
    exposure,
    frames,
    gates,
    objects,
    own,
    paint,
    pictures,
    scenes,
    visibility,
)
from swift_sim_bridge.gate_detector.images.composites.panels import View

SHADOW_SHARE = 0.6  # of the images with a ground in which things cast shadows
POST_SHARE, MARKER_SHARE = 0.7, 0.12  # of the gates that stand on posts, and that carry a square code
CONTRAST_OF_NOISE = 0.5  # least contrast of a visible corner, in standard deviations of the noise


@dataclass(frozen=True)
class Composition:
    """A composite with its labels; corners in the order TL, TR, BR, BL as seen from the camera.

    Attributes:
        image: (H, W) uint8, as published.
        r_world_camera: (3, 3), attitude of the camera.
        rays_camera: (n, 4, 3) m, inner corners in the optical frame.
        state: (n, 4), HIDDEN, VISIBLE or IGNORED.
        side_px: (n,), shortest side in the image.
        oblique_deg: (n,), angle between the line of sight and the gate's normal.
        distance: (n,) m.
        scene: kind of the background.
        families: (n,), of the gates.
    """

    image: np.ndarray
    r_world_camera: np.ndarray
    rays_camera: np.ndarray
    state: np.ndarray
    side_px: np.ndarray
    oblique_deg: np.ndarray
    distance: np.ndarray
    scene: str
    families: tuple[str, ...]


class Composer:
    """Draws composites, which depend on the settings, the pictures and the random generator only."""

    def __init__(self, looks, given: pictures.Pictures):
        """Make a composer.

        Args:
            looks: `CompositeLooks`.
            given: pictures of the user.
        """
        self.looks, self.pictures = looks, given

    def compose(self, camera, rng) -> Composition:
        """Return an image of a camera (`swift_ros.camera.model.Camera`) and its labels."""
        looks, paints = self.looks, paint.Paints(rng)
        view = View(camera, gates.attitude(looks, rng))
        kind = self._scene(rng)
        placed = self._gates(view, paints, kind, rng)
        room = self._room(placed, rng)
        surroundings = self._surroundings(view, kind, room, paints, rng)
        aims = [body.front.centre for body, _ in placed]
        count = int(rng.integers(looks.clutter[0], looks.clutter[1] + 1))
        others = objects.clutter(count, room, aims, looks, paints, rng)
        standing = [(self._supported(body, room, paints, rng), family) for body, family in placed]
        bodies = sorted([*standing, *((body, "") for body in others)], key=lambda item: -item[0].distance)
        if rng.random() < SHADOW_SHARE and kind in ("outdoors", "hall", "plain"):
            sunlight, depth = scenes.draw_sun(rng), float(rng.uniform(0.1, 0.7))
            for body, _ in bodies:
                view.draw(surroundings.image, scenes.shadow(body.front, sunlight, room.floor, depth))
        seen = self._painted(view, surroundings, [body for body, _ in bodies], rng)
        families = tuple(family for body, family in bodies for _ in body.openings)
        return self._photographed(view, surroundings.image, seen, (kind, families), rng)

    def _scene(self, rng) -> str:
        if self.pictures.photographs and rng.random() < self.looks.photograph_share:
            return "photograph"
        return str(rng.choice(self.looks.scenes))

    def _surroundings(self, view, kind, room, paints, rng):
        if kind != "photograph":
            return scenes.DRAW[kind](view, room, paints, rng)
        files = self.pictures.photographs
        return scenes.photograph(view, paints.grey(pictures.photograph(files[rng.integers(len(files))])), rng)

    def _gates(self, view, paints, kind, rng):
        """Return the gates and their families."""
        looks = self.looks
        if rng.random() < looks.negative_share:
            return []
        found = []
        family = self._family(kind, rng)
        for _ in range(int(rng.integers(looks.gates[0], looks.gates[1] + 1))):
            family = family if rng.random() < 0.7 else self._family(kind, rng)
            centre, side, side_px = gates.place(view, looks, rng, ahead=not found)
            if family == "own":
                chosen = self.pictures.own_gates[rng.integers(len(self.pictures.own_gates))]
                body = own.body(chosen, own.Place(centre, side, side_px), looks, paints, rng)
            else:
                aspect = 1.0 if rng.random() < 0.6 else float(np.exp(rng.normal(0, 0.15)))
                face = frames.face(family, (side * aspect, side), side_px, looks, paints, rng)
                body = gates.body(face, centre, gates.axes(centre, looks, rng), looks, rng)
            if all(abs(body.distance - other.distance) > 0.4 * side for other, _ in found):
                found.append((body, family))
        return found

    def _family(self, kind, rng) -> str:
        if self.pictures.own_gates and rng.random() < self.looks.own_gate_share:
            return "own"
        if kind == "dark" and "led" in self.looks.families and rng.random() < 0.5:
            return "led"
        return str(rng.choice(self.looks.families))

    def _room(self, placed, rng) -> scenes.Room:
        outlines = [panel.outline()[:, 2] for body, _ in placed for panel in body.panels] or [np.array([-0.5, 0.5])]
        lowest, highest = min(heights.min() for heights in outlines), max(heights.max() for heights in outlines)
        farthest = max((body.distance for body, _ in placed), default=rng.uniform(4, 15))
        floor = min(lowest, -0.3) - (rng.uniform(0.0, 0.05) if rng.random() < 0.4 else rng.uniform(0.05, 1.5))
        return scenes.Room(float(floor), float(highest), float(1.15 * farthest + 1.0))

    def _supported(self, body, room, paints, rng):
        """Return a gate with what carries it and what is fixed to it."""
        below = gates.posts(body, room.floor, paints.tone(), rng) if rng.random() < POST_SHARE else ()
        if rng.random() < MARKER_SHARE:
            below = (*below, gates.marker(body, (paints.tone("black", "blue"), paints.tone("white")), rng))
        return replace(body, panels=(*below, *body.panels))

    def _painted(self, view, surroundings, bodies, rng) -> tuple[np.ndarray, np.ndarray]:
        """Paint bodies, from the farthest to the nearest; return the corners (n, 4, 3) of their openings and states.

        The states (n, 4) are those in an image of unlimited size.
        """
        image, corners, states = surroundings.image, [np.zeros((0, 4, 3))], [np.zeros((0, 4), int)]
        for k, body in enumerate(bodies):
            light = surroundings.light * rng.uniform(0.7, 1.2)
            if len(body.openings) and rng.random() < self.looks.backlit_share:
                light *= rng.uniform(0.1, 0.5)
            haze = 1 - float(np.exp(-body.distance / surroundings.haze_m)), surroundings.haze_tone
            frame = visibility.beside_edges(view, body.openings)[1]
            before = visibility.levels_at(image, frame)
            for panel in body.panels:
                view.draw(image, panel, haze, light)
            if len(body.openings):
                nearer = [panel for other in bodies[k + 1 :] for panel in other.panels if panel.solid]
                state = visibility.together(visibility.covered(view, body.openings, nearer), body.states)
                faint = visibility.changes(before, visibility.levels_at(image, frame)) < visibility.LEAST_CHANGE
                states.append(np.where(faint & (state == VISIBLE), IGNORED, state))
                corners.append(body.openings)
        return np.concatenate(corners), np.concatenate(states)

    def _photographed(self, view, image, seen, names, rng) -> Composition:
        """Return the composition of a painted scene.

        Args:
            view: of the image.
            image: (H, W), brightness of the scene.
            seen: corners (n, 4, 3) m in the world and states (n, 4), see `_painted`.
            names: of the scene, and of the families.
            rng: generator.
        """
        looks, camera = self.looks, view.camera
        image = exposure.glowing(image, rng)
        if rng.random() < looks.flare_share:
            exposure.flare(image, rng)
        motion = exposure.draw_motion(view, looks, rng)
        if motion:
            image = exposure.moved(image, motion)
        outside = view.rays[..., 2] < np.cos(camera.half_angle)
        levels = exposure.developed(image, view, looks, rng)
        levels[outside] = 0
        published, noise = exposure.recorded(levels, looks, rng)
        published[outside] = 0

        corners, state = seen
        pixels, theta = view.project(corners)
        rays, beside = corners @ view.r_world_camera, visibility.beside_edges(view, corners)
        if motion and motion.readout:
            pixels, beside = exposure.moved_points(pixels, motion), exposure.moved_points(beside, motion)
            rays = lens.unproject(camera, pixels) * np.linalg.norm(rays, axis=-1, keepdims=True)
        state = visibility.bordered(camera, pixels, theta, state)
        soft = (cv2.blur(picture.astype(np.float32), (3, 3)) for picture in (levels, published))
        contrast = np.minimum(*(visibility.contrasts(picture, beside) for picture in soft))
        faint = contrast < max(looks.least_contrast, CONTRAST_OF_NOISE * noise)
        state = np.where(faint & (state == VISIBLE), IGNORED, state)
        return Composition(published, view.r_world_camera, rays, state, *_geometry(corners, pixels), *names)


def _geometry(corners, pixels):
    """Return the shortest sides (n,) px, the obliquities (n,) degrees and the distances (n,) m of gates."""
    side = np.linalg.norm(pixels - np.roll(pixels, -1, axis=1), axis=-1).min(axis=1)
    centre = corners.mean(axis=1)
    distance = np.linalg.norm(centre, axis=-1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0])
    cosine = np.abs(np.sum(normal * centre, axis=-1)) / np.maximum(np.linalg.norm(normal, axis=-1) * distance, 1e-12)
    return side, np.degrees(np.arccos(np.clip(cosine, 0, 1))), distance
