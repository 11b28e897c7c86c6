"""Scenes of hands with objects, and how retargeting that sees the object compares in them."""
