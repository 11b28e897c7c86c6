"""Teleoperation: sources, the real-time loop, sinks, browser pages and recordings."""
