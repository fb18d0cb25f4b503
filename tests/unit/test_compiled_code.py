"""Tests of compiled code that outlives a run."""

import os
import subprocess
import sys

import pytest

from swift_sim_bridge import compiled_code

COMPILES = """
import jax
from swift_sim_bridge.compiled_code import keep_compiled_code
keep_compiled_code()
hits = []
jax.monitoring.register_event_listener(lambda event, **_: hits.append(event))
jax.jit(lambda x: x * 2 + 1)(3.0)
print("/jax/compilation_cache/cache_hits" in hits)
"""


@pytest.mark.parametrize("named_by", ["XDG_CACHE_HOME", "JAX_COMPILATION_CACHE_DIR"])
def test_a_second_run_takes_the_code_that_the_first_compiled(tmp_path, named_by):
    environment = {key: value for key, value in os.environ.items() if not key.startswith("JAX_")}
    environment[named_by] = str(tmp_path)
    said = [
        subprocess.run([sys.executable, "-c", COMPILES], env=environment, capture_output=True, text=True, check=True)
        for _ in range(2)
    ]
    assert [one.stdout.strip() for one in said] == ["False", "True"]


def test_a_processor_with_another_instruction_set_has_another_folder(tmp_path, monkeypatch):
    folders = set()
    for features in ("sse avx", "sse avx avx512f"):
        described = tmp_path / features
        described.write_text(f"processor: 0\nflags: {features}\nbogomips: {len(folders)}\n")
        monkeypatch.setattr(compiled_code, "CPU_DESCRIPTION", described)
        folders.add(compiled_code.cache_folder())
    assert len(folders) == 2
