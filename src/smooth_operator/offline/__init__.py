"""Offline retargeting: whole recordings, planned, executed and measured; nothing here prints."""

from smooth_operator.offline.execution import Outcome as Outcome
from smooth_operator.offline.execution import Runner as Runner
from smooth_operator.offline.execution import build as build
from smooth_operator.offline.execution import built_for as built_for
from smooth_operator.offline.execution import execute as execute
from smooth_operator.offline.execution import measure as measure
from smooth_operator.offline.trajectory_retargeter import (
    TrajectoryRetargeter as TrajectoryRetargeter,
)
