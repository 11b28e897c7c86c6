"""Decodes messages and recordings of hands from headset apps.

They turn bytes or text into hand frames; nothing here opens a socket. Wrists are converted to the
project's axes and its z-up world, and left-handed frames to right-handed ones.
"""
