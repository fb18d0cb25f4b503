"""Images drawn beside the simulation, by a thread of their own: the graph works on while one is made."""

import queue
import threading
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class View:
    """Where the body was at an image's stamp: m and x y z w in the world, m/s in the world, rad/s in the body."""

    stamp_ns: int
    p_world: np.ndarray
    q_world_body: np.ndarray
    v_world: np.ndarray
    omega_body: np.ndarray


class ImageThread:
    """Draws views one after another with `render(p_world, q_world_body, v_world, omega_body)` and gives each image to
    `publish(image, stamp_ns)`."""

    def __init__(self, render: Callable, publish: Callable):
        self._render, self._publish = render, publish
        self._views: queue.Queue[View | None] = queue.Queue()
        self._thread = threading.Thread(target=self._work, name="images", daemon=True)
        self._thread.start()

    @property
    def native_id(self) -> int:
        """The thread, as the operating system calls it."""
        return self._thread.native_id

    @property
    def busy(self) -> bool:
        """Whether an image is still being made."""
        return self._views.unfinished_tasks > 0

    def draw(self, view: View) -> None:
        """Draw a view after those before it."""
        self._views.put(view)

    def close(self) -> None:
        """Finish what is begun and end."""
        self._views.put(None)
        self._thread.join(timeout=2.0)

    def _work(self) -> None:
        while (view := self._views.get()) is not None:
            image = self._render(view.p_world, view.q_world_body, view.v_world, view.omega_body)
            self._publish(image, view.stamp_ns)
            self._views.task_done()
