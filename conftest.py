"""Fixtures that more than one test file uses."""

from __future__ import annotations

import atexit
import contextlib
import gc
import os
import shutil
import signal
import sys
import tempfile
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

# What a run of the tests sees of the machine is its own, from collection on: home, configuration,
# caches, signals. Set when this file is imported, which is before any test module is, and before
# JAX reads its variables. Worker processes and command lines inherit it.
_MARK = "SMOOTH_OPERATOR_TEST_HOME"
_HOMES = (
    "HOME",
    "USERPROFILE",
    "XDG_CONFIG_HOME",
    "XDG_CACHE_HOME",
    "XDG_DATA_HOME",
    "APPDATA",
    "LOCALAPPDATA",
)
_ALLOWED = (_MARK, "SMOOTH_OPERATOR_CACHE")
"""Variables of this program that a run has from outside: folder of traced programs."""


HOME = Path(__file__).resolve().parent


def _set_up_environment() -> None:
    if _MARK in os.environ:
        return
    home = tempfile.mkdtemp(prefix="smooth-operator-tests-")
    atexit.register(shutil.rmtree, home, ignore_errors=True)
    for name in [n for n in os.environ if n.startswith("SMOOTH_OPERATOR_") and n not in _ALLOWED]:
        del os.environ[name]
    os.environ.pop("MENAGERIE_ROOT", None)
    for name in _HOMES:
        if name in os.environ or name == "HOME":
            os.environ[name] = home
    os.environ[_MARK] = home
    # One compile cache for the whole run: many tests build the same retargeter.
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", os.path.join(home, "jax"))
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")
    # Compiling is most of the time of most tests: with few optimisations it takes half as long, and
    # programs that run a few hundred frames win.
    os.environ.setdefault("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")
    # Nobody reads where in Python each operation of a program came from; to note it costs a tenth.
    os.environ.setdefault("JAX_INCLUDE_FULL_TRACEBACKS_IN_LOCATIONS", "0")
    # Programs compile in half the time without XLA's newer emitter of loops. XLA ends a process for
    # a flag that it doesn't know, so other versions have none.
    lock = HOME / "requirements.lock"
    locked = lock.read_text(encoding="utf-8").split() if lock.is_file() else []
    if f"jaxlib=={metadata.version('jaxlib')}" in locked:
        os.environ.setdefault("XLA_FLAGS", "--xla_cpu_use_fusion_emitters=false")
    # Threads of one matrix product wait for each other: on busy cores least squares took 24 s so,
    # and 0.1 s on one thread. Workers of pytest-xdist load NumPy after this, so it holds for them.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # MuJoCo chooses how it draws when a test first imports it.
    from smooth_operator.errors import ConfigError
    from smooth_operator.simulation.renderer import draw_off_screen

    with contextlib.suppress(ConfigError):
        draw_off_screen()


PARTS = (
    (HOME / "research", "src"),
    (HOME / "packages" / "smooth_hand_datasets", ""),
    (HOME / "packages" / "smooth_operator_benchmark", ""),
    (HOME / "packages" / "smooth_operator_study", ""),
    (HOME / "packages" / "smooth_operator_devices", ""),
)
"""Folder of a distribution of this repository, and the folder in it of its modules."""


def _offer_parts(root: Path, source: str) -> None:
    """The entry points of a distribution, if it is not installed."""
    if not (root / "pyproject.toml").is_file():
        return
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    try:
        metadata.distribution(project["name"])
        return
    except metadata.PackageNotFoundError:
        pass
    home = Path(tempfile.mkdtemp(prefix="smooth-operator-parts-"))
    folder = home / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    folder.mkdir()
    name, version = project["name"], project["version"]
    (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    groups = project["entry-points"].items()
    text = "".join(
        f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in points.items())
        for group, points in groups
    )
    (folder / "entry_points.txt").write_text(text)
    paths = [str(root / source), str(home)]
    sys.path += paths
    inherited = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    os.environ["PYTHONPATH"] = os.pathsep.join([*filter(None, inherited), *paths])


_set_up_environment()
for part in PARTS:
    _offer_parts(*part)
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # as `nohup pytest &` starts it
    signal.signal(signal.SIGINT, signal.default_int_handler)
for name in ("SIGHUP", "SIGQUIT"):  # ignored in the same way; commands that tests end inherit that
    if (number := getattr(signal, name, None)) and signal.getsignal(number) == signal.SIG_IGN:
        signal.signal(number, signal.SIG_DFL)

SHARED = Path(__file__).resolve().parents[1] / "shared"

LONG_FILES = (
    "test_lint.py",
    "test_live_page.py",
    "test_webxr.py",
    "test_study_console_browser.py",
    "test_bench.py",
    "test_ui.py",
    "test_examples.py",
    "test_batch.py",
    "test_offline_smoother.py",
    "test_calibration.py",
    "test_study_analysis.py",
    "test_slsqp_method.py",
    "test_published_methods.py",
    "test_hand_validation.py",
    "test_corpus.py",
    "test_cli.py",
    "test_dynamixel.py",
    "test_retarget_folder.py",
    "test_dataset_pipeline.py",
    "test_parallel.py",
    "test_smooth.py",
    "test_signals.py",
    "test_study_report.py",
    "test_hand_matrix.py",
    "test_study_power.py",
    "test_remote.py",
    "test_bad_requests.py",
    "test_smooth_posture.py",
    "test_site.py",
    "test_plugin.py",
    "test_membership.py",
    "test_clip.py",
    "test_extras.py",
    "test_compiled_program.py",
)
"""Files that take long for how few tests they have, the longest first. They run first: the worker
that took one of them last would be alone with it. The others follow by number of tests, as
pytest-xdist has it."""


def pytest_configure(config: pytest.Config) -> None:
    """The order of the files is that of ``pytest_collection_modifyitems``."""
    if hasattr(config.option, "loadscopereorder"):  # of pytest-xdist
        config.option.loadscopereorder = False
    # Tracing makes millions of objects: at the usual threshold a tenth of the time is collecting.
    gc.set_threshold(100_000, 50, 100)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long files first, then those with the most tests; tests of a file keep their order."""
    counts = Counter(item.path.name for item in items)

    def place(item: pytest.Item) -> tuple[int, int]:
        name = item.path.name
        rank = LONG_FILES.index(name) if name in LONG_FILES else len(LONG_FILES)
        return rank, -counts[name]

    items.sort(key=place)


def pytest_collection_finish() -> None:
    """What has been imported stays: the collector need not look at it."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real hand models and recordings beside the checkout, or a skip."""
    if not (SHARED / "recordings").is_dir():
        pytest.skip("the folder of real hands and recordings is not beside this checkout")
    return SHARED


@pytest.fixture(scope="module")
def hand() -> Any:
    """The default robot hand."""
    from smooth_operator.hands.registry import load_hand

    return load_hand("mimic_p050")


@pytest.fixture(scope="module")
def hands(hand: Any) -> dict[str, Any]:
    """The default robot hand of both sides."""
    from smooth_operator.hands.registry import load_hand

    return {"right": hand, "left": load_hand("mimic_p050", "left")}


@pytest.fixture(scope="module")
def emulator(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The script of the emulated headset, or a skip."""
    from emulated_headset import NoEmulator, fetch_emulator

    cache = getattr(request.config, "cache", None)  # may be switched off
    try:
        return fetch_emulator(
            tmp_path_factory.mktemp("iwer") if cache is None else Path(cache.mkdir("iwer"))
        )
    except NoEmulator as why:
        pytest.skip(str(why))


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """A headless browser with software rendering, or a skip."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    names = ("chromium", "chromium-browser", "google-chrome")
    path = next((found for name in names if (found := shutil.which(name))), None)
    if path is None:
        pytest.skip(f"no browser: none of {', '.join(names)} is on the path")
    flags = [
        "--no-sandbox",
        "--use-gl=angle",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        "--webgl-antialiasing-mode=none",
        "--disable-gpu-compositing",  # on a software GPU, that takes a third of the time
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
    ]
    with sync_api.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, headless=True, args=flags)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def compiled_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A folder of programs for a test file's processes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SMOOTH_OPERATOR_CACHE", str(tmp_path_factory.mktemp("cache")))
        patch.delenv("SMOOTH_OPERATOR_DEBUG", raising=False)
        yield


@pytest.fixture
def optimised() -> Iterator[None]:
    """XLA's optimisations, for a test whose programs run long enough to win by them."""
    import jax

    before = jax.config.read("jax_disable_most_optimizations")
    jax.config.update("jax_disable_most_optimizations", False)
    yield
    jax.config.update("jax_disable_most_optimizations", before)


@pytest.fixture
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A working folder of its own: MuJoCo writes its warnings there."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def own_hands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a user's own hands; it is made with the first one."""
    monkeypatch.setenv("SMOOTH_OPERATOR_HANDS", str(folder := tmp_path / "hands of ünser user"))
    return folder


@pytest.fixture(scope="module")
def reader() -> Iterator[Any]:
    """A process with limits that reads files, by readers of ``hostile_files`` among others."""
    from fuzzing import ReaderProcess

    with ReaderProcess([str(HOME / "tests")]) as process:
        yield process


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Runs a command in this process: exit status, standard output and standard error."""
    from smooth_operator.cli import main

    def call(*arguments: object) -> tuple[int, str, str]:
        capfd.readouterr()
        status = main([str(argument) for argument in arguments])
        return status, *capfd.readouterr()

    return call
