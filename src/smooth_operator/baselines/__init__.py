"""Published methods that ``sbr`` and ``smooth`` are compared with, and their solvers.

``joint_angle``, ``keyvector``, ``hybrid``, ``dexpilot``, ``ako`` and ``geort``. The registry of
methods (``smooth_operator.methods.registry``) loads each by name, as it loads that of a plugin.
"""
