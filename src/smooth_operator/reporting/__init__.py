"""Figures and HTML that the reports share."""
