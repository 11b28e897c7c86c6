"""Figures and HTML that the reports share. Needs the extra ``lab``."""

from smooth_operator.errors import require

require("a report with figures", "lab", "matplotlib")
