"""Shared by all tests: a ROS domain of their own, compiled code, and the recordings beside the repository."""

import atexit
import os
import shutil
import tempfile
from pathlib import Path

import pytest

from swift_ros.graph.discovery import choose
from swift_ros.graph.domain import free_domain
from swift_ros.library_threads import use_one_thread

ROOT = Path(__file__).resolve().parent.parent

# Before any import of rclpy: two runs at the same time, a race, or a drone on the network must not receive each other's
# messages. The domain is reserved until this process ends.
os.environ.pop("ROS_DOMAIN_ID", None)
DOMAIN, RESERVATION = free_domain()
os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)
choose("local")

use_one_thread(os.environ)  # before any import of NumPy: the two processes share the cores already

# Before any import of JAX: trainings run on two devices, as `swiftros train policy` does on two cores.
os.environ.setdefault("JAX_NUM_CPU_DEVICES", "2")

# Before any import of JAX: the simulators that the tests start share compiled code with each other and with the tests.
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    os.environ["JAX_COMPILATION_CACHE_DIR"] = tempfile.mkdtemp(prefix="swift-tests-")
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.5"
    atexit.register(shutil.rmtree, os.environ["JAX_COMPILATION_CACHE_DIR"], ignore_errors=True)


def compile_without_optimisation() -> None:
    """Make JAX optimise no code of this process: tests compile more than they compute.

    A program is compiled as a whole: its parts are for threads that have a core each. The simulators that the tests
    start compute more than they compile. They do not inherit it.
    """
    flags = "--xla_cpu_multi_thread_eigen=false --xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0"
    flags += " --xla_cpu_parallel_codegen_split_count=1"
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("XLA_FLAGS", flags)
        import jax  # after the variables above

        jax.devices()  # reads the flags, once


if "XLA_FLAGS" not in os.environ:
    compile_without_optimisation()


def pytest_collection_modifyitems(items):
    """Mark all scenarios as slow."""
    for item in items:
        if item.path.is_relative_to(ROOT / "tests" / "scenarios"):
            item.add_marker("slow")


@pytest.hookimpl(optionalhook=True)  # of pytest-xdist
def pytest_xdist_make_scheduler(config, log):
    """Give each process whole files, and all tests that start graphs of nodes to one process.

    Files have fixtures that take long. Graphs at the same time would be late.
    """
    from xdist.scheduler import LoadFileScheduling

    class GraphsInOneProcess(LoadFileScheduling):
        def _split_scope(self, nodeid):
            file = super()._split_scope(nodeid)
            return file if file.startswith(("tests/unit/", "tests/fuzz/")) else "graphs"

    return GraphsInOneProcess(config, log)


@pytest.fixture(scope="session")
def repository() -> Path:
    """Root folder of the repository."""
    return ROOT


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the public flight recordings, `../shared/data`; without it the test is skipped."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"needs the flight recordings in {folder}, which is absent")
    return folder


@pytest.fixture(scope="session")
def sitl_binary() -> str:
    """Path of a Betaflight SITL binary, from $SWIFT_SITL; without it the test is skipped."""
    path = os.environ.get("SWIFT_SITL")
    if not path:
        pytest.skip("needs the real firmware: set SWIFT_SITL to a Betaflight 4.5 SITL binary (docs/simulation/sitl.md)")
    return path
