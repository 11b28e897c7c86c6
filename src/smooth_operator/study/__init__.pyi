from smooth_operator.study.analysis.analyze import analyze_study as analyze_study
from smooth_operator.study.data.reading import read_study as read_study
from smooth_operator.study.design.plan import make_plan as make_plan
from smooth_operator.study.design.protocol import Condition as Condition
from smooth_operator.study.design.protocol import Protocol as Protocol
from smooth_operator.study.store.opening import open_study as open_study
