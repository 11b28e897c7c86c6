"""Retarget tracked human hands onto robot hands, smoothly and in real time."""
