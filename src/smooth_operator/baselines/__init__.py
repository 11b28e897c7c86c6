"""Published methods for comparison with ``sbr`` and ``smooth``, and their solvers. The methods are
``joint_angle``, ``keyvector``, ``hybrid``, ``dexpilot``, ``ako`` and ``geort``. This distribution
declares them as entry points in the group ``smooth_operator.methods``, so they load in the same way
as the methods of plugins."""
