"""Simulators of robot hands at the level of their protocols, for tests of drivers.

Every simulator was written from the maker's public texts alone, without a look at a driver of
this project. A driver that passes against a simulator therefore agrees with the maker's text, and
not with its own author. The docstring of each module names its sources and what was not found in
them.
"""
