"""Sinks of joint commands: one module for each kind."""
