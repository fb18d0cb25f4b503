"""Rendering in a thread of its own, so that the graph continues while an image is rendered."""

import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class View:
    """Pose and velocity of the body at the stamp of an image.

    Attributes:
        stamp_ns: of the image.
        p_world: (3,) m.
        q_world_body: (4,).
        v_world: (3,) m/s.
        omega_body: (3,) rad/s.
    """

    stamp_ns: int
    p_world: np.ndarray
    q_world_body: np.ndarray
    v_world: np.ndarray
    omega_body: np.ndarray


class ImageThread:
    """Renders views one after another and publishes the images."""

    def __init__(self, render: Callable, publish: Callable):
        """Start the thread.

        Args:
            render: (p_world, q_world_body, v_world, omega_body) -> image.
            publish: called with (image, stamp_ns).
        """
        self._render, self._publish = render, publish
        self._views: queue.Queue[View | None] = queue.Queue()
        self._thread = threading.Thread(target=self._work, name="images", daemon=True)
        self._thread.start()

    @property
    def native_id(self) -> int:
        """Identifier of the thread in the operating system."""
        return self._thread.native_id

    @property
    def busy(self) -> bool:
        """Whether an image is queued or being rendered."""
        return self._views.unfinished_tasks > 0

    def draw(self, view: View) -> None:
        """Queue a view."""
        self._views.put(view)

    def close(self) -> None:
        """Render what is queued and end the thread."""
        self._views.put(None)
        self._thread.join(timeout=2.0)

    def _work(self) -> None:
        while (view := self._views.get()) is not None:
            image = self._render(view.p_world, view.q_world_body, view.v_world, view.omega_body)
            self._publish(image, view.stamp_ns)
            self._views.task_done()
