"""Old names: importing an old module says what it is called now; old public names still work."""

from __future__ import annotations

import sys
from importlib import import_module

TYPE_CHECKING = False  # as typing's, which takes longer to import than all of this package
if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from types import ModuleType
    from typing import Any, Final

_MOVED: Final = """
ablations=lab.paper benchmark=lab.benchmark,reporting checkup=lab.validation
components=plugins,teleop.components documents=io.documents hands.catalogue=hands.registry
hands.discovery=lab.discovery hands.menagerie=hand_files.menagerie
hands.stand_ins=hand_files.stand_ins methods.preset_file=formats.preset_file
methods.setting_paths=formats.setting_paths
hands.model_files=hand_files.model_files hands.published=hand_files.vendor_model
hands.renderer=simulation.renderer human.calibration=calibration io.atomic=atomic_files
io.arrays=formats.arrays io.bounds=formats.bounds io.jsonable=formats.jsonable
io.checks=formats.checks io.csv_table=formats.csv_table io.environment=formats.environment
io.episode=formats.episode io.frames=formats.frames io.manus=formats.manus
io.readers=formats.readers io.registry=formats.registry io.results=formats.commands
io.sniff=formats.sniff io.user_cache=result_cache.user_cache io.staging=episode_files.staging
live=teleop.control methods.geort=baselines.geort methods.geort_model=baselines.geort_model
methods.joint_angle=baselines.joint_angle methods.published_angles=baselines.published_angles
methods.slsqp_method=baselines.slsqp_method metrics.plots=reporting.metric_plots
hands.spec_writer=hand_files.spec_writer human.anatomy=synthetic.hand_anatomy
human.joint_angles=baselines.joint_angles,human.anatomical_axes
human.joint_map=baselines.joint_map,human.palm_axes human.kinematics=synthetic.human_kinematics
human.operator_file=calibration.operator_file human.pursuit=human.landmark_filter
human.one_euro=teleop.sources.webcam.one_euro objective.clearance=objective.terms.self_collision
objective.key_objectives=baselines.ako_targets objective.local=objective.loss
objective.polar=objective.terms.direction_length objective.smooth=objective.loss,objective.terms
offline=lab.offline,methods parallel.crew=parallel.persistent_pool
recording=formats,teleop.recording,episode_files retargeters=methods runtime=teleop.runtime,teleop
sinks=teleop.sinks,teleop,simulation solvers.damped=solvers.newton
solvers.scipy_slsqp=baselines.scipy_slsqp solvers.slsqp=baselines.slsqp
sources=teleop.sources,teleop,synthetic
study.analysis.report.tables=study.analysis.report.report_tables
study.console.desk=study.console.session_service study.console.gate=study.console.access,web.auth
study.console.hand=study.console.session_teleop study.console.view=study.console.page_state
study.console.words=study.console.event_texts study.data.tables=study.data.checked_tables
study.data.workload=study.data.workload_scores study.design.checks=simulation.tasks.checks
study.design.entries=io.entries study.design.rubrics=simulation.tasks.rubrics
study.power.layout=study.power.study_rows study.power.report=study.power.power_report
study.power.run=study.power.power_run study.power.simulation=study.power.simulated_study
study.store.tables=study.store.database_tables study.store.workload=study.store.nasa_tlx
study.tasks=simulation.tasks teleop.control.orders=teleop.control.rpc_handlers
teleop.control.workshop=teleop.control.method_switcher
teleop.pages.live.coach=teleop.pages.live.calibration_wizard
teleop.pages.live.takes=teleop.pages.live.recordings teleop.pages.readout=teleop.pages.status_panel
teleop.runtime.switchboard=teleop.runtime.rpc_server
teleop.runtime.turns=teleop.runtime.rate_limiter teleop.sinks.courier=teleop.sinks.threaded_sink
teleop.sources.intake=teleop.sources.message_receiver training=lab.training tuning=lab.tuning
ui=teleop.pages
"""
MOVED: Final[dict[str, tuple[str, ...]]] = {
    old: tuple(homes.split(",")) for old, _, homes in (row.partition("=") for row in _MOVED.split())
}
"""Old module -> the modules that hold its content now; both below ``smooth_operator``.

A module below another old one needs no row: Python imports the outer one first, which is refused.
"""

_FORMER: Final = """
baselines.slsqp=solvers.SlsqpConfig,solvers.slsqp_minimise
baselines.tip_targets=objective.TipTargets calibration.estimate=calibration.Calibration
formats.checks=io.reading_notes formats.commands=io.config_path,io.read_commands,io.write_commands
formats.frames=io.frame_slice formats.readers=io.read_recording formats.registry=io.Reader
human.alignment=align_recording,calibrate_scale,human.AlignmentConfig,human.align_recording,human.calibrate_scale
human.operator=human.OperatorProfile atomic_files=io.atomic_write,io.output_error
formats.jsonable=io.to_json lab.discovery.discover=lab.discover
lab.validation.round_trip=lab.round_trip methods.method=methods.HostMethod
methods.retargeter=RetargetState,methods.RetargetState methods.sbr=SbrConfig,methods.SbrConfig
methods.smooth=SmoothConfig,methods.SmoothConfig metrics.evaluation=metrics.Definition
metrics.metric=metrics.GROUPS metrics.trace=metrics.keyvectors
objective.keyvectors=objective.KeyvectorLayout
objective.targets=objective.DexPilotTargets,objective.PlainTargets,objective.StatelessTargets,objective.TargetPolicy,objective.Targets
study.design.plan=study.make_plan study.design.protocol=study.Condition,study.Protocol,study.Task
study.store.events=study.BlockStarted,study.Calibrated study.store.opening=study.open_study
teleop.runtime.settings=teleop.SafetyConfig teleop.sinks.registry=teleop.build_sink
teleop.sinks.tick=teleop.Mode teleop.sources.live=teleop.Arrival,teleop.LiveSource,teleop.Mailbox
teleop.sources.registry=teleop.build_source types=CommandTrajectory,JointCommand
"""
FORMER: Final = {
    name: home
    for home, _, names in (row.partition("=") for row in _FORMER.split())
    for name in names.split(",")
}
"""Name that a package once had -> the module that has it now; both below ``smooth_operator``."""


def former_names(package: str) -> Callable[[str], Any]:
    """``__getattr__`` of a package for the names that it once had: they work, with a warning.

    Args:
        package: its ``__name__``.
    """

    def load(name: str) -> Any:
        home = FORMER.get(f"{package}.{name}".partition(".")[2])
        if home is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        import warnings  # here, for who uses an old name

        now = f"{__package__}.{home}.{name}"
        warnings.warn(f"{package}.{name} is now {now}", DeprecationWarning, stacklevel=2)
        return getattr(import_module(f"{__package__}.{home}"), name)

    return load


class MovedNames:
    """A finder at the end of ``sys.meta_path``: it sees only what no other finder knows."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> None:
        """None, which leaves the usual error, or an error that gives the new name.

        Raises:
            ModuleNotFoundError: the module has another name now.
        """
        package, _, old = name.partition(".")
        if package == __package__ and old in MOVED:
            # Without name=: `from smooth_operator import old` would hide an error about that name.
            raise ModuleNotFoundError(_message(name, MOVED[old]))


def _message(old: str, homes: tuple[str, ...]) -> str:
    """The new modules, and the public names of those that are public packages."""
    modules = [f"{__package__}.{home}" for home in homes]
    message = f"{old} is now {' and '.join(modules)}"
    for home, module in zip(homes, modules, strict=True):
        if "." not in home and (names := getattr(import_module(module), "__all__", ())):
            message += f"; {module} has {', '.join(names)}"
    return message


def install() -> None:
    """Puts the finder at the end of the list, once."""
    if not any(isinstance(finder, MovedNames) for finder in sys.meta_path):
        sys.meta_path.append(MovedNames())
