"""Budget of the fuzz tests: small and the same each time in `make test`; large and random in `make fuzz`.

`make fuzz` sets SWIFT_FUZZ_INPUTS, the number of inputs of each format, and prints at its end what it has done.
"""

import resource
import tempfile
import time
from collections import Counter
from pathlib import Path

import fuzzing
import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis.configuration import set_hypothesis_home_dir

SMALL_BUDGET = 200  # inputs of each format in `make test`
CPU_S: Counter = Counter()

set_hypothesis_home_dir(Path(tempfile.gettempdir()) / "swift-hypothesis")  # nothing is written into the repository
_common = {"database": None, "deadline": None, "suppress_health_check": list(HealthCheck)}
settings.register_profile("small", max_examples=SMALL_BUDGET, derandomize=True, **_common)
settings.register_profile(
    "large",
    max_examples=fuzzing.large_inputs() or SMALL_BUDGET,
    phases=[Phase.explicit, Phase.generate, Phase.shrink],
    **_common,
)
settings.load_profile("large" if fuzzing.large_inputs() else "small")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """Measure the CPU time of the tests of each format."""
    begin_s = time.process_time()
    try:
        return (yield)
    finally:
        CPU_S[item.path.stem.removeprefix("test_")] += time.process_time() - begin_s


def pytest_terminal_summary(terminalreporter):
    """Print the number of inputs and the CPU time of each format after a run with the large budget."""
    if not fuzzing.large_inputs():
        return
    terminalreporter.section("fuzzing")
    for name, seconds in CPU_S.items():
        inputs, valid = fuzzing.TALLY.inputs[name], fuzzing.TALLY.valid[name]
        terminalreporter.write_line(f"{name:<9} {inputs:>10,} inputs, {valid:,} valid, {seconds / 60:.1f} min of CPU")
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    terminalreporter.write_line(f"largest memory of the process: {peak_mb:.0f} MB")
