"""Published methods that ``sbr`` and ``smooth`` are compared with, and what only they need.

``joint_angle``, ``keyvector``, ``hybrid``, ``dexpilot``, ``ako`` and ``geort``. The registry of
methods (``smooth_operator.methods.registry``) loads each by name, as it loads that of a plugin.
"""
