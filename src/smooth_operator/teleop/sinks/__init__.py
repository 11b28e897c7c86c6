"""Sinks, which receive joint commands: one module for each kind."""
