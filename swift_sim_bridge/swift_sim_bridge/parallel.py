"""Several things at once in threads: compiling and array code, which take most of the time, let others run."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import jax


def at_once(*tasks: Callable) -> list:
    """Return what each task returns, as many of them at once as there are cores."""

    def in_double_precision(task):
        with jax.enable_x64(True):  # each thread has its own
            return task()

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(in_double_precision, tasks))
