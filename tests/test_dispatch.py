"""How the command has JAX run, and which methods want XLA's pool to have one thread."""

import json
import os
from pathlib import Path

import jax
import pytest
from processes import python

from smooth_operator.retargeting.preset_files import method_config
from smooth_operator.retargeting.start import start_jax


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no choice of cores here")
@pytest.mark.parametrize("one_thread", [True, False])
def test_jax_starts_on_one_core_and_the_process_has_all_of_them_afterwards(one_thread, monkeypatch):
    cores = os.sched_getaffinity(0)
    seen: list[set[int]] = []
    monkeypatch.setattr(jax, "devices", lambda: seen.append(os.sched_getaffinity(0)))
    start_jax(one_thread=one_thread)
    assert [len(each) for each in seen] == ([1] if one_thread else [])
    assert os.sched_getaffinity(0) == cores


COMMAND = """
import json, os, sys, warnings
from pathlib import Path
from smooth_operator.cli import process
def work(set_up) -> int:
    set_up()
    import jax
    names = "jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs"
    print(json.dumps([getattr(jax.config, name) for name in names]))
    jax.jit(lambda x: x * 3)(2.0)
    for kept in Path(jax.config.jax_compilation_cache_dir).glob("*-cache"):
        print(kept.name)
    return 0
process.main = work
sys.exit(process.program())
"""


def ran(**variables: str) -> tuple[list[str], str]:
    """What the command printed: JAX's settings and the kept programs; and its messages."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")}
    done = python("-c", COMMAND, env=environment | {"JAX_PLATFORMS": "cpu"} | variables, check=True)
    return done.stdout.splitlines(), done.stderr


def test_the_command_sets_jax_up_and_replaces_damaged_machine_code(tmp_path):
    cache = str(tmp_path / "cache")
    (settings, *kept), messages = ran(SMOOTH_OPERATOR_CACHE=cache)
    folder, shortest = json.loads(settings)
    assert shortest == 0.0
    assert folder.startswith(cache)
    assert os.stat(folder).st_mode & 0o777 == 0o700
    assert kept
    assert messages == ""
    files = [Path(folder, name) for name in kept]
    whole = [file.read_bytes() for file in files]
    for file in files:
        file.write_bytes(b"")
    assert ran(SMOOTH_OPERATOR_CACHE=cache) == ([settings, *kept], "")
    assert [file.read_bytes() for file in files] == whole


def test_a_folder_that_the_user_has_chosen_for_jax_stays(tmp_path):
    own = str(tmp_path / "own")
    (settings, *kept), _ = ran(JAX_COMPILATION_CACHE_DIR=own)
    assert json.loads(settings) == [own, 1.0]
    assert not kept


def test_only_a_wide_sampler_wants_more_threads():
    assert method_config("smooth", None).one_thread
    assert method_config("sbr", None).one_thread
    assert method_config("dexpilot", None).one_thread
    assert not method_config("sbr", "paper").one_thread
