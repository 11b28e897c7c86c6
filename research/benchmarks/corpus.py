"""A corpus of synthetic clips through the pipeline of data sets: memory, pace, kills, and a plan.

    python research/benchmarks/corpus.py --sizes 300 1000 3000          # does cost per clip grow?
    python research/benchmarks/corpus.py --sizes 1000 --kill worker driver
    python research/benchmarks/corpus.py --sizes 100000 --pack          # everything but retargeting
    python research/benchmarks/corpus.py --sizes 0 --plan 20000   # from earlier figures

Clips are made when they are read (``SyntheticCorpus``). Each run is a process of its own, whose
memory is measured after every pack; it runs ``make_dataset``, as a user's program does. With
``--kill`` a further run loses a worker every now and then, or is killed itself half-way and started
again; its files must then be those of the run that nothing happened to. Processor time is that of
the driver and of its processes; workers of Ray are not among them.
"""

from __future__ import annotations

import hashlib
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

MB = 1_000_000
DRIVER = "--as-driver"


@dataclass(frozen=True)
class Settings:
    """What to run.

    Attributes:
        sizes: clips of the corpora, one run each; 0 for none.
        seconds: shortest and longest clip [s].
        rate: frames a second [Hz].
        side: one hand only; both unless given.
        pack: leave out retargeting: the clips are read and written as they are.
        kill: worker: SIGKILL to one of them whenever a tenth of the clips is done; driver: SIGKILL
            to it half-way, and a second run that goes on.
        cluster: none for a pool of processes without Ray; local, or an address.
        workers: as many as there are cores unless given.
        hand: robot hand.
        method: retargeting method.
        preset: of the method.
        folder: where results are written, and stay; a temporary one unless given.
        plan: hours of video to plan for, from the figures of this run or those in the output file.
        nodes: nodes of the plan.
        cores: cores of a node.
        price: of a core and hour.
        output: JSON file; build/benchmarks/corpus.json unless given.
        compare: an earlier JSON file to compare this run with.
    """

    sizes: tuple[int, ...] = (300, 1000, 3000)
    seconds: tuple[float, float] = (2.0, 20.0)
    rate: float = 30.0
    side: Literal["right", "left"] | None = None
    pack: bool = False
    kill: tuple[Literal["worker", "driver"], ...] = ()
    cluster: str = "none"
    workers: int | None = None
    hand: str = "leap_hand"
    method: str = "smooth"
    preset: str | None = None
    folder: Path | None = None
    plan: tuple[float, ...] = ()
    nodes: tuple[int, ...] = (1, 4, 16)
    cores: int = 64
    price: float = 0.04
    output: Path | None = None
    compare: Path | None = None


@dataclass
class Run:
    """Progress and result of one driver.

    Attributes:
        lines: progress, in the order of time; the last one has the result.
        wall_s: time from its start to its end [s].
        code: its exit status; negative for a signal.
    """

    lines: list[dict[str, Any]] = field(default_factory=list)
    wall_s: float = 0.0
    code: int = 0

    @property
    def result(self) -> dict[str, Any]:
        result: dict[str, Any] = self.lines[-1].get("result", {}) if self.lines else {}
        return result


def main(settings: Settings) -> None:
    from smooth_operator_research.run_report import BenchmarkError, Report

    report = Report("corpus", vars(settings))
    sizes = [size for size in settings.sizes if size]
    if settings.kill and not sizes:
        raise BenchmarkError("--kill needs one of --sizes")
    with tempfile.TemporaryDirectory(prefix="corpus-") as temporary:
        home = settings.folder or Path(temporary)
        rows = [measured(report, settings, home, size) for size in sizes]
        if rows:
            report.table(
                f"Clips of {settings.seconds[0]:g} to {settings.seconds[1]:g} s at "
                f"{settings.rate:g} Hz, {settings.side or 'both hands'}, "
                + ("packed without retargeting" if settings.pack else settings.method),
                (
                    "clips",
                    "wall [s]",
                    "first pack [s]",
                    "CPU-ms a clip",
                    "frames a CPU-s",
                    "driver [MB]",
                    "files",
                    "MB",
                ),
                rows,
                0,
            )
        for what in settings.kill:
            kills(report, settings, home, sizes[-1], what)
    if settings.plan:
        figures = report.figures if sizes else earlier(settings)
        plan(report, settings, figures)
    report.finish(settings.output, settings.compare)


def measured(report: Any, settings: Settings, home: Path, size: int) -> list[object]:
    """One undisturbed run: a row of the table."""
    output = home / f"{size}-clips"
    run = driven(settings, output, size)
    check(run, size)
    result = run.result
    files, written = contents(output)
    figures = {
        "wall_s": run.wall_s,
        "startup_s": run.lines[0]["since_start"],
        "cpu_ms_a_clip": result["cpu_s"] / size * 1e3,
        "frames_a_cpu_s": result["frames"] / max(result["cpu_s"], 1e-9),
        "driver_mb": max(line["memory_mb"] for line in run.lines),
        "files": float(files),
        "mb": written / MB,
    }
    report.add(f"{size}", figures)
    hours = result["frames"] / settings.rate / 3600
    more = {
        "hours": hours,
        "core_hours_an_hour": result["cpu_s"] / 3600 / hours,
        "mb_an_hour": written / MB / hours,
        "driver_mb_at_half": run.lines[len(run.lines) // 2]["memory_mb"],
        "failed": float(len(result["failed"])),
        "dropped": float(result["dropped"]),
    }
    report.add(f"{size}", more)
    return [size, *figures.values()]


def kills(report: Any, settings: Settings, home: Path, size: int, what: str) -> None:
    """A run in which something is killed, against the one in which nothing was."""
    from smooth_operator_research.run_report import BenchmarkError

    output = home / f"{size}-clips-{what}-killed"
    killed: list[int] = []
    if what == "worker":
        run = driven(settings, output, size, lambda line: kill_worker(line, size, killed))
        runs = [run]
    else:
        stopped = driven(settings, output, size, lambda line: kill_driver(line, size, killed))
        if stopped.code != -signal.SIGKILL:
            raise BenchmarkError(f"the driver was done before it could be killed ({stopped.code})")
        run = driven(settings, output, size)
        runs = [stopped, run]
    check(run, size)
    same = digest(output) == digest(home / f"{size}-clips")
    figures = {
        "kills": float(len(killed)),
        "done_at_kill": float(max(line["done"] for line in runs[0].lines)),
        "wall_s": sum(each.wall_s for each in runs),
        "same_bytes": float(same),
        "clips": float(run.result["clips"]),
        "failed": float(len(run.result["failed"])),
    }
    report.add(f"{what} killed", figures)
    report.table(
        f"{size} clips, {what} killed",
        (
            "kills",
            "clips done",
            "wall of all runs [s]",
            "same files",
            "clips in the end",
            "failed",
        ),
        [[*figures.values()]],
        0,
    )


def kill_worker(line: dict[str, Any], size: int, killed: list[int]) -> None:
    if size * (len(killed) + 1) / 10 <= line["done"] < size:
        children = Path(f"/proc/{line['process']}/task/{line['process']}/children")
        workers = [
            int(child)
            for child in children.read_text().split()
            if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()
        ]
        if workers:
            killed.append(workers[0])
            os.kill(workers[0], signal.SIGKILL)


def kill_driver(line: dict[str, Any], size: int, killed: list[int]) -> None:
    if not killed and line["done"] >= size / 2:
        killed.append(line["process"])
        os.kill(line["process"], signal.SIGKILL)


def check(run: Run, size: int) -> None:
    from smooth_operator_research.run_report import BenchmarkError

    if run.code or run.result.get("clips") != size:
        raise BenchmarkError(f"the driver ended with status {run.code} before all clips were done")


def driven(
    settings: Settings,
    output: Path,
    size: int,
    watch: Callable[[dict[str, Any]], None] = lambda line: None,
) -> Run:
    """A driver in a process of its own."""
    options = {**asdict(settings), "output": output, "folder": None, "compare": None, "size": size}
    started = time.monotonic()
    run = Run()
    with subprocess.Popen(
        [sys.executable, __file__, DRIVER, json.dumps(options, default=str)],
        stdout=subprocess.PIPE,
        text=True,
    ) as driver:
        assert driver.stdout is not None
        for text in driver.stdout:
            if text.startswith("{"):
                line = json.loads(text)
                line["since_start"] = line["at"] - started
                run.lines.append(line)
                print(f"\r{line['done']} of {size} clips", end="", file=sys.stderr, flush=True)
                watch(line)
        run.code = driver.wait()
    print(file=sys.stderr)
    run.wall_s = time.monotonic() - started
    return run


def drive(options: dict[str, Any]) -> None:
    """Makes a data set, with a line of JSON on standard output after each pack and at the end."""
    from smooth_operator.lab.datasets.pipeline import DatasetRequest, Progress, make_dataset
    from smooth_operator.lab.datasets.readers.synthetic import SyntheticCorpus
    from smooth_operator.lab.datasets.retargeting import Recipe
    from smooth_operator.lab.datasets.work import Entry
    from smooth_operator.planning import make_request

    output = Path(options["output"])
    output.parent.mkdir(parents=True, exist_ok=True)
    source = output.with_name(f"{options['size']}.synthetic.json")
    sides = ("right", "left") if options["side"] is None else (options["side"],)
    SyntheticCorpus(options["size"], *options["seconds"], options["rate"], sides).write(source)
    request = make_request(**{name: options[name] for name in ("hand", "method", "preset")})
    done = 0

    def tell(**more: Any) -> None:
        line = {"at": time.monotonic(), "done": done, "process": os.getpid()}
        print(json.dumps({**line, "memory_mb": peak_mb(), **more}), flush=True)

    class Lines(Progress):
        def retargeted(self, entries: Sequence[Entry]) -> None:
            nonlocal done
            done += len(entries)
            tell()

    summary = make_dataset(
        DatasetRequest(
            (str(source),),
            output,
            Recipe(request, side=options["side"]),
            format="parquet",
            pack=options["pack"],
            workers=options["workers"],
            cluster=None if options["cluster"] == "none" else options["cluster"],
        ),
        Lines(),
    )
    times = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    cpu = sum(each.ru_utime + each.ru_stime for each in times)
    tell(result={**summary.as_json(), "cpu_s": cpu})


def peak_mb() -> float:
    """Largest resident memory of this process so far [MB]."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) / 1e3 for line in lines if line.startswith("VmHWM"))


def contents(output: Path) -> tuple[int, int]:
    """Number of files of a data set, and their bytes."""
    sizes = [p.stat().st_size for p in (output / "dataset").rglob("*") if p.is_file()]
    return len(sizes), sum(sizes)


def digest(output: Path) -> str:
    """Of the names and bytes of the data set's files."""
    hashed = hashlib.sha256()
    for path in sorted(output.rglob("*")):
        inside = path.relative_to(output)
        if path.is_file() and inside.parts[0] in ("dataset", "episodes.jsonl"):
            hashed.update(f"{inside.as_posix()}\0".encode() + path.read_bytes())
    return hashed.hexdigest()


def earlier(settings: Settings) -> dict[str, float]:
    """Figures of the output file of an earlier run."""
    from smooth_operator_research.run_report import RESULTS, BenchmarkError

    path = settings.output or RESULTS / "corpus.json"
    try:
        figures: dict[str, float] = json.loads(path.read_text(encoding="utf-8"))["figures"]
        return figures
    except (OSError, ValueError, KeyError) as error:
        raise BenchmarkError(f"{path}: no figures to plan with ({error}); give --sizes") from error


def plan(report: Any, settings: Settings, figures: dict[str, float]) -> None:
    """Nodes, hours, cost and storage for some hours of video, from the largest corpus measured."""
    from smooth_operator_research.run_report import BenchmarkError

    sizes = [int(n.split("/")[0]) for n in figures if n.endswith("/core_hours_an_hour")]
    if not sizes:
        raise BenchmarkError("there are no figures to plan with; give --sizes")
    largest = max(sizes)
    cost, size = (figures[f"{largest}/{n}"] for n in ("core_hours_an_hour", "mb_an_hour"))
    rows: list[Sequence[object]] = []
    for hours in settings.plan:
        core_hours = hours * cost
        rows += [
            [
                f"{hours:,.0f}",
                nodes,
                core_hours,
                core_hours / (nodes * settings.cores),
                core_hours * settings.price,
                hours * size / 1e6,
            ]
            for nodes in settings.nodes
        ]
        report.figures[f"plan {hours:g}/core_hours"] = core_hours
        report.figures[f"plan {hours:g}/tb"] = hours * size / 1e6
    report.table(
        f"Plan: {settings.cores} cores a node, {settings.price:g} a core and hour",
        ("hours of clips", "nodes", "core-hours", "wall [h]", "cost", "output [TB]"),
        rows,
        1,
    )
    report.notes.append(
        f"planned from {largest} clips: {cost:.4f} core-hours and {size:.1f} MB for an hour of "
        "clips; memory, disks and the price are your cluster's"
    )


if __name__ == "__main__":
    if DRIVER in sys.argv:
        drive(json.loads(sys.argv[sys.argv.index(DRIVER) + 1]))
    else:
        import tyro

        main(tyro.cli(Settings, description=__doc__))
