"""Program ``smooth-operator-lerobot-record``: records a robot and the human hands that drive it.

It has the command line of ``lerobot-record`` and calls the same public functions of LeRobot, which
do the work: ``record_loop`` drives the robot and fills the frames, and ``LeRobotDataset`` writes
them. ``lerobot-record`` itself has no place for columns of a teleoperator (LeRobot 0.6.1,
``lerobot/scripts/lerobot_record.py``).
"""

from contextlib import ExitStack
from functools import partial
from typing import Any

from lerobot_teleoperator_smooth_operator.config_smooth_operator import SmoothOperatorConfig
from lerobot_teleoperator_smooth_operator.human_hands import HumanHands
from lerobot_teleoperator_smooth_operator.smooth_operator import SmoothOperator

try:
    from lerobot.common.control_utils import sanity_check_dataset_robot_compatibility
    from lerobot.configs import parser
    from lerobot.datasets import (
        LeRobotDataset,
        VideoEncodingManager,
        aggregate_pipeline_dataset_features,
        create_initial_features,
    )
    from lerobot.processor import make_default_processors
    from lerobot.robots import make_robot_from_config
    from lerobot.scripts.lerobot_record import RecordConfig, record_loop
    from lerobot.teleoperators.utils import TeleopEvents
    from lerobot.utils.import_utils import register_third_party_plugins
    from lerobot.utils.keyboard_input import init_keyboard_listener
    from lerobot.utils.utils import init_logging, log_say
    from lerobot.utils.visualization_utils import init_visualization, shutdown_visualization
except ImportError as error:
    raise SystemExit(
        "recording needs LeRobot 0.6 or newer with its programs; run: "
        f"python -m pip install 'lerobot[core-scripts]>=0.6' ({error})"
    ) from error


class RecordedOperator(SmoothOperator):
    """Teleoperator whose events end an episode, or repeat it, as LeRobot's arrow keys do.

    Attributes:
        events: flags of ``record_loop``, which calls ``get_action`` in each step.
    """

    events: dict[str, bool]

    def get_action(self) -> dict[str, float]:
        """Return the newest command, and pass new events to ``record_loop``."""
        new = self.get_teleop_events()
        if new[TeleopEvents.TERMINATE_EPISODE] or new[TeleopEvents.SUCCESS]:
            self.events["exit_early"] = True
        if new[TeleopEvents.RERECORD_EPISODE]:
            self.events["rerecord_episode"] = True
        return super().get_action()


class HumanHandsDataset(LeRobotDataset):
    """LeRobot data set that adds the human hands of the newest action to each frame.

    Attributes:
        hands: the human hands.
    """

    hands: HumanHands

    def add_frame(self, frame: dict[str, Any]) -> None:
        """Add a frame, with the columns of the hands."""
        super().add_frame({**frame, **self.hands.values})


def _touch_apart(features: dict[str, Any]) -> dict[str, Any]:
    """Move contacts and currents out of the state into columns of their own.

    LeRobot's rollouts give a policy only the joints of the state (``.pos``, ``.vel``).
    """
    state = features["observation.state"]
    columns: dict[str, list[str]] = {}
    for name in state["names"]:
        kind = "current" if name.endswith(".current") else "state"
        columns.setdefault("tactile" if "tactile." in name else kind, []).append(name)
    return features | {
        f"observation.{column}": {**state, "shape": (len(names),), "names": names}
        for column, names in columns.items()
    }


def _dataset(cfg: RecordConfig, robot: Any, hands: HumanHands) -> Any:
    """Create the data set, or open the one that ``--resume`` continues."""
    data = cfg.dataset
    of_action, _, of_observation = make_default_processors()
    features: dict[str, Any] = {}
    for pipeline, initial in (
        (of_action, create_initial_features(action=robot.action_features)),
        (of_observation, create_initial_features(observation=robot.observation_features)),
    ):
        features |= aggregate_pipeline_dataset_features(pipeline, initial, use_videos=data.video)
    features = _touch_apart(features) | hands.features
    cameras = len(getattr(robot, "cameras", ()))
    options = {
        "root": data.root,
        "batch_encoding_size": data.video_encoding_batch_size,
        "rgb_encoder": data.rgb_encoder,
        "depth_encoder": data.depth_encoder,
        "encoder_threads": data.encoder_threads,
        "streaming_encoding": data.streaming_encoding,
        "encoder_queue_maxsize": data.encoder_queue_maxsize,
        "image_writer_processes": data.num_image_writer_processes if cameras else 0,
        "image_writer_threads": data.num_image_writer_threads_per_camera * cameras,
    }
    if cfg.resume:
        dataset = HumanHandsDataset.resume(data.repo_id, **options)
        sanity_check_dataset_robot_compatibility(dataset, robot, data.fps, features)
    else:
        data.stamp_repo_id()
        options |= {"robot_type": robot.name, "use_videos": data.video}
        dataset = HumanHandsDataset.create(data.repo_id, data.fps, features, **options)
    dataset.hands = hands
    return dataset


@parser.wrap()
def record(cfg: RecordConfig) -> None:
    """Record a data set as the command line says.

    Raises:
        SystemExit: the teleoperator is not ``smooth_operator``.
    """
    if not isinstance(cfg.teleop, SmoothOperatorConfig):
        raise SystemExit(
            "this program stores the human hands of --teleop.type=smooth_operator, but got "
            f"--teleop.type={cfg.teleop.type}; use lerobot-record for it"
        )
    init_logging()
    data, address = cfg.dataset, {"ip": cfg.display_ip, "port": cfg.display_port}
    teleop, robot = RecordedOperator(cfg.teleop), make_robot_from_config(cfg.robot)
    of_action, to_robot, of_observation = make_default_processors()
    with ExitStack() as at_end:
        if cfg.display_data:
            init_visualization(cfg.display_mode, session_name="recording", **address)
            at_end.callback(shutdown_visualization, cfg.display_mode)
        teleop.connect()
        at_end.callback(teleop.disconnect)
        robot.connect()
        at_end.callback(robot.disconnect)
        dataset = _dataset(cfg, robot, teleop.human)
        at_end.enter_context(VideoEncodingManager(dataset))  # encodes and closes the data set
        listener, events = init_keyboard_listener()
        teleop.events = events
        if listener is not None:
            at_end.callback(listener.stop)
        loop = partial(
            record_loop,
            robot=robot,
            events=events,
            fps=data.fps,
            teleop_action_processor=of_action,
            robot_action_processor=to_robot,
            robot_observation_processor=of_observation,
            teleop=teleop,
            single_task=data.single_task,
            display_data=cfg.display_data,
            display_mode=cfg.display_mode,
            # As in lerobot-record, a viewer at an address always gets compressed pictures.
            display_compressed_images=cfg.display_compressed_images or None not in address.values(),
        )
        missing = data.num_episodes
        while missing > 0 and not events["stop_recording"]:
            log_say(f"Recording episode {dataset.num_episodes}", cfg.play_sounds)
            loop(dataset=dataset, control_time_s=data.episode_time_s)
            if not events["stop_recording"] and (missing > 1 or events["rerecord_episode"]):
                log_say("Reset the environment", cfg.play_sounds)
                loop(control_time_s=data.reset_time_s)
            if events["rerecord_episode"]:  # the key counts during the reset too
                log_say("Recording the episode again", cfg.play_sounds)
                events.update(rerecord_episode=False, exit_early=False)
                dataset.clear_episode_buffer()
                continue
            if dataset.has_pending_frames():  # not if a key ended it at once
                dataset.save_episode()
            missing -= 1
    log_say("The recording has ended", cfg.play_sounds, blocking=True)
    if data.push_to_hub and not dataset.num_episodes:
        log_say("No episode was recorded, so nothing is uploaded", cfg.play_sounds)
    elif data.push_to_hub:
        dataset.push_to_hub(tags=data.tags, private=data.private)


def main() -> None:
    """Record with the plug-ins that are installed; entry point of the program."""
    register_third_party_plugins()
    record()


if __name__ == "__main__":
    main()
