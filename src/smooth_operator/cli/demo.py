"""``smooth-operator demo``: retargets the synthetic operator and shows the result."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final

from tyro.conf import arg

from smooth_operator.cli.common_options import (
    RARE,
    Common,
    Measured,
    Meshes,
    Page,
    Retargeting,
    Synthetic,
)

if TYPE_CHECKING:
    from smooth_operator.execution import Outcome
    from smooth_operator.planning import Plan


@dataclass(frozen=True, kw_only=True)
class Demo(Common, Page, Meshes, Retargeting, Synthetic, Measured):
    """Retarget a synthetic operator, print five metrics, and play the result in the browser."""

    work: ClassVar[str] = "smooth_operator.cli.demo:demo"
    details: ClassVar[str] = """Writes to the folder: commands.npz and commands.json (the resolved
configuration), log.mcap (human hand and commands), metrics.json, config.json and plots/.

Examples:
  smooth-operator demo --no-view --duration 5
  smooth-operator demo --side left --tracker camera --landmark-loss 0.02
"""

    rare: ClassVar[frozenset[str]] = RARE | {"rate", "tracker", "frame_loss", "landmark_loss"}

    output: Annotated[Path, arg(metavar="FOLDER")] = Path("smooth-operator-demo")
    """Folder to write. Files from an earlier demo in this folder are replaced."""

    no_view: bool = False
    """Do not serve the page, for machines without a browser."""

    def extras(self) -> dict[str, tuple[str, ...]]:
        """The extra that the plots, the log and the page need."""
        return {"teleop": ("matplotlib", "mcap", "viser")}


def demo(options: Demo) -> None:
    """Records the synthetic operator, retargets and measures the motion, serves the page and writes
    the folder."""
    from smooth_operator.cli.console import Progressing, print_metrics, print_summary
    from smooth_operator.cli.outputs import check_folder, folder_for, staged
    from smooth_operator.cli.page import hand_to_draw
    from smooth_operator.cli.sample import synthetic_operator
    from smooth_operator.cli.session import execute_shown
    from smooth_operator.execution import measure
    from smooth_operator.hand_files.vendor_model import hand_with_meshes
    from smooth_operator.hands.registry import default_side
    from smooth_operator.planning import configuration, make_request, plan

    progress = Progressing(options.quiet)
    check_folder(options.output, "demo", "an earlier demo")
    if not options.no_view:  # Report an unusable address or port before any work starts.
        from smooth_operator.teleop.pages import Playback, serve
        from smooth_operator.teleop.pages.viser_server import free_port, until_interrupted

        free_port(options.host, options.port)
    request = make_request(**options.settings(), side=options.side)
    operator = synthetic_operator(options, options.seed, default_side(request.hand))
    todo = plan(operator.record(options.duration), request)
    if options.model is not None:
        hand_with_meshes(todo.hand, options.model)
    with folder_for(options.output):
        outcome = execute_shown(todo, progress)
        with progress.waiting("measuring"):
            trace, metrics = measure(todo, outcome, options.definition)
        title = f"{todo.hand.name} {todo.hand.spec.side}: {todo.method} {todo.preset}"
        page = None
        # Writing files takes seconds, and the user is waiting for the page.
        if not options.no_view:
            playback = Playback(title, todo.hand, trace, hand_to_draw(todo.hand, options))
            open_browser = not options.no_browser
            page = serve(
                playback,
                host=options.host,
                port=options.port,
                open_browser=open_browser,
                block=False,
            )
        config = configuration("demo", todo, operator=operator, duration=options.duration)
        with progress.waiting("writing"), staged(options.output) as folder:
            _write(folder, todo, outcome, metrics, config)
    heading = f"the synthetic hand on {title}"
    if options.all:
        print_metrics(heading, metrics)
    else:
        print_summary(heading, todo.method, metrics, _FOLLOWING)
    progress.note(f"wrote {options.output}")
    if page is not None:
        progress.note(f"the page is served at {page.url}; press Ctrl-C to stop")
        until_interrupted(page)


_FOLLOWING: Final = (
    "Next: try smooth-operator teleop (the live page), or retarget your own recording: "
    "smooth-operator retarget RECORDING --output out.npz",
    "To see all metrics, use --all, or open metrics.json in the folder",
)


def _write(
    folder: Path, todo: Plan, outcome: Outcome, metrics: dict[str, Any], config: dict[str, Any]
) -> None:
    from smooth_operator.atomic_files import write_json
    from smooth_operator.formats.commands import write_commands
    from smooth_operator.formats.episode import Episode
    from smooth_operator.reporting.run_plots import save_plots
    from smooth_operator.teleop.recording import write_episode

    commands = outcome.commands
    write_commands(folder / "commands.npz", commands, config)
    write_episode(
        folder / "log.mcap",
        Episode(todo.recording, commands, config=config, name=todo.recording.name),
    )
    save_plots(todo, commands, folder / "plots")
    write_json(folder / "metrics.json", metrics, indent=2)
    write_json(folder / "config.json", config, indent=2)
