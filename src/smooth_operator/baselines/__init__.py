"""Published methods for comparison with ``sbr`` and ``smooth``, and their solvers: ``joint_angle``,
``keyvector``, ``hybrid``, ``dexpilot``, ``ako`` and ``geort``. They are entry points of this
distribution in the group ``smooth_operator.methods``, and load like the methods of plugins."""
