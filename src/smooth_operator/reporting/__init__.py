"""Common figures and HTML of the reports. Needs the extra ``teleop``."""

from smooth_operator.errors import require

require("a report with figures", "teleop", "matplotlib")
