"""Threads of NumPy's and SciPy's linear algebra."""

from collections.abc import MutableMapping


def use_one_thread(environment: MutableMapping[str, str]) -> None:
    """Limit linear algebra to one thread in processes with this environment, unless it says otherwise.

    The matrices here are small: more threads are no faster, and wait actively. NumPy reads it when it is imported.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        environment.setdefault(name, "1")
