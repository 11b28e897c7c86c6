"""Published methods for comparison with ``sbr`` and ``smooth``, and their solvers: ``joint_angle``,
``keyvector``, ``hybrid``, ``dexpilot``, ``ako`` and ``geort``. The registry of methods
(``smooth_operator.retargeting.registry``) loads them by name, like the methods of plugins."""
