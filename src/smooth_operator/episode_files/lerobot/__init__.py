"""Reads and writes episodes as a LeRobot dataset, version 3.0: a folder of Parquet files and their
metadata.

::

    meta/info.json                               fps, features, totals
    meta/tasks.parquet                           task -> task_index
    meta/stats.json                              statistics of every feature, all episodes
    meta/episodes/chunk-000/file-000.parquet     one row per episode: its place, its statistics
    meta/smooth_operator.json                    which program wrote the folder
    data/chunk-000/file-000.parquet              one row per frame, one row group per episode
    README.md                                    the columns and their units

LeRobot's own columns have LeRobot's types. Data that they can't hold is in further columns. The
names of these begin with neither ``observation`` nor ``action``, because LeRobot uses all columns
with such names as inputs and outputs of a policy. They are listed in
``smooth_operator.episode_files.lerobot.schema``.

LeRobot has one frame rate and no other clock: ``timestamp`` is ``frame_index / fps``, as LeRobot's
own recorder writes it, and the true time of each frame is in ``stamp``.
"""

from smooth_operator.episode_files.lerobot.reader import Dataset as Dataset
from smooth_operator.episode_files.lerobot.reader import open_dataset as open_dataset
from smooth_operator.episode_files.lerobot.reader import (
    read_dataset_episode as read_dataset_episode,
)
from smooth_operator.episode_files.lerobot.writer import is_own_dataset as is_own_dataset
from smooth_operator.episode_files.lerobot.writer import write_dataset as write_dataset
