"""Published methods for comparison with ``sbr`` and ``smooth``, and their solvers: ``joint_angle``,
``keyvector``, ``hybrid``, ``dexpilot``, ``ako`` and ``geort``. The registry of methods
(``smooth_operator.retargeting.registry``) loads them by name, like the methods of plugins."""

from smooth_operator.parts import OFFERED

_SLSQP = f"{__name__}.slsqp_method"

OFFERED["method"] = {
    "joint_angle": (f"{__name__}.joint_angle:JOINT_ANGLE_PRESETS", "default"),
    "keyvector": (f"{_SLSQP}:KEYVECTOR_PRESETS", "published or fast"),
    "hybrid": (f"{_SLSQP}:HYBRID_PRESETS", "published or fast"),
    "dexpilot": (f"{_SLSQP}:DEXPILOT_PRESETS", "published or fast"),
    "ako": (f"{_SLSQP}:AKO_PRESETS", "published or fast"),
    "geort": (
        f"{__name__}.geort.method:GEORT_PRESETS",
        "default, or the file of your trained model",
    ),
}
