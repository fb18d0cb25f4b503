"""Threads of the libraries: linear algebra of NumPy and SciPy, and OpenCV."""

from collections.abc import MutableMapping


def use_one_thread(environment: MutableMapping[str, str]) -> None:
    """Limit these libraries to one thread in processes with this environment, unless it says otherwise.

    The matrices and images here are small: more threads are no faster, and wait actively. OpenCV's wait costs the gate
    detector 0.4 ms an image. The libraries read it when they are imported.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
        environment.setdefault(name, "1")
