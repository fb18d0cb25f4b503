"""Concurrent evaluation: in threads, as compiled array code releases the interpreter, and on several JAX devices.

A device is a GPU where JAX sees one, else a core of the processor (`use_all_cores`).
"""

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

import jax
from jax.sharding import Mesh, NamedSharding, PartitionSpec

DEVICES = "devices"  # name of the axis along which arrays are split, for `jax.lax` collectives
SPLIT, WHOLE = PartitionSpec(DEVICES), PartitionSpec()  # along the leading axis; the same on each device


def run_in_threads(*tasks: Callable) -> list:
    """Return the result of each task, in their order; as many tasks run at once as there are cores."""

    def in_double_precision(task):
        with jax.enable_x64(True):  # the setting is local to a thread
            return task()

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(in_double_precision, tasks))


class InBackground:
    """A function whose calls run in a thread of their own, one after the other.

    A call returns at once, or when the call before it has ended; an error of that one is raised then.
    """

    def __init__(self, function: Callable):
        self._function, self._pool = function, ThreadPoolExecutor(1)
        self._running: Future | None = None

    def __call__(self, *arguments) -> None:
        self.wait()
        self._running = self._pool.submit(self._function, *arguments)

    def wait(self) -> None:
        """Wait for the last call, and raise its error."""
        running, self._running = self._running, None
        if running is not None:
            running.result()


def use_all_cores() -> None:
    """Make each core that this process may use a device of JAX; to be called before JAX first computes.

    Within a device, small arrays keep one core busy only. JAX_NUM_CPU_DEVICES and XLA_FLAGS of the environment win.
    """
    # GPUs would round the factors of matrix products to 10 bits: 1 cm of a position 10 m away.
    jax.config.update("jax_default_matmul_precision", "highest")
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")
    if "JAX_NUM_CPU_DEVICES" not in os.environ:
        jax.config.update("jax_num_cpu_devices", len(os.sched_getaffinity(0)))


def devices_for(*lengths: int) -> int:
    """Return the largest number of JAX's devices on which arrays of these lengths can be split evenly."""
    numbers = range(1, len(jax.devices()) + 1)
    return max(number for number in numbers if not any(length % number for length in lengths))


def compile_for_devices(function: Callable, count: int, arguments, results) -> Callable:
    """Return the compiled function, run by each of `count` devices on its share of the arrays.

    Args:
        function: of positional arguments.
        count: number of devices, see `devices_for`.
        arguments: tuple of SPLIT or WHOLE for each argument, or for the parts of a pytree.
        results: likewise for what it returns.
    """
    mesh = Mesh(jax.devices()[:count], (DEVICES,))
    shared = jax.shard_map(function, mesh=mesh, in_specs=arguments, out_specs=results, check_vma=False)
    placed = jax.tree.map(lambda part: NamedSharding(mesh, part), arguments)
    compiled = jax.jit(shared)
    # Placed before: a second call, with the results of the first, would otherwise be compiled anew.
    return lambda *given: compiled(*jax.device_put(given, placed))
