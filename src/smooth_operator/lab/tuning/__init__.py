"""Tuning: the numbers of a method's configuration, searched on recordings that are not judged.

``plan_tuning`` looks everything up and refuses recordings that are held out, ``tune``
searches, and leaves a preset file, a log to go on from and a plot of what was traded for what.
Nothing here prints.
"""

from smooth_operator.lab.tuning.search_plan import Tuning as Tuning
from smooth_operator.lab.tuning.search_plan import TuningSettings as TuningSettings
from smooth_operator.lab.tuning.search_plan import plan_tuning as plan_tuning
from smooth_operator.lab.tuning.tune import Progress as Progress
from smooth_operator.lab.tuning.tune import Tuned as Tuned
from smooth_operator.lab.tuning.tune import tune as tune
