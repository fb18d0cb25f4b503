"""Concurrent evaluation in threads: compiled array code, which takes most of the time, releases the interpreter."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import jax


def run_in_threads(*tasks: Callable) -> list:
    """Return the result of each task, in their order; as many tasks run at once as there are cores."""

    def in_double_precision(task):
        with jax.enable_x64(True):  # the setting is local to a thread
            return task()

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(in_double_precision, tasks))
