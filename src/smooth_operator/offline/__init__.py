"""Offline retargeting: whole recordings, planned, executed and measured; nothing here prints."""

from smooth_operator.offline.cache import enable_cache as enable_cache
from smooth_operator.offline.environment import environment as environment
from smooth_operator.offline.execution import Outcome as Outcome
from smooth_operator.offline.execution import Runner as Runner
from smooth_operator.offline.execution import build as build
from smooth_operator.offline.execution import build_retargeter as build_retargeter
from smooth_operator.offline.execution import execute as execute
from smooth_operator.offline.execution import measure as measure
from smooth_operator.offline.plan import Plan as Plan
from smooth_operator.offline.plan import Request as Request
from smooth_operator.offline.plan import Scale as Scale
from smooth_operator.offline.plan import configuration as configuration
from smooth_operator.offline.plan import live_configuration as live_configuration
from smooth_operator.offline.plan import plan as plan
from smooth_operator.offline.plan import request as request
from smooth_operator.offline.plan import settle as settle
from smooth_operator.offline.plan import settled_config as settled_config
from smooth_operator.offline.whole import WholeRetargeter as WholeRetargeter
