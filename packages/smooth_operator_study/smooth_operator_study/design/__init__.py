"""Design of a study: protocol, balanced orders of conditions and tasks, plan files.

Needs the extra ``study``.
"""

from smooth_operator.errors import require

require("the plan of a study", "study", "jinja2", "matplotlib")
