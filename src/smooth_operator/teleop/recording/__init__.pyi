from smooth_operator.teleop.recording.convert import read_episode as read_episode
from smooth_operator.teleop.recording.convert import write_episode as write_episode
from smooth_operator.teleop.recording.log import LogWriter as LogWriter
from smooth_operator.teleop.recording.log_reader import Log as Log
from smooth_operator.teleop.recording.log_reader import read_log as read_log
