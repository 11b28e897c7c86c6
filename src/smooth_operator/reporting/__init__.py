"""Common figures and HTML of the reports. Needs the extra ``lab``."""

from smooth_operator.errors import require

require("a report with figures", "lab", "matplotlib")
