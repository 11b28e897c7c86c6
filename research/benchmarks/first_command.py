"""Process that ``startup.py`` measures: imports, loads, compiles, computes one command and exits.

Reads its job as JSON from standard input; writes seconds per stage as JSON to standard output.
"""
# ruff: noqa: E402  imports are what is being timed

import time

BORN = time.time()  # before any other import

import json
import sys
from collections import defaultdict

job = json.load(sys.stdin)
clock = time.perf_counter
seconds: defaultdict[str, float] = defaultdict(float, trace_s=0, compile_s=0, cache_read_s=0)
hits = 0

start = clock()
import jax

seconds["import_jax_s"] = clock() - start

EVENTS = {
    "/jax/core/compile/jaxpr_trace_duration": "trace_s",
    "/jax/core/compile/jaxpr_to_mlir_module_duration": "trace_s",
    "/jax/core/compile/backend_compile_duration": "compile_s",
    "/jax/compilation_cache/cache_retrieval_time_sec": "cache_read_s",
}


def on_duration(event: str, duration_secs: float, **_: object) -> None:
    if event in EVENTS:
        seconds[EVENTS[event]] += duration_secs


def on_event(event: str, **_: object) -> None:
    global hits
    hits += event == "/jax/compilation_cache/cache_hits"


jax.monitoring.register_event_duration_secs_listener(on_duration)
jax.monitoring.register_event_listener(on_event)

start = clock()
import smooth_operator
from smooth_operator import Retargeter  # names are imported when they are first used
from smooth_operator.retargeting import ProgramStore

seconds["import_package_s"] = clock() - start

start = clock()
hand = smooth_operator.load_hand(job["hand"])
seconds["load_hand_s"] = clock() - start

start = clock()
retargeter = Retargeter(
    hand, method=job["method"], preset=job["preset"], cache=ProgramStore.of_user()
)
seconds["build_s"] = clock() - start

before = sum(seconds[name] for name in set(EVENTS.values()))
start = clock()
result = retargeter(job["landmarks"])
whole = clock() - start
end = time.time()

if result.status != smooth_operator.Status.OK:
    sys.exit(f"the first frame was not answered: {result.status.reason}")

from smooth_operator_research.run_report import memory_mib

# A read from the cache happens inside what JAX calls a compilation.
seconds["compile_s"] -= seconds["cache_read_s"]
rest = whole - (sum(seconds[name] for name in set(EVENTS.values())) - before)
answer = {
    **seconds,
    "interpreter_s": BORN - job["start"],
    "first_call_rest_s": rest,
    "total_s": end - job["start"],
    "cpu_s": time.process_time(),
    "cache_hits": hits,
}
memory = memory_mib()
if memory is not None:
    answer["peak_mib"] = memory
print(json.dumps(answer))
